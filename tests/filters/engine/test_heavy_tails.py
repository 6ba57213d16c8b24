"""Student's t re-weighting: no measurement counts more than its R says, surprising ones count less."""

from __future__ import annotations

import numpy as np
import pytest

from filters import Start, StereoEKF, StereoObservation, check_filter
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.checks.conformance import REFERENCE_NOISE as NOISE
from filters.engine.heavy_tails import reweighted
from filters.state.linearised import LinearisedMeasurements


def one_dimensional(innovations: list[float]) -> LinearisedMeasurements:
    """Measurements of unit R of a quantity that P knows exactly, so that d is the innovation."""
    count = len(innovations)
    return LinearisedMeasurements(
        np.array(innovations)[:, None],
        np.zeros((count, 1, 6)),
        np.zeros((count, 1, 0)),
        np.zeros((count, 0), dtype=np.int64),
        np.ones((count, 1, 1)),
    )


def test_the_weight_is_that_of_students_t_and_never_above_one() -> None:
    measurements = one_dimensional([0.0, 1.0, 3.0, 10.0])
    R = reweighted(np.eye(12, order="F"), measurements, 4.0).R[:, 0, 0]
    np.testing.assert_allclose(R, [1.0, 1.0, (4 + 9) / 5, (4 + 100) / 5])


def test_many_degrees_of_freedom_are_gaussian() -> None:
    R = reweighted(np.eye(12, order="F"), one_dimensional([0.5, 4.0]), 1e12).R
    np.testing.assert_allclose(R, 1.0, rtol=1e-9)


def test_an_outlier_inside_the_gate_pulls_less() -> None:
    moved = {}
    for tail_dof in (None, 3.0):
        slam = StereoEKF(CAMERA, NOISE, gate=None, tail_dof=tail_dof, compiled=False)
        slam.reset(Start(covariance=np.diag(np.repeat([1e-6, 1e-6, 0.3, 0.03], 3) ** 2)))
        uvd = np.random.default_rng(0).uniform((300, 80, 8), (1000, 320, 40), (20, 3))
        slam.update(StereoObservation(np.arange(20), uvd))
        slam.predict(0.1)
        wrong = uvd.copy()
        wrong[0, 0] += 30.0
        slam.update(StereoObservation(np.arange(20), wrong))
        moved[tail_dof] = np.linalg.norm(slam.pose.position)
    assert moved[3.0] < 0.6 * moved[None]


def test_it_conforms_and_its_value_is_checked() -> None:
    check_filter(lambda camera, noise: StereoEKF(camera, noise, tail_dof=5.0))
    with pytest.raises(ValueError, match="tail_dof must be a finite number > 0"):
        StereoEKF(CAMERA, NOISE, tail_dof=0.0)
