"""Scores of the states beside the pose, velocity and biases: their errors, and the covariance claimed for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from filters.checks.consistency import are_definite
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.claims import ClaimScore, score_of
from stereo_slam_env.evaluation.gauges import AlignedPair
from stereo_slam_env.recording.state_beliefs import UNITS_OF, StateBelief
from stereo_slam_env.recording.trajectory import Trajectory

_OFF, _FITS = 0.5, 0.2
"""Shares of the speed: a velocity that differs by more from the motion of the positions, and in the body by less, is
given in the body."""

_NOT_CARRIED = (
    "the covariance of the velocity is turned with the world, but not carried through the alignment '{}': that needs "
    "its correlation with the poses, which no file has; its NEES is exact without an alignment ('none')"
)


@dataclass(frozen=True, eq=False)
class ScoredStates:
    """Scores of the states that both the estimate and the reference have."""

    rmse: Mapping[str, float] = field(default_factory=dict)
    """Root mean square of the length of the error, in the units of `UNITS_OF`."""
    claims: Mapping[str, ClaimScore] = field(default_factory=dict)
    """Claims, of those with covariances."""
    nees: Mapping[str, FloatArray] = field(default_factory=dict)
    """(K,) of each, NaN where a covariance is none."""
    log_scores: Mapping[str, FloatArray] = field(default_factory=dict)
    """(K,) of each."""
    notes: tuple[str, ...] = ()
    """What is to be known beside the figures."""


def score_states(pair: AlignedPair, obstacle: str, *, is_exact: bool, of_a_pair: bool = False) -> ScoredStates:
    """Score velocity and biases of a pair of trajectories in one world.

    `obstacle` says why the pose is not judged, which holds for them, too; `is_exact` whether the alignment takes
    nothing off what is claimed; `of_a_pair` as of `ClaimScore`.
    """
    estimate, reference = pair.estimate, pair.reference
    names = [name for name in UNITS_OF if name in estimate.states and name in reference.states]
    scores: dict[str, tuple[ClaimScore, FloatArray, FloatArray]] = {}
    rmse: dict[str, float] = {}
    notes = []
    for name in names:
        mine, truth = estimate.states[name], reference.states[name]
        errors = truth.values - mine.values
        finite: BoolArray = np.asarray(np.isfinite(errors).all(axis=1))
        if not finite.any():
            continue
        rmse[name] = metrics.root_mean_square(np.linalg.norm(errors[finite], axis=1))
        covariances = _together(mine, truth)
        if covariances is None:
            continue
        why = obstacle
        if name == "velocity":
            why = why or _in_body(estimate) or _in_body(reference)
            if not is_exact:
                notes.append(_NOT_CARRIED.format(pair.alignment.kind))
        usable = np.array(finite)
        usable[finite] = are_definite(covariances[finite])
        if usable.any():
            scores[name] = score_of(name, errors, covariances, usable, finite, why, of_a_pair)
        else:
            notes.append(f"none of the covariances of the {name} of {estimate.name} is positive definite: not judged")
    return ScoredStates(
        rmse,
        {name: claim for name, (claim, _, _) in scores.items()},
        {name: nees for name, (_, nees, _) in scores.items()},
        {name: log_scores for name, (_, _, log_scores) in scores.items()},
        tuple(notes),
    )


def _together(mine: StateBelief, truth: StateBelief) -> FloatArray | None:
    """Covariances (K, 3, 3) of the errors of both; None where nothing is claimed."""
    if mine.covariances is None or truth.covariances is None:
        return mine.covariances
    return mine.covariances + truth.covariances


def _in_body(trajectory: Trajectory) -> str:
    """A sentence where a velocity is that of the positions along the axes of the body; empty where it is in W."""
    times, v = trajectory.timestamps, trajectory.states["velocity"].values
    finite = np.isfinite(v).all(axis=1)
    if times is None or len(times) < 3 or not trajectory.is_oriented or not finite.any():
        return ""
    moved = np.gradient(trajectory.positions, times, axis=0)[finite]
    turned = rotations.turned(rotations.matrix(trajectory.orientations), v)[finite]
    speed = np.median(np.linalg.norm(moved, axis=1))
    off, off_turned = (np.median(np.linalg.norm(one - moved, axis=1)) for one in (v[finite], turned))
    if not (off > _OFF * speed and off_turned < _FITS * speed):
        return ""
    return f"the velocity of {trajectory.name} is along the axes of its body: write it in the world"
