"""What every error definition must keep: corrections, their Jacobian, and the error that NEES is made of."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import LeftInvariant, RightInvariant
from filters.geometry import rotations, symmetric
from filters.motions.motion_model import POSITION, ROTATION

from ..numeric import numeric_jacobian, relative_difference
from ..slots import ERRORS, LANDMARKS
from .worlds import small_correction, some_state, standard_error, turned_world


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_gamma_is_the_effect_of_turning_the_world(landmark: str) -> None:
    state = some_state(landmark)
    numeric = numeric_jacobian(lambda e: standard_error(state, turned_world(state, Rotation.from_rotvec(e))), 3)
    assert relative_difference(state.world_rotation(), numeric) < 1e-7


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_the_unobservable_directions_depend_on_the_distance_of_a_landmark_only_without_anchors(landmark: str) -> None:
    """Of an anchored one on its anchor and bearing (Cohen, Korotkine and Forbes, arXiv 2606.19307)."""
    model, h_w = LANDMARKS[landmark], np.random.default_rng(0).standard_normal((5, 3))
    near, far = (model.started(np.zeros(3), h_w, np.full(5, scale)).parameters for scale in (1.0, 0.1))
    anchors = np.zeros((5, 3)) if model.anchored else None
    same = np.allclose(model.world_rotation(anchors, near), model.world_rotation(anchors, far), rtol=0, atol=1e-9)
    assert same == model.anchored


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_every_correction_is_delta_to_first_order(landmark: str, error: str) -> None:
    state = some_state(landmark)
    numeric = numeric_jacobian(lambda d: standard_error(state, ERRORS[error].moved(state, d)), len(state.P))
    np.testing.assert_allclose(numeric, np.eye(len(state.P)), rtol=0, atol=1e-7)


@pytest.mark.parametrize("error", ERRORS)
def test_pose_covariance_is_that_of_the_pose_error(error: str) -> None:
    state, definition = some_state("euclidean"), ERRORS[error]
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
    state, definition = some_state("euclidean"), ERRORS[error]
    delta = small_correction(state, 7, 0.4)
    truth = definition.moved(state, delta).camera
    actual, _ = definition.pose_error(state.camera, np.eye(6), truth.position, truth.orientation)
    R_wc, expected = state.camera.R_wc, delta[:6].copy()
    if isinstance(definition, RightInvariant):
        expected[ROTATION] = R_wc @ delta[ROTATION]
        expected[POSITION] += rotations.skew(state.camera.position) @ expected[ROTATION]
    if isinstance(definition, LeftInvariant):
        expected[POSITION] = R_wc.T @ delta[POSITION]
    np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-11)
