"""Joint states to work on: without landmarks, at any camera state and with any covariance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filters import Start
from filters.landmarks.model import LandmarkModel, StartedLandmarks
from filters.motions.model import CameraState
from filters.state import symmetric
from filters.state.joint_state import JointState, NewLandmarks
from filters.state.layout import Layout
from filters.validation import FloatArray, IntArray


def camera_at(position: FloatArray) -> CameraState:
    """A camera at rest that looks along +z."""
    return CameraState(position, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3))


def without_map(camera: CameraState, P: FloatArray, model: LandmarkModel, layout: Layout | None = None) -> JointState:
    """A state with these variables and nothing seen yet."""
    state = JointState.at(Start(), layout or Layout(), model)
    return replace(state, camera=camera, predicted=camera, P=np.asfortranarray(P))


def transform_variables(state: JointState, F: FloatArray, added: FloatArray | None = None) -> None:
    """P of the named variables becomes F P F^T + added."""
    symmetric.transform_leading(state.P, F, np.zeros_like(F) if added is None else added)


def new_landmarks(
    ids: IntArray, parameters: FloatArray, by_pose: FloatArray, noise: FloatArray, anchored: bool | FloatArray
) -> NewLandmarks:
    """Landmarks whose errors are `by_pose` (M, 3, 6) times that of the pose plus noise (M, 3, 3)."""
    count = len(ids)
    nothing = np.zeros((count, 3, 3))
    flags = np.broadcast_to(np.asarray(anchored, dtype=bool), count)
    return NewLandmarks(ids, StartedLandmarks(parameters, nothing, nothing, nothing[:, :, 0], flags), by_pose, noise)
