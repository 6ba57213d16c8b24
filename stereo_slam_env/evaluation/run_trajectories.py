"""Trajectories of a run: the estimate with the covariances that were scored, and the truth with its stated errors."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.recording.trajectory import Tangent, Trajectory, pose_errors, tangent_jacobian, transformed

BODY = "left_camera"


def estimate_of(run: FilterRun) -> Trajectory | None:
    """The estimated poses, with their covariances for the filter's own error; None where there are none."""
    known = _finite(run.positions, run.orientations, run.pose_covariances)
    if not known.any():
        return None
    positions, orientations = run.positions[known], run.orientations[known]
    tangent = tangent_of(run)
    J = tangent_jacobian(tangent, positions, orientations)
    covariances = transformed(J, run.pose_covariances[known])
    return Trajectory(positions, orientations, run.timestamps[known], covariances, tangent, run.filter_name, body=BODY)


def truth_of(run: FilterRun) -> Trajectory | None:
    """The true poses; None where there are none."""
    known = _finite(run.true_positions, run.true_orientations)
    if not known.any():
        return None
    return Trajectory(
        run.true_positions[known], run.true_orientations[known], run.timestamps[known], name="truth", body=BODY
    )


def reference_of(run: FilterRun) -> Trajectory | None:
    """The true poses that are scored, and the first one, with the errors that are stated of them."""
    truth = truth_of(run)
    if truth is None or truth.timestamps is None:
        return None
    stated = run.truth_from
    at = stated.has_settled(truth.timestamps)
    at[0] = True
    truth = truth.rows(at)
    if stated.is_exact:
        return truth
    start = truth.pose(0)
    covariances = np.array([stated.covariance(start, truth.pose(row)) for row in range(len(truth))])
    return replace(truth, covariances=covariances)


def tangent_of(run: FilterRun) -> Tangent:
    """Definition of the error that the run's `pose_errors` are of; without any, that of `PoseBelief`."""
    known = _finite(run.positions, run.orientations, run.true_positions, run.true_orientations, run.pose_errors)
    if not known.any():
        return "position-rotation"
    poses = (run.positions, run.orientations, run.true_positions, run.true_orientations)

    def difference(tangent: Tangent) -> float:
        errors = pose_errors(tangent, *(part[known] for part in poses))
        return float(np.abs(errors - run.pose_errors[known]).max())

    return min(get_args(Tangent), key=difference)


def _finite(*series: FloatArray) -> BoolArray:
    """Frames in which all of these are known, (K,)."""
    return np.asarray(np.all([np.isfinite(one.reshape(len(one), -1)).all(axis=1) for one in series], axis=0))
