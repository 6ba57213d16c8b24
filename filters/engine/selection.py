"""Selection of landmarks for a map of limited size: those that leave the next pose least uncertain.

Looking one frame ahead: the camera makes a step, every candidate is measured once more, and the measure is the
determinant of the covariance of the pose then (D-optimality). It counts what a landmark says about the step, and what
it still knows about where the camera was long ago. Candidates are taken away one at a time, the least valuable first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.geometry import symmetric
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.measurements.measurement_model import MeasurementModel, Stage
from filters.motions.motion_model import POSE_SIZE, POSITION
from filters.state.joint_state import JointState
from filters.state.layout import LinearisedMeasurements
from filters.updates.extended import Extended, chain_rule

STEP = np.diag(np.repeat([1.0, 0.1], 3) ** 2)
"""Covariance of the step, m and rad: as good as unknown, so that the landmarks have to tell it."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Next measurements of M landmarks, (u, v, d) each, jointly with the next pose."""

    pose: FloatArray
    """(6, 6): covariance of the next pose without them."""
    cross: FloatArray
    """(6, 3 M): covariance of the next pose with the measurements."""
    S: FloatArray
    """(3 M, 3 M): covariance of the measurements."""


def next_measurements(
    sensor: MeasurementModel,
    camera: StereoCamera,
    state: JointState,
    index: IntArray,
    R: FloatArray,
    new_uvd: FloatArray,
    new_R: FloatArray,
) -> Candidates:
    """Candidates to keep: landmarks in the map first, then measurements that landmarks could start from.

    Parameters
    ----------
    sensor : MeasurementModel
        What is measured.
    camera : StereoCamera
        The rig.
    state : JointState
        Camera, map and covariance.
    index : (M,) int64
        Landmarks in the map.
    R : (M, 3, 3)
        Noise of their measurements, px^2.
    new_uvd, new_R : (N, 3), (N, 3, 3)
        Measurements and their noise. A landmark started there follows the camera: its next measurement depends on the
        step alone, and has the noise of both measurements.
    """
    stage = Stage(np.zeros((len(index), 3)), np.eye(3, sensor.size), R)
    known = Extended().linearise(sensor, camera, state, index, stage)
    count = known.innovation.size
    new_by_step = _by_step(sensor, camera, state, new_uvd)
    by_step = np.concatenate([known.by_leading[:, :, :POSE_SIZE], new_by_step]).reshape(-1, POSE_SIZE)
    S = by_step @ STEP @ by_step.T
    HP = times_covariance(known, state.P)
    S[:count, :count] += joint_innovation_covariance(known, HP)
    new_rows = count + np.arange(3 * len(new_uvd)).reshape(-1, 3)
    S[new_rows[:, :, None], new_rows[:, None, :]] += 2.0 * new_R
    cross = STEP @ by_step.T
    cross[:, :count] += HP[:, :POSE_SIZE].T
    return Candidates(symmetric.full(state.P[:POSE_SIZE, :POSE_SIZE]) + STEP, cross, S)


def most_informative(candidates: Candidates, count: int) -> BoolArray:
    """Which `count` of the M candidates to keep, or all if there are not more; (M,)."""
    total = len(candidates.S) // 3
    kept = np.ones(total, dtype=bool)
    precision = np.linalg.inv(candidates.S)
    gain = candidates.cross @ precision
    posterior = candidates.pose - gain @ candidates.cross.T
    every = np.arange(total)
    for _ in range(total - count):
        # Without measurement i the posterior covariance grows by B_i A_ii^-1 B_i^T, A the precision and B the gain.
        own = precision.reshape(total, 3, total, 3)[every, :, every]
        B = gain.reshape(POSE_SIZE, total, 3).transpose(1, 2, 0)
        solved = np.linalg.solve(own, B)
        growth = np.linalg.det(np.eye(3) + B @ np.linalg.solve(posterior, solved.transpose(0, 2, 1)))
        least = int(np.argmin(np.where(kept, growth, np.inf)))
        rows = slice(3 * least, 3 * least + 3)
        posterior = posterior + B[least].T @ solved[least]
        gain = gain - solved[least].T @ precision[rows]
        precision = precision - precision[:, rows] @ np.linalg.solve(own[least], precision[rows])
        kept[least] = False
        # What is gone says nothing: a neutral block keeps the rest of the matrix regular.
        gain[:, rows] = 0.0
        precision[rows], precision[:, rows] = 0.0, 0.0
        precision[rows, rows] = np.eye(3)
    return kept


def _by_step(sensor: MeasurementModel, camera: StereoCamera, state: JointState, uvd: FloatArray) -> FloatArray:
    """Derivative of (u, v, d) of landmarks now seen there by a step of the camera; (N, 3) -> (N, 3, 6)."""
    model, here, values = state.model, state.camera, sensor.values_at(state.camera)
    position, R_wc = state.viewpoint
    new = model.started(position, *model.apart(model.with_axes(R_wc, sensor.backproject(camera, uvd, values))))
    anchors = np.where(new.anchored[:, None], position, np.nan) if model.anchored else None
    seen = model.relative_to(position, anchors, new.parameters)
    points_c = model.with_axes(R_wc.T, seen.homogeneous)
    by_point = sensor.jacobians(camera, points_c, values).by_point[:, :3]
    by_step = chain_rule(R_wc, seen, points_c, by_point, model.seen_vectors)[0]
    by_step[:, :, POSITION] = by_step[:, :, POSITION] @ (R_wc @ here.R_wc.T)
    return by_step


def joint_innovation_covariance(measurements: LinearisedMeasurements, HP: FloatArray) -> FloatArray:
    """S = (H P) H^T + R of all measurements together, (M k, M k)."""
    count, size, width = measurements.by_map.shape
    leading = measurements.by_leading.shape[2]
    S: FloatArray = HP[:, :leading] @ measurements.by_leading.reshape(count * size, leading).T
    own = HP[:, measurements.map_rows.ravel()].reshape(count * size, count, width).transpose(1, 0, 2)
    S += (own @ measurements.by_map.transpose(0, 2, 1)).transpose(1, 0, 2).reshape(S.shape)
    every = np.arange(count)
    S.reshape(count, size, count, size)[every, :, every, :] += measurements.R
    return S


def times_covariance(part: LinearisedMeasurements, P: FloatArray) -> FloatArray:
    """H P, (M k, n)."""
    count, size, width = part.by_map.shape
    leading = part.by_leading.shape[2]
    HP: FloatArray = part.by_leading.reshape(count * size, leading) @ symmetric.leading_rows(P, leading)
    own = symmetric.rows(P, part.map_rows.ravel()).reshape(count, width, len(P))
    HP += (part.by_map @ own).reshape(HP.shape)
    return HP
