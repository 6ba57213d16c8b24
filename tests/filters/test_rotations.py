"""SO(3), against scipy and against the power series of the Jacobian."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from filters import rotations

SIZES = [0.0, 1e-12, 1e-9, 1e-6, 0.99e-4, 1.01e-4, 1e-3, 0.1, 1.0, 3.0, np.pi - 1e-9, np.pi]


def vectors(size: float) -> np.ndarray:
    directions = np.random.default_rng(0).standard_normal((5, 3))
    return size * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_skew_is_the_cross_product() -> None:
    a, b = np.random.default_rng(1).standard_normal((2, 4, 3))
    np.testing.assert_allclose((rotations.skew(a) @ b[:, :, None])[:, :, 0], np.cross(a, b), rtol=1e-12)


@pytest.mark.parametrize("size", SIZES)
def test_exp_is_the_matrix_exponential_and_log_its_inverse(size: float) -> None:
    for phi in vectors(size):
        R = rotations.exp(phi)
        np.testing.assert_allclose(R, expm(rotations.skew(phi)), atol=1e-13)
        np.testing.assert_allclose(rotations.exp(rotations.log(R)), R, atol=1e-12)
        np.testing.assert_allclose(rotations.matrix(rotations.exp_quaternion(phi)), R, atol=1e-14)


@pytest.mark.parametrize("size", SIZES)
def test_right_jacobian_is_its_power_series(size: float) -> None:
    """Sum of (-[phi]x)^k / (k + 1)!, so the switch to the closed form shows no step."""
    for phi in vectors(size):
        cross = rotations.skew(phi)
        series = sum(np.linalg.matrix_power(-cross, k) / factorial(k + 1) for k in range(40))
        np.testing.assert_allclose(rotations.right_jacobian(phi), series, rtol=0, atol=1e-11)


def test_multiply_is_the_product_of_rotations() -> None:
    p, q = Rotation.random(rng=np.random.default_rng(2)), Rotation.random(rng=np.random.default_rng(3))
    product = rotations.multiply(p.as_quat(), q.as_quat())
    np.testing.assert_allclose(rotations.matrix(product), (p * q).as_matrix(), atol=1e-14)
    assert np.linalg.norm(product) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_between_takes_one_to_the_other_by_the_short_way(sign: float) -> None:
    for seed in range(10):
        p, q = Rotation.random(2, rng=np.random.default_rng(seed)).as_quat()
        dq = rotations.between(p, sign * q)
        assert dq[3] >= 0
        np.testing.assert_allclose(rotations.matrix(rotations.multiply(p, dq)), rotations.matrix(q), atol=1e-14)
