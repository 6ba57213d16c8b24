"""Prediction of measurements and its Jacobian: Eq. 8-10 and 13-14 for many landmarks at once."""

from __future__ import annotations

import numpy as np

from filters import rotations
from filters.camera import StereoCamera
from filters.engine.joint_state import JointState
from filters.engine.kalman import LinearisedMeasurements
from filters.measurements.model import Stage
from filters.validation import BoolArray, FloatArray, IntArray


def project(camera: StereoCamera, state: JointState, index: IntArray) -> tuple[FloatArray, BoolArray]:
    """Predicted (u, v, d) of the landmarks at `index`, (M, 3) px, and whether their rays point forward, (M,)."""
    seen = state.model.relative_to(state.camera.position, state.anchors(index), state.parameters(index))
    h_c = seen.homogeneous[:, :3] @ state.camera.R_wc
    return camera.project_scaled(h_c, seen.homogeneous[:, 3]), h_c[:, 2] > 0


def linearise(
    camera: StereoCamera, state: JointState, index: IntArray, stage: Stage, point: JointState | None = None
) -> LinearisedMeasurements:
    """Innovations (Eq. 14) of a stage at `state`, with H by the chain rule through Eq. 8-10.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    state : JointState
        Predicts the measurements.
    index : (M,) int64
        Landmarks of the stage.
    stage : Stage
        M measurements.
    point : JointState, optional
        Where H is evaluated, if elsewhere than at `state`.
    """
    at = state if point is None else point
    R_cw = at.camera.R_wc.T
    seen = at.model.relative_to(at.camera.position, at.anchors(index), at.parameters(index))
    h_c, scale = seen.homogeneous[:, :3] @ R_cw.T, seen.homogeneous[:, 3]
    z_by_camera = stage.T @ camera.project_scaled_jacobian(h_c, scale)
    z_by_world = np.concatenate([z_by_camera[:, :, :3] @ R_cw, z_by_camera[:, :, 3:]], axis=2)
    by_position = z_by_world @ seen.by_position
    by_rotation = z_by_camera[:, :, :3] @ rotations.skew(h_c)
    by_map = z_by_world @ seen.by_parameters
    if seen.by_anchor is not None:
        by_map = np.concatenate([z_by_world @ seen.by_anchor, by_map], axis=2)
    predicted = camera.project_scaled(h_c, scale) if point is None else project(camera, state, index)[0]
    return LinearisedMeasurements(
        stage.z - predicted @ stage.T.T,
        np.concatenate([by_position, by_rotation], axis=2),
        by_map,
        state.map_rows(index),
        stage.R,
    )
