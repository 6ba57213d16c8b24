"""`run_trials`: whole sequences of observations through one filter, many trials together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from filters.engine.ekf import StereoEKF
from filters.interface import BodyVelocity, StereoObservation
from filters.trials.ekf import StereoEKFTrials
from filters.validation import FloatArray, IntArray, finite_array

TOGETHER = 64  # trials: enough that the cost of Python vanishes in the algebra


@dataclass(frozen=True, eq=False)
class TrialSeries:
    """What one filter believed in K frames of B trials.

    Attributes
    ----------
    positions, orientations : (B, K, 3), (B, K, 4)
        r^WC, m, and q^WC, xyzw.
    pose_covariances : (B, K, 6, 6)
        As in `PoseBelief`.
    nis, nis_dof : (B, K)
        Normalised innovation squared and its degrees of freedom.
    """

    positions: FloatArray
    orientations: FloatArray
    pose_covariances: FloatArray
    nis: FloatArray
    nis_dof: IntArray


def run_trials(
    one: StereoEKF,
    sequences: Sequence[Sequence[StereoObservation]],
    timestamps: ArrayLike,
    *,
    odometry: Sequence[Sequence[BodyVelocity | None]] | None = None,
    starts: Sequence[Mapping[str, Any]] | None = None,
    together: int = TOGETHER,
) -> TrialSeries:
    """Run a filter over B sequences of observations; each gets what `one` would give it, to rounding.

    Parameters
    ----------
    one : StereoEKF
        The filter; it is left as it is.
    sequences : B sequences of K StereoObservation
        A frame of a sequence may be empty.
    timestamps : (K,)
        Of the frames, s, the same in all trials.
    odometry : B sequences of K BodyVelocity or None, optional
        Of the step that ends with the frame; the first entry is not used.
    starts : B mappings, optional
        Arguments of `StereoFilter.reset` for each trial; None: its defaults.
    together : int
        Trials in lock-step at a time; more need more memory.

    Raises
    ------
    ValueError
        Sequences of different lengths, timestamps that do not ascend, or what `StereoEKFTrials` refuses.
    """
    times = finite_array("timestamps", timestamps, ("K",))
    trials, frames = len(sequences), len(times)
    for name, given in (("sequences", sequences), ("odometry", odometry)):
        wrong = [b for b, sequence in enumerate(given or ()) if len(sequence) != frames]
        if wrong:
            raise ValueError(f"{name} must have one entry per timestamp: {frames}, not so in trial {wrong[0]}")
    for name, of_trials in (("odometry", odometry), ("starts", starts)):
        if of_trials is not None and len(of_trials) != trials:
            raise ValueError(f"{name} must be one for each of {trials} sequences, got {len(of_trials)}")
    if type(together) is not int or together < 1:
        raise ValueError(f"together must be an integer >= 1, got {together!r}")
    series = TrialSeries(
        np.empty((trials, frames, 3)),
        np.empty((trials, frames, 4)),
        np.empty((trials, frames, 6, 6)),
        np.empty((trials, frames)),
        np.empty((trials, frames), dtype=np.int64),
    )
    for first in range(0, trials, together):
        group = slice(first, first + together)
        slam = StereoEKFTrials(one, len(sequences[group]))
        slam.reset(None if starts is None else starts[group])
        for k, observations in enumerate(zip(*sequences[group], strict=True)):
            if k:
                slam.predict(times[k] - times[k - 1], None if odometry is None else [own[k] for own in odometry[group]])
            reports, pose = slam.update(observations), slam.pose
            series.positions[group, k], series.orientations[group, k] = pose.position, pose.orientation
            series.pose_covariances[group, k] = pose.covariance
            series.nis[group, k], series.nis_dof[group, k] = reports.nis, reports.nis_dof
    return series
