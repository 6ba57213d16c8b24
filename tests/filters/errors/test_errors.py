"""What every error definition must keep: corrections, their Jacobian, and the error that NEES is made of."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import LeftInvariant, RightInvariant
from filters.geometry import rotations, symmetric
from filters.motions.motion_model import POSITION, ROTATION

from ..dense import minus, moved_by
from ..numeric import numeric_jacobian
from ..slots import ERRORS, LANDMARKS
from ..stranger.biased import Biased, BiasedPair
from .worlds import small_correction, some_filter


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_every_correction_is_delta_to_first_order(landmark: str, error: str) -> None:
    slam = some_filter(landmark, error)
    state = slam.state
    for seed in range(5):
        delta = small_correction(state, seed, 1e-4)
        np.testing.assert_allclose(minus(state, moved_by(slam, delta)[0]), delta, rtol=0, atol=2e-7)


@pytest.mark.parametrize("landmark", LANDMARKS)
@pytest.mark.parametrize("error", ["quaternion", "so3", RightInvariant(reset=True), LeftInvariant()], ids=str)
def test_p_is_carried_along_by_the_jacobian_of_the_retraction(landmark: str, error: object) -> None:
    """d minus(moved by delta, moved by delta + e) / d e, whole columns, where a definition resets."""
    slam = some_filter(landmark, error)
    state, delta = slam.state, small_correction(slam.state, 3, 0.1)
    there, carried = moved_by(slam, delta)
    J = numeric_jacobian(lambda e: minus(there, moved_by(slam, delta + e)[0]), len(delta), 1e-5)
    expected = J @ symmetric.full(state.P) @ J.T
    sigmas = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(carried / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=1e-6)


@pytest.mark.parametrize("error", [RightInvariant(reset=True), LeftInvariant(), "so3"], ids=str)
def test_so_it_is_of_blocks_of_four_rows(error: object) -> None:
    """Landmarks with a bias; their anchors fill three rows."""
    slam = some_filter(Biased(), error, measurement=BiasedPair())
    state = slam.state
    padding = np.zeros(len(state.P), dtype=bool)
    padding[state.block_rows(np.unique(state.anchor_block)).reshape(-1, 4)[:, 3]] = True
    P = symmetric.full(state.P)
    P[padding] = P[:, padding] = 0.0
    P[padding, padding] = 1.0
    state.P = np.asfortranarray(P)
    slam.state, delta = state, np.where(padding, 0.0, small_correction(state, 3, 0.1))
    there, carried = moved_by(slam, delta)
    J = numeric_jacobian(lambda e: minus(there, moved_by(slam, delta + e)[0]), len(delta), 1e-5)
    used, expected = ~padding, J @ P @ J.T
    sigmas = np.sqrt(np.diag(expected))[used]
    scale = np.outer(sigmas, sigmas)
    np.testing.assert_allclose(carried[used][:, used] / scale, expected[used][:, used] / scale, atol=1e-6)


@pytest.mark.parametrize("error", ERRORS)
def test_pose_covariance_is_that_of_the_pose_error(error: str) -> None:
    state, definition = some_filter("euclidean", error).state, ERRORS[error]
    camera, P_pose = state.camera, symmetric.full(state.P)[:6, :6]

    def error_of(delta: np.ndarray) -> np.ndarray:
        truth = Rotation.from_quat(camera.orientation) * Rotation.from_rotvec(delta[3:])
        return definition.pose_error(camera, P_pose, camera.position + delta[:3], truth.as_quat())[0]

    np.testing.assert_allclose(error_of(np.zeros(6)), 0.0, rtol=0, atol=1e-12)
    J = numeric_jacobian(error_of, 6)
    covariance = definition.pose_error(camera, P_pose, camera.position, camera.orientation)[1]
    np.testing.assert_allclose(covariance, J @ P_pose @ J.T, rtol=0, atol=1e-7 * np.abs(covariance).max())


@pytest.mark.parametrize("error", ERRORS)
def test_pose_error_is_the_correction_that_leads_to_the_truth(error: str) -> None:
    """Not only to first order; in the coordinates of the definition."""
    slam, definition = some_filter("euclidean", error), ERRORS[error]
    state = slam.state
    delta = small_correction(state, 7, 0.4)
    truth = moved_by(slam, delta)[0].camera
    actual, _ = definition.pose_error(state.camera, np.eye(6), truth.position, truth.orientation)
    R_wc, expected = state.camera.R_wc, delta[:6].copy()
    if isinstance(definition, RightInvariant):
        expected[ROTATION] = R_wc @ delta[ROTATION]
        expected[POSITION] += rotations.skew(state.camera.position) @ expected[ROTATION]
    if isinstance(definition, LeftInvariant):
        expected[POSITION] = R_wc.T @ delta[POSITION]
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-8)
