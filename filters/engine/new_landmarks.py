"""Landmarks as they start: which measurements they can start from, their values and Jacobians (Eq. 19-25)."""

from __future__ import annotations

import numpy as np

from filters.contract.inputs import StereoObservation
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.kernels.landmarks import FARTHEST
from filters.measurements.measurement_model import MeasurementModel
from filters.state.joint_state import JointState, NewLandmarks
from filters.updates.extended import chain_rule


def can_start(
    sensor: MeasurementModel, camera: StereoCamera, state: JointState, uvd: FloatArray, least: float = -np.inf
) -> BoolArray:
    """Which measurements (M, 3) with a disparity of at least `least` a landmark can start from; (M,)."""
    possible: BoolArray = np.all(np.abs(uvd) < FARTHEST, axis=1) & (uvd[:, 2] >= least)
    points_c = sensor.backproject(camera, uvd[possible], sensor.values_at(state.camera))
    seen = state.model.apart(state.model.with_axes(state.viewpoint[1], points_c))
    possible[possible] = state.model.can_start(*seen) & np.isfinite(points_c).all(axis=1)
    return possible


def start_landmarks(
    sensor: MeasurementModel, camera: StereoCamera, state: JointState, observation: StereoObservation, R: FloatArray
) -> NewLandmarks:
    """Landmarks at the measurements (M,) of the present pose (Eq. 19-24), with their Jacobians and noise (Eq. 25).

    What the measurement leaves open comes in with its prior, at whatever the measurement then says of the rest: with
    G = d numbers / d z and H = d z / d numbers there, P += (I - G H) prior (I - G H)^T, as after an update with gain G.

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
    values, model, (position, R_wc) = sensor.values_at(state.camera), state.model, state.viewpoint
    points_c = sensor.backproject(camera, observation.uvd, values)
    jacobians = sensor.backprojection_jacobians(camera, observation.uvd, values)
    started = model.started(position, *model.apart(model.with_axes(R_wc, points_c)))
    by_point, by_rotation = started.by_seen, np.zeros((len(points_c), model.size, 3))
    for i in range(model.seen_vectors):
        vector = slice(3 * i, 3 * i + 3)
        by_point[:, :, vector] = by_point[:, :, vector] @ R_wc
        by_rotation -= by_point[:, :, vector] @ rotations.skew(points_c[:, vector])
    by_variable = {name: by_point @ J for name, J in jacobians.by_variable.items()}
    by_measurement = by_point @ jacobians.by_point
    noise = by_measurement @ R @ by_measurement.transpose(0, 2, 1)
    if model.prior is not None:
        anchors = np.broadcast_to(position, (len(points_c), 3)) if model.anchored else None
        seen = model.relative_to(position, anchors, started.parameters)
        z_by_point = sensor.jacobians(camera, points_c, values).by_point[:, :3]
        z_by_open = chain_rule(R_wc, seen, points_c, z_by_point, model.seen_vectors)[1][:, :, 3 - model.size :]
        by_open = np.eye(model.size)[:, 3:] - by_measurement @ z_by_open
        noise += by_open @ model.prior @ by_open.transpose(0, 2, 1)
    by_pose = np.concatenate([started.by_position, by_rotation], axis=2)
    if model.in_anchor:
        by_pose[:] = 0.0
    by_leading = sensor.by_leading(by_pose, by_variable, state.camera)
    return NewLandmarks(observation.ids, started, by_leading, noise)
