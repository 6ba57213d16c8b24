"""SO(3), against scipy and against the power series of the Jacobian."""

from __future__ import annotations

from math import factorial

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from filters.geometry import rotations

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
def test_a_matrix_has_the_quaternion_and_the_vector_of_scipy(size: float) -> None:
    for phi in vectors(size):
        R = rotations.exp(phi)
        theirs = Rotation.from_matrix(R)
        np.testing.assert_allclose(rotations.from_matrix(R), theirs.as_quat(), rtol=0, atol=1e-15)
        np.testing.assert_allclose(rotations.log(R), theirs.as_rotvec(), rtol=0, atol=1e-15)


@pytest.mark.parametrize("half_turn", [np.diag(d) for d in ([1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1])])
def test_half_a_turn_has_a_quaternion_too(half_turn: np.ndarray) -> None:
    np.testing.assert_array_equal(rotations.matrix(rotations.from_matrix(half_turn)), half_turn)
    assert np.linalg.norm(rotations.log(half_turn)) == pytest.approx(np.pi, abs=1e-15)


def test_what_is_almost_a_rotation_is_mended_and_a_reflection_refused() -> None:
    R = rotations.exp([0.3, -0.2, 0.5]) * (1.0 + 1e-4 * np.random.default_rng(0).standard_normal((3, 3)))
    np.testing.assert_array_equal(rotations.log(R), Rotation.from_matrix(R).as_rotvec())
    np.testing.assert_array_equal(rotations.from_matrix(R), Rotation.from_matrix(R).as_quat())
    for function in (rotations.log, rotations.from_matrix):
        with pytest.raises(ValueError, match="determinant"):
            function(np.diag([1.0, 1.0, -1.0]))


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


@pytest.mark.parametrize("size", SIZES)
def test_many_rotations_at_once_are_each_of_them(size: float) -> None:
    phi = vectors(size)
    q = rotations.exp_quaternion(phi)
    other = Rotation.random(len(phi), rng=np.random.default_rng(3)).as_quat()
    for many, single in (
        (q, [rotations.exp_quaternion(p) for p in phi]),
        (rotations.matrix(q), [rotations.matrix(p) for p in q]),
        (rotations.exp(phi), [rotations.exp(p) for p in phi]),
        (rotations.right_jacobian(phi), [rotations.right_jacobian(p) for p in phi]),
        (rotations.from_matrix(rotations.matrix(other)), [rotations.from_matrix(R) for R in rotations.matrix(other)]),
        (rotations.multiply(q, other), [rotations.multiply(*pair) for pair in zip(q, other, strict=True)]),
        (rotations.between(other, q), [rotations.between(*pair) for pair in zip(other, q, strict=True)]),
    ):
        np.testing.assert_allclose(many, single, rtol=1e-14, atol=1e-15)


def test_a_rotation_for_all_vectors_or_one_for_each() -> None:
    v = np.random.default_rng(4).standard_normal((5, 3))
    turns = Rotation.random(5, rng=np.random.default_rng(5))
    np.testing.assert_allclose(rotations.turned(turns.as_matrix(), v), turns.apply(v), atol=1e-14)
    np.testing.assert_allclose(rotations.turned(turns[0].as_matrix(), v), turns[0].apply(v), atol=1e-14)


def test_one_rotation_of_many_that_is_not_a_number_leaves_the_others_alone() -> None:
    rng = np.random.default_rng(9)
    phi = rng.normal(size=(3, 3))
    phi[1] = np.nan
    q = rotations.exp_quaternion(phi)
    for values in (q, rotations.multiply(q, q), rotations.between(q, q), rotations.matrix(q), rotations.exp(phi)):
        assert np.isnan(values[1]).all()
        assert np.isfinite(values[[0, 2]]).all()


@pytest.mark.parametrize("leading", [(2, 3), (1,), (0,), (2, 1, 4)])
def test_any_leading_dimensions_will_do(leading):
    phi = np.random.default_rng(4).uniform(-1.5, 1.5, (*leading, 3))  # shorter than pi
    R = rotations.exp(phi)
    assert R.shape == (*leading, 3, 3)
    np.testing.assert_allclose(rotations.log(R), phi, atol=1e-12)
    np.testing.assert_allclose(rotations.matrix(rotations.from_matrix(R)), R, atol=1e-12)
