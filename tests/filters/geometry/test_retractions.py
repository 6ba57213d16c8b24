"""Retractions of the orientation: what any of them must keep, and what each one is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters.geometry.poses import AdditiveQuaternion, RotationVector, additive_transport_of

from ..textbook import complex_step_jacobian, rotation_tangent

RETRACTIONS = {"quaternion": AdditiveQuaternion(), "so3": RotationVector()}

every = pytest.mark.parametrize("name", RETRACTIONS)


def additive_then_normalised(q: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """The paper's: add dq = q x (delta / 2, 0), then normalise."""
    raw = q + rotation_tangent(q) @ delta
    return raw / np.linalg.norm(raw)


def turned(q: np.ndarray, delta: np.ndarray) -> np.ndarray:
    return (Rotation.from_quat(q) * Rotation.from_rotvec(delta)).as_quat()


def random_orientation(seed: int) -> np.ndarray:
    return Rotation.random(rng=np.random.default_rng(seed)).as_quat()


@every
@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 0.1, 1.0, 3.0])
def test_local_undoes_retract_and_the_result_is_a_unit_quaternion(name: str, size: float) -> None:
    error = RETRACTIONS[name]
    for seed in range(5):
        q = random_orientation(seed)
        direction = np.random.default_rng(seed).standard_normal(3)
        delta = size * direction / np.linalg.norm(direction)
        moved = error.retract(q, delta)
        assert np.linalg.norm(moved) == pytest.approx(1.0, abs=1e-15)
        np.testing.assert_allclose(error.local(q, moved), delta, rtol=1e-9, atol=1e-15)
        # The sign of a quaternion means nothing.
        np.testing.assert_allclose(error.local(q, -moved), delta, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(("name", "reference"), [("quaternion", additive_then_normalised), ("so3", turned)])
def test_retraction_is_the_documented_one(name: str, reference) -> None:
    q, delta = random_orientation(2), np.array([0.3, -0.7, 0.5])
    got, expected = RETRACTIONS[name].retract(q, delta), reference(q, delta)
    np.testing.assert_allclose(got * np.sign(got @ expected), expected, atol=1e-15)


def test_the_papers_transport_is_the_normalisation_jacobian() -> None:
    """(4, 4) Jacobian of q / |q|, in the three coordinates of the rotation error before and after."""
    q, delta = random_orientation(3), np.array([0.2, 0.4, -0.6])
    raw = q + rotation_tangent(q) @ delta
    normalise = complex_step_jacobian(lambda p: p / np.sqrt(p @ p), raw)
    after = rotation_tangent(raw / np.linalg.norm(raw))
    expected = np.linalg.pinv(after) @ normalise @ rotation_tangent(q)
    np.testing.assert_allclose(np.reshape(additive_transport_of(*delta), (3, 3)), expected, atol=1e-14)


@every
def test_many_orientations_at_once_are_each_of_them(name: str) -> None:
    error = RETRACTIONS[name]
    q = np.array([random_orientation(seed) for seed in range(5)])
    delta = np.random.default_rng(0).standard_normal((5, 3)) * [[1e-9], [1e-4], [0.1], [1.0], [0.0]]
    moved = error.retract(q, delta)
    pairs = list(zip(q, delta, strict=True))
    np.testing.assert_allclose(moved, [error.retract(*pair) for pair in pairs], atol=1e-15)
    np.testing.assert_allclose(error.local(q, moved), delta, rtol=1e-9, atol=1e-15)
