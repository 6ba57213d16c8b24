"""Several runs of one estimator against one reference: a mean NEES (ANEES) whose band narrows with their number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.bands import mean_band, mean_bands
from stereo_slam_env.evaluation.claims import verdict_of
from stereo_slam_env.evaluation.trajectory_score import TrajectoryScore


@dataclass(frozen=True, eq=False)
class RunsClaim:
    """Claim of several runs on the pose, the position or the rotation, taken together."""

    dof: int
    """Numbers of an error."""
    mean: float
    """NEES over all frames of all runs (ANEES); `dof` is ideal."""
    band: tuple[float, float]
    """Two-sided 95 % band of it. The frames of a run are not independent, so it is that of one frame of all runs."""
    inside: float
    """Share of the frames at which the mean over the runs is in its own band."""
    each: tuple[float, ...]
    """Mean NEES of each run."""
    by_frame: FloatArray = field(repr=False)
    """(T,): mean over the runs that are scored at that time."""
    bands: tuple[FloatArray, FloatArray] = field(repr=False)
    """(T,), (T,): its band."""

    @property
    def verdict(self) -> str:
        """Verdict of the runs on the claim, in words."""
        return verdict_of(self.mean, self.dof, self.band, f"{len(self.each)} runs")

    @property
    def alone(self) -> int:
        """Runs that one by one would be inside the band of one run."""
        low, high = mean_band(self.dof, 1)
        return sum(low <= value <= high for value in self.each)


@dataclass(frozen=True, eq=False)
class RunsScore:
    """Runs of one estimator, taken together."""

    runs: tuple[str, ...]
    """Names of those that count."""
    left_out: Mapping[str, str]
    """Names of the others, and why: diverged, no claim, or not comparable."""
    claims: Mapping[str, RunsClaim]
    """"pose", "position", "rotation", or "position" alone."""
    times: FloatArray = field(repr=False)
    """(T,), s."""

    @property
    def judged(self) -> str:
        """The claim that the verdict is on: "pose", or "position" where that is all there is."""
        return next(iter(self.claims))

    @property
    def words(self) -> str:
        """The verdict, and how it differs from what each run shows alone, in two sentences."""
        pose = self.claims[self.judged]
        low, high = (end / pose.dof for end in pose.band)
        text = (
            f"{len(self.runs)} runs together: {self.judged} ANEES / {pose.dof} is {pose.mean / pose.dof:.3g}, "
            f"band {low:.2f} to {high:.2f}: {pose.verdict}. One by one they have {min(pose.each) / pose.dof:.3g} to "
            f"{max(pose.each) / pose.dof:.3g}, and {pose.alone} of {len(self.runs)} would pass for consistent."
        )
        if not self.left_out:
            return text
        return text + " Left out: " + "; ".join(f"{name} ({why})" for name, why in self.left_out.items()) + "."

    def as_dict(self) -> dict[str, Any]:
        """All figures as plain data for JSON, without the series."""
        series = {"by_frame", "bands"}
        claims = {
            name: {key: value for key, value in asdict(claim).items() if key not in series}
            | {"verdict": claim.verdict, "alone": claim.alone}
            for name, claim in self.claims.items()
        }
        return {"runs": list(self.runs), "left_out": dict(self.left_out), "claims": claims, "words": self.words}


def score_runs(scores: Sequence[TrajectoryScore]) -> RunsScore:
    """Judge runs of one estimator together.

    Parameters
    ----------
    scores : sequence of TrajectoryScore
        One a run, of independent runs, against references at the same times.

    Returns
    -------
    RunsScore
        Their ANEES, over time and as a whole.

    Raises
    ------
    ValueError
        Fewer than two runs can be judged.
    """
    left_out = {score.estimate: why for score in scores if (why := _unfit(score))}
    judged = [score for score in scores if not _unfit(score)]
    if len({(score.claim and score.claim.dof) for score in judged}) > 1:
        raise ValueError(
            "runs must be of one estimator: some claim the whole pose, some its position or motion in a plane alone"
        )
    if len(judged) < 2:
        why = "; ".join(f"{name}: {reason}" for name, reason in left_out.items())
        raise ValueError(f"runs are judged together from two on, {len(judged)} of {len(scores)} can be ({why})")
    times = np.unique(np.concatenate([score.times for score in judged]))
    claims = {}
    for name, one in judged[0].claims.items():
        dof = one.dof
        values = np.full((len(judged), len(times)), np.nan)
        for row, score in zip(values, judged, strict=True):
            row[np.searchsorted(times, score.times)] = score.nees[name]
        finite = np.isfinite(values)
        some = finite.any(axis=0)
        by_frame = np.full(len(times), np.nan)
        by_frame[some] = np.nanmean(values[:, some], axis=0)
        low, high = mean_bands(dof, np.maximum(finite.sum(axis=0), 1))
        claims[name] = RunsClaim(
            dof=dof,
            mean=float(np.nanmean(values)),
            band=mean_band(dof, len(judged)),
            inside=float(np.mean((by_frame[some] >= low[some]) & (by_frame[some] <= high[some]))),
            each=tuple(float(np.nanmean(row)) for row in values),
            by_frame=by_frame,
            bands=(low, high),
        )
    return RunsScore(tuple(score.estimate for score in judged), left_out, claims, times)


def _unfit(score: TrajectoryScore) -> str:
    """Reason why a run has no part in the mean; empty where it has."""
    if score.claim is None:
        return "it claims no covariance"
    if score.unusable:
        return f"{score.unusable} covariances are not positive definite"
    return score.claim.obstacle
