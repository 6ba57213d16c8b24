"""`Arithmetic` by the compiled kernels: the engine's data as arrays, and back. Importing it imports Numba."""

from __future__ import annotations

from typing import Any

import numpy as np

from filters.camera import StereoCamera
from filters.engine import linearisation
from filters.engine.error_definition import StandardError
from filters.engine.gating import FateArray
from filters.engine.joint_state import JointState
from filters.engine.kalman import Correction, LinearisedMeasurements
from filters.engine.kernels import camera as kernel_camera
from filters.engine.kernels import gating as kernel_gating
from filters.engine.kernels import inverse_depth as kernel_inverse_depth
from filters.engine.kernels import kalman as kernel_kalman
from filters.engine.kernels import linearisation as kernel_linearisation
from filters.engine.kernels import stage as kernel_stage
from filters.engine.retraction import AdditiveQuaternion
from filters.engine.steps import Arithmetic
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.parametrisation import LandmarkModel, NewLandmarks
from filters.landmarks.shared_anchor import SharedAnchorInverseDepth
from filters.measurements.model import Stage
from filters.motion import CameraState, ConstantVelocity, MotionModel
from filters.validation import FloatArray, IntArray

CHUNK_ROWS = 36
"""See `kalman.CHUNK_ROWS`; here a pass costs less."""
_KNOWN = (InverseDepth, SharedAnchorInverseDepth, Euclidean)
"""Parametrisations the kernels know; NumPy does the others."""


def linearise(
    camera: StereoCamera, state: JointState, index: IntArray, stage: Stage, point: JointState | None = None
) -> LinearisedMeasurements:
    """`linearisation.linearise`."""
    if type(state.model) not in _KNOWN:
        return linearisation.linearise(camera, state, index, stage, point)
    at = state if point is None else point
    predicted, by_camera, by_map, map_rows, _ = kernel_linearisation.linearise(*_seen(camera, at), index, stage.T)
    if point is not None:
        predicted = linearisation.project(camera, state, index)[0] @ stage.T.T
    return LinearisedMeasurements(stage.z - predicted, by_camera, by_map, map_rows, stage.R)


def squared_distances(P: FloatArray, measurements: LinearisedMeasurements) -> FloatArray:
    """`kalman.squared_distances`."""
    distances: FloatArray = kernel_gating.squared_distances(P, *_arrays(measurements))
    return distances


def update(P: FloatArray, measurements: LinearisedMeasurements) -> Correction:
    """`kalman.update`."""
    delta, nis, used = kernel_kalman.correct(P, *_arrays(measurements), _chunk(measurements.innovation))
    return Correction(delta, nis, int(used.sum()) * measurements.innovation.shape[1], used)


def transform_leading(P: FloatArray, F: FloatArray, added: FloatArray) -> None:
    """`symmetric.transform_leading`; a function of its own, so that filters can be pickled."""
    kernel_camera.transform_leading(P, F, added)


def correct_stage(
    camera: StereoCamera, state: JointState, index: IntArray, stage: Stage, limit: float, fates: FateArray
) -> tuple[FloatArray, float, int] | None:
    """The plain stage in one call, see `Arithmetic`."""
    if type(state.model) not in _KNOWN:
        return None
    delta, nis, dof = kernel_stage.correct_stage(
        state.P, *_seen(camera, state), index, stage.T, stage.z, stage.R, limit, _chunk(stage.z), fates
    )
    return delta, nis, dof


def initialise(model: LandmarkModel, camera: StereoCamera, state: CameraState, uvd: FloatArray) -> NewLandmarks | None:
    """`InverseDepth.initialise`."""
    if type(model) not in (InverseDepth, SharedAnchorInverseDepth):
        return None
    parameters, by_rotation, by_measurement = kernel_inverse_depth.initialise(
        _intrinsics(camera), state.orientation, uvd
    )
    anchored = np.ones(len(uvd), dtype=bool)
    return NewLandmarks(parameters, np.zeros_like(by_rotation), by_rotation, by_measurement, anchored)


def _intrinsics(camera: StereoCamera) -> tuple[float, float, float, float, float]:
    return camera.fx, camera.fy, camera.cx, camera.cy, camera.disparity_constant


def _chunk(z: FloatArray) -> int:
    """Measurements at a time."""
    rows: int = z.shape[1]
    return max(1, CHUNK_ROWS // rows)


def _seen(camera: StereoCamera, state: JointState) -> tuple[Any, ...]:
    return (
        _intrinsics(camera),
        state.camera.position,
        state.camera.orientation,
        state.blocks,
        state.anchor_block,
        state.parameter_block,
        6 if state.model.anchored else 3,
    )


def _arrays(measurements: LinearisedMeasurements) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, FloatArray]:
    return (
        np.ascontiguousarray(measurements.innovation),
        np.ascontiguousarray(measurements.by_camera),
        np.ascontiguousarray(measurements.by_map),
        measurements.map_rows,
        measurements.R,
    )


def predict(state: JointState, motion: MotionModel, dt: float) -> CameraState | None:
    """P moved by the constant-velocity model in one call, and the camera it leads to."""
    if type(motion) is not ConstantVelocity:  # a subclass may move the camera otherwise
        return None
    camera = state.camera
    pose = kernel_camera.predict(
        state.P,
        camera.position,
        camera.orientation,
        camera.linear_velocity,
        camera.angular_velocity,
        dt,
        (motion.sigma_acceleration * dt) ** 2,
        (motion.sigma_angular_acceleration * dt) ** 2,
    )
    return CameraState(pose[:3], pose[3:], camera.linear_velocity, camera.angular_velocity)


def retract(state: JointState, error: StandardError, delta: FloatArray) -> bool:
    """The state corrected by delta in place, P carried along, in one call; whether there is such a call."""
    if type(error) is not StandardError:
        return False
    camera = state.camera
    x, blocks = kernel_camera.retract(
        state.P,
        camera.position,
        camera.orientation,
        camera.linear_velocity,
        camera.angular_velocity,
        state.blocks,
        delta,
        isinstance(error.retraction, AdditiveQuaternion),
    )
    state.camera, state.blocks = CameraState(x[:3], x[3:7], x[7:10], x[10:]), blocks
    return True


COMPILED = Arithmetic(
    linearise, squared_distances, update, transform_leading, correct_stage, predict, retract, initialise
)
