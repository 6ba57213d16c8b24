"""Landmarks as they start: which measurements they can start from, their values and Jacobians (Eq. 19-25)."""

from __future__ import annotations

import numpy as np

from filters.contract.observation import StereoObservation
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel
from filters.state.joint_state import JointState, NewLandmarks
from filters.validation import BoolArray, FloatArray

FARTHEST = 1e6
"""No camera measures a pixel or a disparity as large, px; squares of what would come of 1e300 overflow."""


def can_start(
    sensor: MeasurementModel, camera: StereoCamera, state: JointState, uvd: FloatArray, least: float = -np.inf
) -> BoolArray:
    """Which measurements (M, 3) with a disparity of at least `least` a landmark can start from; (M,)."""
    possible: BoolArray = np.all(np.abs(uvd) < FARTHEST, axis=1) & (uvd[:, 2] >= least)
    points_c = sensor.backproject(camera, uvd[possible], state.camera.variables)
    h_w = rotations.turned(state.camera.R_wc, points_c[:, :3])
    possible[possible] = state.model.can_start(h_w, points_c[:, 3]) & np.isfinite(points_c).all(axis=1)
    return possible


def start_landmarks(
    sensor: MeasurementModel, camera: StereoCamera, state: JointState, observation: StereoObservation, R: FloatArray
) -> NewLandmarks:
    """Landmarks at the measurements (M,) of the present pose (Eq. 19-24), with their Jacobians and noise (Eq. 25).

    Parameters
    ----------
    sensor : MeasurementModel
        What is measured.
    camera : StereoCamera
        The rig.
    state : JointState
        Has the pose, the values of the sensor's variables, and the parametrisation.
    observation : StereoObservation
        M measurements.
    R : (M, 3, 3)
        Their covariance.
    """
    variables = state.camera.variables
    points_c = sensor.backproject(camera, observation.uvd, variables)
    jacobians = sensor.backprojection_jacobians(camera, observation.uvd, variables)
    R_wc = state.camera.R_wc
    started = state.model.started(state.camera.position, rotations.turned(R_wc, points_c[:, :3]), points_c[:, 3])
    by_direction_c = started.by_direction @ R_wc
    by_point = np.concatenate([by_direction_c, started.by_scale[:, :, None]], axis=2)
    by_rotation = -by_direction_c @ rotations.skew(points_c[:, :3])
    by_variables = [by_point @ jacobians.by_variable[variable.name] for variable in sensor.variables]
    by_measurement = by_point @ jacobians.by_point
    noise = by_measurement @ R @ by_measurement.transpose(0, 2, 1)
    by_leading = np.concatenate([started.by_position, by_rotation, *by_variables], axis=2)
    return NewLandmarks(observation.ids, started, by_leading, noise)
