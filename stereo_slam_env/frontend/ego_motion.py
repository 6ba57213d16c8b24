"""The motion of the camera between two pairs, in spite of landmarks that move or were matched wrongly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import rotations
from filters.camera import StereoCamera
from filters.engine.gating import gate_limit
from filters.validation import BoolArray, FloatArray
from stereo_slam_env.frontend.stereo_step import (
    Pairs,
    Step,
    StepEstimate,
    most_likely_step,
    perspective_n_point,
    squared_distances,
    transfer,
)

MIN_POINTS = 8
_ROUNDS = 10
_CONVERGED = 1e-5  # m and rad: a thousandth of a pixel at most
_MEDIAN_FACTOR = 4.0  # the median of chi-square with 3 degrees of freedom is 2.4: a pair beyond 9.5 is none of ours
_TRUSTED_SHARE = 0.85  # with fewer inliers the start may have been wrong, or near to the motion of a slow body


@dataclass(frozen=True, eq=False)
class RobustStep:
    """A step and the pairs that agree with it.

    Attributes
    ----------
    estimate : StepEstimate
        From the inliers.
    inliers : (M,) bool
        Within the gate.
    """

    estimate: StepEstimate
    inliers: BoolArray

    @property
    def step(self) -> Step:
        """The motion."""
        return self.estimate.step


def robust_step(camera: StereoCamera, pairs: Pairs, start: Step | None, *, gate: float = 0.99) -> RobustStep | None:
    """The most likely step of the largest consistent part of `pairs`.

    From `start` the gate closes in with the median distance; where that leaves less than 85 % of the pairs, or there
    is no start, PnP with RANSAC gives another one, and the larger consensus wins.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    pairs : Pairs
        Measurements in both frames.
    start : Step or None
        Expected motion.
    gate : float
        Probability with which a consistent pair is an inlier.

    Returns
    -------
    RobustStep or None
        None where fewer than `MIN_POINTS` pairs agree.
    """
    if len(pairs) < MIN_POINTS:
        return None
    found = None if start is None else _closing_in(camera, pairs, start, gate)
    if found is None or found.inliers.sum() < _TRUSTED_SHARE * len(pairs):
        near = np.flatnonzero(pairs.first[:, 2] > 1.0)
        ransac = perspective_n_point(camera, pairs.select(near), MIN_POINTS) if len(near) >= MIN_POINTS else None
        other = None if ransac is None else _closing_in(camera, pairs, ransac[0], gate)
        if other is not None and (found is None or other.inliers.sum() > found.inliers.sum()):
            return other
    return found


def _closing_in(camera: StereoCamera, pairs: Pairs, step: Step, gate: float) -> RobustStep | None:
    limit = gate_limit(gate, 3)
    chosen: BoolArray | None = None
    estimate: StepEstimate | None = None
    distances = squared_distances(camera, pairs, step)
    for _ in range(_ROUNDS):
        inliers = distances <= max(limit, _MEDIAN_FACTOR * float(np.median(distances)))
        inliers &= np.isfinite(distances)
        if inliers.sum() < MIN_POINTS:
            return None
        if chosen is not None and np.array_equal(chosen, inliers):
            break
        chosen = inliers
        estimate = most_likely_step(camera, pairs.select(chosen), step, converged=_CONVERGED)
        if estimate is None:
            return None
        step = estimate.step
        distances = squared_distances(camera, pairs, step)
    assert estimate is not None
    return RobustStep(estimate, distances <= limit)


def continued(step: Step, ratio: float) -> Step:
    """The step of constant velocity over `ratio` times the time."""
    return Step(rotations.exp(ratio * rotations.log(step.R)), ratio * step.t)


def chained(first: Step, second: Step) -> Step:
    """The step from before `first` to after `second`."""
    return Step(first.R @ second.R, first.t + first.R @ second.t)


def predicted(
    camera: StereoCamera, uvd: FloatArray, R: FloatArray, step: Step, step_covariance: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Where measurements will be after a step, and how well that is known.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    uvd, R : (N, 3), (N, 3, 3)
        Measurements before the step with their covariances, px.
    step : Step
        Expected motion.
    step_covariance : (6, 6)
        Of its error: t (m), then the rotation on the right (rad).

    Returns
    -------
    uvd : (N, 3) ndarray
    covariances : (N, 3, 3) ndarray
        Of the landmark's true image, without the noise of the next measurement.
    in_front : (N,) ndarray of bool
    """
    moved = transfer(camera, uvd, step)
    covariances = moved.by_first @ R @ moved.by_first.transpose(0, 2, 1)
    covariances = covariances + moved.by_step @ step_covariance @ moved.by_step.transpose(0, 2, 1)
    return moved.uvd, covariances, moved.in_front
