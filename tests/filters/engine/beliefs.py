"""Filters to compare, and what it means that two of them believe the same."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from filters import Start, StereoEKF, StereoNoise

from ..drives import CAMERA, INDEPENDENT_PIXELS, SPEED, start


def make(noise: StereoNoise = INDEPENDENT_PIXELS, **options) -> StereoEKF:
    """A started filter, by NumPy and without a gate unless told otherwise."""
    return start(StereoEKF(CAMERA, noise, **{"gate": None, **options}))


def snapshot(stereo_filter: StereoEKF) -> list[np.ndarray]:
    """Everything the filter knows, to the bit."""
    state = stereo_filter.state
    camera = state.camera
    return [
        *(camera.position, camera.orientation, camera.linear_velocity, camera.angular_velocity),
        *(np.tril(state.P), state.blocks, state.ids, state.parameter_block, state.anchor_block),
    ]


def assert_identical(first: list[np.ndarray], second: list[np.ndarray]) -> None:
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def assert_same_belief(first: StereoEKF, second: StereoEKF, tolerance: float) -> None:
    """Means relative to sigma, covariances relative to their sigmas, for every variable and every landmark."""
    for one, other in ((first.pose, second.pose), (first.velocity, second.velocity)):
        np.testing.assert_allclose(*scaled(one.covariance, other.covariance), rtol=0, atol=tolerance)
    np.testing.assert_allclose(first.pose.position, second.pose.position, rtol=0, atol=tolerance)
    np.testing.assert_allclose(first.pose.orientation, second.pose.orientation, rtol=0, atol=tolerance)
    np.testing.assert_allclose(first.velocity.linear, second.velocity.linear, rtol=0, atol=tolerance)
    np.testing.assert_allclose(first.velocity.angular, second.velocity.angular, rtol=0, atol=tolerance)
    for variable in second.options.layout.variables:
        one, other = first.belief(variable.name), second.belief(variable.name)
        sigmas = np.sqrt(np.diag(variable.covariance))
        np.testing.assert_allclose(one.value / sigmas, other.value / sigmas, rtol=0, atol=tolerance)
        np.testing.assert_allclose(*scaled(one.covariance, other.covariance), rtol=0, atol=tolerance)
    one, other = first.landmarks, second.landmarks
    np.testing.assert_array_equal(one.ids, other.ids)
    np.testing.assert_allclose(one.positions, other.positions, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(*scaled(one.covariances, other.covariances), rtol=0, atol=tolerance)
    np.testing.assert_allclose(one.inverse_distance, other.inverse_distance, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(one.inverse_distance_variance, other.inverse_distance_variance, rtol=10 * tolerance)


def scaled(actual: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    sigmas = np.sqrt(np.diagonal(expected, axis1=-2, axis2=-1))
    scale = sigmas[..., :, None] * sigmas[..., None, :]
    return actual / scale, expected / scale


def tilted(stereo_filter: StereoEKF) -> StereoEKF:
    """Reset to a pose in general position."""
    orientation = Rotation.from_rotvec([0.2, -0.5, 0.1]).as_quat()
    stereo_filter.reset(Start((1.0, 2.0, 3.0), orientation, (0.5, 0.1, SPEED), (0.02, 0.1, -0.01), 0.01 * np.eye(12)))
    return stereo_filter
