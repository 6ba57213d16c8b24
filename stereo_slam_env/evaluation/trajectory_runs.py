"""Several runs of one estimator: a mean NEES (ANEES) whose band narrows with their number, errors, and runs lost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.bands import mean_band, mean_bands
from stereo_slam_env.evaluation.claims import ClaimScore, Fit, claims_differ, error_ratio, fit_of, verdict_of
from stereo_slam_env.evaluation.figures import readable
from stereo_slam_env.evaluation.trajectory_score import TrajectoryScore

_WHOLE = 0.9
"""A run that lasted a smaller share of the longest ended early."""


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
    def short_verdict(self) -> str:
        """The verdict in a few words: whether it fits, and by how much errors exceed or miss the claim."""
        fit = fit_of(self.mean, self.band)
        return f"{fit}, {readable(error_ratio(self.mean, self.dof))} σ" if fit in (Fit.TIGHT, Fit.LOOSE) else f"{fit}"

    @property
    def alone(self) -> int:
        """Runs that one by one would be inside the band of one run."""
        low, high = mean_band(self.dof, 1)
        return sum(low <= value <= high for value in self.each)


@dataclass(frozen=True)
class RunsError:
    """An error of several runs, root mean square over each."""

    mean: float
    """Over the runs that did not diverge, in the unit of the error."""
    worst: float
    """The largest of these."""
    runs: int
    """How many they are."""


@dataclass(frozen=True, eq=False)
class RunsScore:
    """Runs of one estimator, taken together."""

    runs: tuple[str, ...]
    """Names of those whose claim counts."""
    left_out: Mapping[str, str]
    """Names of the others that left a trajectory, and why: diverged, no claim, or not comparable."""
    failed: Mapping[str, str]
    """Names of those without a trajectory that can be scored, and why."""
    diverged: Mapping[str, float]
    """Names of those that diverged, and when: s after the first pose."""
    ended_early: Mapping[str, float]
    """Names of those that ended before the others, and the share of the longest that they lasted; they count."""
    errors: Mapping[str, RunsError]
    """"position", m; "rotation", degrees; "velocity", m/s; "gyro-bias", rad/s; "accelerometer-bias", m/s^2."""
    alignment: str
    """How their worlds were brought to those of the references."""
    other_gauges: Mapping[str, float]
    """ANEES / dof of the verdict's claim under each alignment, where it hangs on that, and no header says it or many
    poses determined it; by all poses but for "start"."""
    claims: Mapping[str, RunsClaim]
    """"pose", "position", "rotation", or "position" alone, and what else is claimed; empty where fewer than two do."""
    times: FloatArray = field(repr=False)
    """(T,), s."""

    @property
    def total(self) -> int:
        """All runs, with those that failed."""
        return len(self.runs) + len(self.left_out) + len(self.failed)

    @property
    def judged(self) -> str:
        """The claim that the verdict is on: "pose", "position" where that is all there is, or the first state."""
        return next(iter(self.claims), "")

    @property
    def losses(self) -> str:
        """Runs that diverged or failed, in a sentence; empty where none did."""
        parts = []
        if self.diverged:
            when = sorted(self.diverged.values())
            parts.append(f"{len(when)} diverged, {readable(float(np.median(when)))} s after the start (median)")
        if self.failed:
            parts.append(f"{len(self.failed)} left nothing to score")
        lost = f"Of {self.total} runs, {' and '.join(parts)}: figures are of the others, and flatter the system."
        if not self.ended_early:
            return lost if parts else ""
        early = ", ".join(f"{name} ({100.0 * share:.0f} %)" for name, share in self.ended_early.items())
        return f"{lost if parts else ''} These ended early, and count as far as they went: {early}.".lstrip()

    @property
    def words(self) -> str:
        """Losses, the verdict, and how it differs from what each run shows alone, in a few sentences."""
        sentences = [self.losses] if self.losses else []
        if self.claims:
            pose = self.claims[self.judged]
            low, high = (end / pose.dof for end in pose.band)
            sentences.append(
                f"{len(self.runs)} runs together: {self.judged} ANEES / {pose.dof} is {pose.mean / pose.dof:.3g}, "
                f"band {low:.2f} to {high:.2f}: {pose.verdict}. {100.0 * pose.inside:.0f} % of the frames are in their "
                f"own bands, where 95 % are expected. One by one they have {min(pose.each) / pose.dof:.3g} "
                f"to {max(pose.each) / pose.dof:.3g}, and {pose.alone} of {len(self.runs)} would pass for consistent."
            )
            if contradiction := self._otherwise():
                sentences.append(contradiction)
            if self.other_gauges:
                ratios = ", ".join(f"{value:.3g} ({kind})" for kind, value in self.other_gauges.items())
                sentences.append(
                    f"It depends on the alignment: it is {ratios}. Where many poses determine it, how their errors are "
                    "correlated is assumed, as no file says it; less hangs on that by one pose (--align-seconds 0)."
                )
        else:
            sentences.append(f"{len(self.runs)} of {self.total} runs have a claim that can be judged: two are needed.")
        lost = {**self.left_out, **self.failed}
        if lost:
            by_reason: dict[str, list[str]] = {}
            for name, why in lost.items():
                by_reason.setdefault(why, []).append(name)
            sentences.append("Left out: " + "; ".join(f"{', '.join(n)} ({why})" for why, n in by_reason.items()) + ".")
        return " ".join(sentences)

    def _otherwise(self) -> str:
        """Claims with another verdict than that of the words, in a sentence; empty where there are none."""
        fits = {name: fit_of(claim.mean, claim.band) for name, claim in self.claims.items()}
        unlike = [
            f"{name} is {fit} ({claim.mean / claim.dof:.3g})"
            for (name, claim), fit in zip(self.claims.items(), fits.values(), strict=True)
            if fit is not fits[self.judged]
        ]
        return f"But by itself {', '.join(unlike)}." if unlike else ""

    def as_dict(self) -> dict[str, Any]:
        """All figures as plain data for JSON, without the series."""
        series = {"by_frame", "bands"}
        claims = {
            name: {key: value for key, value in asdict(claim).items() if key not in series}
            | {"verdict": claim.verdict, "alone": claim.alone}
            for name, claim in self.claims.items()
        }
        lost = {"left_out": dict(self.left_out), "failed": dict(self.failed), "diverged": dict(self.diverged)}
        lost["ended_early"] = dict(self.ended_early)
        errors = {name: asdict(error) for name, error in self.errors.items()}
        gauges = {"alignment": self.alignment, "other_gauges": dict(self.other_gauges)}
        return {"runs": list(self.runs)} | lost | gauges | {"errors": errors, "claims": claims, "words": self.words}


def score_runs(scores: Sequence[TrajectoryScore], failed: Mapping[str, str] | None = None) -> RunsScore:
    """Judge runs of one estimator together.

    Parameters
    ----------
    scores : sequence of TrajectoryScore
        One a run, of independent runs, against references at the same times.
    failed : mapping, optional
        Names of runs that left no trajectory, and why. Given, even empty, runs of which fewer than two can be judged
        are scored by their errors alone.

    Returns
    -------
    RunsScore
        Their errors and losses, and their ANEES, over time and as a whole.

    Raises
    ------
    ValueError
        Fewer than two runs can be judged.
    """
    names = labels_of(scores)
    main = [score.claim or next(iter(score.claims.values()), None) for score in scores]
    reasons = _doubts(scores, main)
    unfit = {name: why for name, why in zip(names, reasons, strict=True) if why}
    fit = {name: score for name, score in zip(names, scores, strict=True) if name not in unfit}
    judged = list(fit.values())
    if len({(score.claim and score.claim.dof) for score in judged}) > 1:  # None: of states alone
        raise ValueError(
            "runs must be of one estimator: some claim the whole pose, some its position or motion in a plane alone"
        )
    if len(judged) < 2 and failed is None:
        why = "; ".join(f"{name}: {reason}" for name, reason in unfit.items())
        raise ValueError(f"runs are judged together from two on, {len(judged)} of {len(scores)} can be ({why})")
    times = np.unique(np.concatenate([score.times for score in judged])) if judged else np.empty(0)
    claims = {}
    for name in dict.fromkeys(name for score in judged for name in score.claims):
        doubts = _doubts(judged, [score.claims.get(name) for score in judged])
        claiming = [score for score, why in zip(judged, doubts, strict=True) if not why]
        if len(claiming) > 1:
            claims[name] = _claim_of(name, claiming, times)
    diverged = {
        name: score.diverged_at_s for name, score in zip(names, scores, strict=True) if score.diverged_at_s is not None
    }
    return RunsScore(
        runs=tuple(fit),
        left_out=unfit,
        failed=dict(failed or {}),
        diverged=diverged,
        ended_early=_ended_early(names, scores),
        errors=_errors_of(scores),
        alignment=" or ".join(dict.fromkeys(score.alignment for score in scores)),
        other_gauges=_other_gauges(judged),
        claims=claims,
        times=times,
    )


def _ended_early(names: Sequence[str], scores: Sequence[TrajectoryScore]) -> dict[str, float]:
    """Runs that lasted a smaller part of their drive than the longest one, and how much smaller."""
    shares = {name: score.covered for name, score in zip(names, scores, strict=True) if score.covered is not None}
    longest = max(shares.values(), default=1.0)
    return {name: share / longest for name, share in shares.items() if share < _WHOLE * longest}


def _other_gauges(scores: Sequence[TrajectoryScore]) -> dict[str, float]:
    """ANEES / dof under each alignment, where the verdict of a run hangs on a doubtful one; else empty."""
    doubtful = (score for score in scores if score.gauge_is_open or score.aligned_by > 1)
    if not any(claims_differ(score.gauges) for score in doubtful):
        return {}
    each: dict[str, list[float]] = {}
    for one in (one for score in scores for one in score.gauges if np.isfinite(one.nees)):
        each.setdefault(one.alignment, []).append(one.nees / one.dof)
    return {kind: float(np.mean(ratios)) for kind, ratios in each.items()}


def _claim_of(name: str, scores: Sequence[TrajectoryScore], times: FloatArray) -> RunsClaim:
    """A claim of several runs together; `times` (T,) are those of all."""
    dof = scores[0].claims[name].dof
    values = np.full((len(scores), len(times)), np.nan)
    for row, score in zip(values, scores, strict=True):
        row[np.searchsorted(times, score.times)] = score.nees[name]
    finite = np.isfinite(values)
    some = finite.any(axis=0)
    by_frame = np.full(len(times), np.nan)
    by_frame[some] = np.nanmean(values[:, some], axis=0)
    low, high = mean_bands(dof, np.maximum(finite.sum(axis=0), 1))
    return RunsClaim(
        dof=dof,
        mean=float(np.nanmean(values)),
        band=mean_band(dof, len(scores)),
        inside=float(np.mean((by_frame[some] >= low[some]) & (by_frame[some] <= high[some]))),
        each=tuple(float(np.nanmean(row)) for row in values),
        by_frame=by_frame,
        bands=(low, high),
    )


def _errors_of(scores: Sequence[TrajectoryScore]) -> dict[str, RunsError]:
    """Errors over the runs that did not diverge."""
    each: dict[str, list[float]] = {}
    for score in scores:
        if score.diverged_at_s is not None:
            continue
        of_pose = {"position": score.position_rmse_m, "rotation": score.rotation_rmse_deg}
        for name, error in (of_pose | dict(score.state_rmse)).items():
            if error is not None:
                each.setdefault(name, []).append(error)
    return {name: RunsError(float(np.mean(some)), max(some), len(some)) for name, some in each.items()}


def labels_of(scores: Sequence[TrajectoryScore]) -> list[str]:
    """Names of the estimates, numbered where two have the same."""
    names = [score.estimate for score in scores]
    return [f"{name} ({i + 1})" if names.count(name) > 1 else name for i, name in enumerate(names)]


def _doubts(scores: Sequence[TrajectoryScore], claims: Sequence[ClaimScore | None]) -> list[str]:
    """Reasons why runs have no part in the mean of a claim, empty where they have.

    A clock, a frame or a scale that would explain the errors of a few runs is none of the input, which all have in
    common, but what these runs drew: to leave out the worst would flatter the system.
    """
    stayed = [claim for score, claim in zip(scores, claims, strict=True) if claim and score.diverged_at_s is None]
    is_common = 2 * sum(bool(claim.obstacle) for claim in stayed) >= len(stayed)
    reasons = []
    for score, claim in zip(scores, claims, strict=True):
        if claim is None:
            reasons.append("it claims no covariance")
        elif claim.unusable:
            reasons.append(f"{claim.unusable} covariances are not positive definite")
        else:
            reasons.append(claim.obstacle if is_common or score.diverged_at_s is not None else "")
    return reasons
