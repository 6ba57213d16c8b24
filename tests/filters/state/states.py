"""Joint states to work on: without landmarks, at any camera state and with any covariance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from filters import Start
from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.joint_state import JointState, StateLayout
from filters.landmarks.landmark_model import LandmarkModel
from filters.motions.motion_model import CameraState


@dataclass(frozen=True)
class NewLandmarks:
    """M landmarks that enter the map."""

    ids: IntArray
    values: FloatArray
    """(M, v)."""
    anchored: BoolArray
    """(M,)."""
    by_leading: FloatArray
    """(M, size, c): Jacobian of their errors by the leading rows."""
    noise: FloatArray
    """(M, size, size): what the measurement adds."""


def camera_at(position: FloatArray) -> CameraState:
    """A camera at rest that looks along +z."""
    return CameraState(position, np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3))


def without_map(
    camera: CameraState, P: FloatArray, model: LandmarkModel, layout: StateLayout | None = None
) -> JointState:
    """A state with these variables and nothing seen yet."""
    state = JointState.at(Start(), layout or StateLayout(), model)
    return replace(state, camera=camera, predicted=camera, P=np.asfortranarray(P))


def transform_variables(state: JointState, F: FloatArray, added: FloatArray | None = None) -> None:
    """P of the named variables becomes F P F^T + added."""
    size, P = len(F), state.P
    moved = F @ symmetric.full(P[:size, :size]) @ F.T + (0.0 if added is None else added)
    P[:size, :size] = 0.5 * (moved + moved.T)
    P[size:, :size] = P[size:, :size] @ F.T


def new_landmarks(
    ids: IntArray, parameters: FloatArray, by_pose: FloatArray, noise: FloatArray, anchored: bool | FloatArray
) -> NewLandmarks:
    """Landmarks whose errors are `by_pose` (M, 3, 6) times that of the pose plus noise (M, 3, 3)."""
    return NewLandmarks(ids, parameters, np.broadcast_to(np.asarray(anchored, dtype=bool), len(ids)), by_pose, noise)


def augment(state: JointState, new: NewLandmarks) -> None:
    """Add landmarks, with what they have in common with everything else: the errors of the pose (Eq. 19-25)."""
    model, count = state.model, len(new.ids)
    anchors = int(new.anchored.sum())
    which = np.cumsum(new.anchored) - 1
    if model.shares_anchors:
        anchors, which = min(anchors, 1), np.zeros_like(which)
    values = np.zeros((anchors + count, model.value_size))
    values[:anchors, :3], values[anchors:] = state.camera.position, new.values
    J = np.zeros((anchors + count, state.size, new.by_leading.shape[2]))
    J[:anchors, :3, :3], J[anchors:] = np.eye(3), new.by_leading
    J = J.reshape(-1, J.shape[2])
    cross = J @ symmetric.full(state.P)[: J.shape[1]]
    own = cross[:, : J.shape[1]] @ J.T
    for i, noise in enumerate(new.noise, anchors):
        rows = slice(state.size * i, state.size * (i + 1))
        own[rows, rows] += noise
    held, made = state.held, state.append(values, values, cross, own)
    state.held = held
    anchor = np.where(new.anchored, made[np.where(new.anchored, which, 0)], -1)
    state.adopt(new.ids, made[anchors:], anchor)


def remove(state: JointState, gone: BoolArray) -> None:
    """Marginalise landmarks out."""
    state.rest(gone, state.held)
