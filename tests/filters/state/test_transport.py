"""The transport of measurements, against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest

from filters.motions.motion_model import ROTATION
from filters.state.layout import Transport

from ..engine.linear_problems import dense, random_measurements

LEADING, BLOCKS = 12, 9
SIZE = LEADING + 3 * BLOCKS


def random_transport(rng: np.random.Generator, by_rotation: bool, own: bool) -> tuple[Transport, np.ndarray]:
    """A block triangular Jacobian, and the same dense; four blocks, in any order, have one of their own."""
    leading = np.eye(LEADING)
    leading[:, ROTATION] += 0.3 * rng.standard_normal((LEADING, 3))
    whole = np.eye(SIZE)
    whole[:LEADING, :LEADING] = leading
    turned = rng.standard_normal((SIZE - LEADING, 3)) if by_rotation else None
    if turned is not None:
        whole[LEADING:, ROTATION] = turned
    if not own:
        return Transport(leading, turned), whole
    rows = LEADING + 3 * rng.choice(BLOCKS, 4, replace=False)[:, None] + np.arange(3)
    blocks = np.eye(3) + 0.3 * rng.standard_normal((4, 3, 3))
    for where, block in zip(rows, blocks, strict=True):
        whole[np.ix_(where, where)] = block
    return Transport(leading, turned, rows, blocks), whole


@pytest.mark.parametrize("by_rotation", [False, True])
@pytest.mark.parametrize("own", [False, True])
def test_measurements_pulled_back_are_linear_in_the_earlier_errors(by_rotation: bool, own: bool) -> None:
    """H J, and an innovation that has back what the correction explains."""
    rng = np.random.default_rng(4)
    transport, J = random_transport(rng, by_rotation, own)
    measurements, delta = random_measurements(rng, 12, 3, BLOCKS), rng.standard_normal(SIZE)
    innovation, H, _ = dense(measurements, SIZE)
    earlier = dense(transport.pulled_back(measurements, delta), SIZE)
    np.testing.assert_allclose(earlier[1], H @ J, rtol=0, atol=1e-12)
    np.testing.assert_allclose(earlier[0], innovation + H @ J @ delta, rtol=0, atol=1e-11)
