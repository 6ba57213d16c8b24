"""Prediction of measurements and its Jacobian: Eq. 8-10 and 13-14 for many landmarks at once.

Derivation: docs/derivations/measurements.md.
"""

from __future__ import annotations

import numpy as np

from filters import rotations
from filters.camera import StereoCamera
from filters.engine.joint_state import JointState
from filters.engine.kalman import LinearisedMeasurements
from filters.landmarks.parametrisation import ScaledPoints
from filters.measurements.model import Stage
from filters.motion import POSE_SIZE, POSITION, ROTATION
from filters.validation import BoolArray, FloatArray, IntArray


def project(camera: StereoCamera, state: JointState, index: IntArray) -> tuple[FloatArray, BoolArray]:
    """Predicted (u, v, d) of the landmarks at `index`, (M, 3) px, and whether their rays point forward, (M,)."""
    seen = state.model.homogeneous(state.camera.position, state.anchors(index), state.parameters(index))
    h_c = seen[:, :3] @ state.camera.R_wc
    return camera.project_scaled(h_c, seen[:, 3]), h_c[:, 2] > 0


def in_front(state: JointState, index: IntArray) -> BoolArray:
    """Whether the rays of the landmarks at `index` point forward, (M,)."""
    seen = state.model.homogeneous(state.camera.position, state.anchors(index), state.parameters(index))
    forward: BoolArray = seen[:, :3] @ state.camera.R_wc[:, 2] > 0
    return forward


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
    seen = at.model.relative_to(at.camera.position, at.anchors(index), at.parameters(index))
    h_c = rotations.turned(at.camera.R_wc.T, seen.homogeneous[:, :3])
    by_pose, by_map = measurement_jacobians(camera, at.camera.R_wc, seen, h_c, stage.T)
    uvd = camera.project_scaled(h_c, seen.homogeneous[:, 3]) if point is None else project(camera, state, index)[0]
    return LinearisedMeasurements(stage.z - uvd @ stage.T.T, by_pose, by_map, state.map_rows(index), stage.R)


def measurement_jacobians(
    camera: StereoCamera, R_wc: FloatArray, seen: ScaledPoints, h_c: FloatArray, T: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """H of z = T (u, v, d) by the chain rule through Eq. 8-10.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    R_wc : (3, 3) or (M, 3, 3)
        Orientation, one for all landmarks or one for each.
    seen : ScaledPoints
        M landmarks relative to the camera centre.
    h_c : (M, 3)
        Their directions in the camera frame.
    T : (k, 3)
        Rows of the measurement.

    Returns
    -------
    by_pose, by_map : (M, k, 6), (M, k, w)
        By position and rotation, and by the landmark's own numbers.
    """
    z_by_camera = T @ camera.project_scaled_jacobian(h_c, seen.homogeneous[:, 3])
    z_by_world = z_by_camera.copy()
    z_by_world[:, :, :3] = z_by_camera[:, :, :3] @ R_wc.swapaxes(-1, -2)
    by_pose = np.empty((len(h_c), len(T), POSE_SIZE))
    by_pose[:, :, POSITION] = z_by_world @ seen.by_position
    by_pose[:, :, ROTATION] = z_by_camera[:, :, :3] @ rotations.skew(h_c)
    return by_pose, z_by_world @ seen.by_map
