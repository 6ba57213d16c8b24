"""Remarks on the figures of a run: its reference, innovations far from the claim, distance from the limit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

import numpy as np

from filters.catalogue.registry import USUAL
from stereo_slam_env.benchmark.statistics.differences import CONFIDENCE, MIN_PAIRS
from stereo_slam_env.benchmark.statistics.sentences import sentence
from stereo_slam_env.evaluation.bands import DOF, mean_band, rms_ratio_interval, share_inside
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.recording.recording import Reference

FAR = 2.0
"""An NIS by its degrees of freedom beyond this factor of 1, and outside its band, is remarked on.

The band alone is no measure: with the thousands of degrees of freedom of a drive it ends a few percent from 1, and the
noise of a real camera is not known so well. A factor of 2 is a sigma that is wrong by 40 %.
"""


def reference_remarks(runs: Sequence[FilterRun]) -> dict[Reference, str]:
    """Sentence on each reference of the runs; where there are several, with the recordings of each."""
    recordings: dict[Reference, dict[str, None]] = {}
    for run in runs:
        recordings.setdefault(run.reference, {})[run.recording_name] = None
    remarks = {}
    for reference, names in recordings.items():
        remarks[reference] = sentence("reference", reference, list(names) if len(recordings) > 1 else [])
    return remarks


def innovation_factor(summary: FilterSummary) -> float | None:
    """Ratio of the innovations of a filter to its claim, in sigma; None where its NIS is near 1."""
    figure = summary.consistency.get("nis")
    if figure is None or not figure.mean > 0.0:
        return None
    low, high = figure.band
    far = figure.mean < min(low, 1.0 / FAR) or figure.mean > max(high, FAR)
    return float(np.sqrt(figure.mean)) if far else None


def innovation_remarks(summaries: Sequence[FilterSummary]) -> list[str]:
    """A sentence on filters whose innovations are far smaller than claimed, and one on those with far larger ones."""
    factors = {s.filter_name: factor for s in summaries if (factor := innovation_factor(s)) is not None}
    groups = ({name: f for name, f in factors.items() if (f < 1.0) is smaller} for smaller in (True, False))
    return [
        sentence("far_innovations", list(of), max(of.values(), key=lambda factor: abs(np.log(factor))), FAR)
        for of in groups
        if of
    ]


def motion_remarks(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary]) -> list[str]:
    """A sentence where a motion model assumes harder motion than the drives have, and all its filters show a low NIS.

    What a filter assumes beyond that is in the covariance of its innovations, but not in them. The accelerations are
    those of the true velocities.
    """
    motions: dict[tuple[float, float], list[FilterSummary]] = {}
    for summary in summaries:
        assumed = summary.options.get("motion")
        if "nis" in summary.consistency and isinstance(assumed, Mapping) and len(assumed) == 2:
            linear, angular = (float(assumed[name]) for name in USUAL["motion"])
            motions.setdefault((linear, angular), []).append(summary)
    remarks = []
    for (linear, angular), group in motions.items():
        true = _accelerations(
            [run for run in runs if run.filter_name == group[0].filter_name and run.reference.is_independent]
        )
        low = all(s.consistency["nis"].mean < s.consistency["nis"].band[0] for s in group)
        if low and true is not None and true[0] < linear and true[1] < angular:
            remarks.append(sentence("gentle_motion", len(group), (linear, angular), true))
    return remarks


def _accelerations(runs: Sequence[FilterRun]) -> tuple[float, float] | None:
    """Root mean squares per axis of the true accelerations, m/s² and rad/s²; None where no velocity is known."""
    accelerations = []
    for name in ("true_linear_velocities", "true_angular_velocities"):
        steps = [np.diff(getattr(run, name), axis=0) / np.diff(run.timestamps)[:, None] for run in runs]
        values = np.concatenate([np.zeros((0, 3)), *steps])
        accelerations.append(values[np.isfinite(values).all(axis=1)])
    if not all(len(values) for values in accelerations):
        return None
    linear, angular = (float(np.sqrt(np.mean(np.square(values)))) for values in accelerations)
    return linear, angular


def body_remarks(runs: Sequence[FilterRun]) -> list[str]:
    """A sentence for each run with scored bodies: how many are consistent, and how much the worst one adds."""
    remarks = []
    for run in runs:
        scored = np.zeros(0, bool) if run.bodies is None else np.isfinite(run.bodies.pose_nees)
        if run.bodies is not None and scored.any():
            values, (_, body) = run.bodies.pose_nees[scored], np.unique(run.bodies.numbers[scored], return_inverse=True)
            sums = np.bincount(body, values)
            inside = 100.0 * share_inside(values, mean_band(DOF["pose"], 1))
            worst, swapped = 100.0 * sums.max() / sums.sum(), 100.0 * run.bodies.swapped.mean()
            remarks.append(sentence("bodies", run.filter_name, len(sums), inside, worst, swapped))
    return remarks


# ---- distance from the limit -----------------------------------------------------------------------------------------


class Reach(Enum):
    """Position of bound over error with respect to 100 %."""

    SHORT = "short of the limit"
    OPEN = "perhaps at the limit"
    AT = "at the limit"
    BEYOND = "beyond the limit"
    UNSURE = "not distinguishable from the limit"


@dataclass(frozen=True)
class LimitReached:
    """Bound over error of a filter."""

    percent: float  # ratio of both root mean squares over runs
    interval: tuple[float, float] | None  # 95 % interval of it over runs, in percent; None with fewer than `MIN_PAIRS`
    runs: int  # how many have a bound and an error

    @property
    def reach(self) -> Reach:
        """Position with respect to 100 %: the bound holds on average, so an interval with 100 % in it is open."""
        above = round(self.percent) >= 100
        if self.interval is None:
            return Reach.UNSURE if above else Reach.SHORT
        low, high = self.interval
        if low > 100.0:
            return Reach.BEYOND
        if high < 100.0:
            return Reach.SHORT
        return Reach.AT if above else Reach.OPEN

    @property
    def value(self) -> str:
        """The ratio; from 100 % on, its position in words."""
        reach = self.reach
        if reach not in (Reach.SHORT, Reach.OPEN):
            return str(reach.value)
        return f"{self.percent:.0f} %" if self.percent >= 1.0 else f"{self.percent:.1g} %"

    @property
    def sureness(self) -> str:
        """The interval, or without one the number of runs."""
        if self.interval is None:
            return f"{self.runs} run{'' if self.runs == 1 else 's'}"
        low, high = self.interval
        return f"{low:.{_digits(low)}f} to {high:.{_digits(high)}f} %"

    @property
    def words(self) -> str:
        """Both: "73 % (66 to 81 %)", "at the limit (82 to 140 %)"."""
        return f"{self.value} ({self.sureness})"


def limit_reached(summary: FilterSummary) -> LimitReached | None:
    """Bound over error of the filter; None where there is no bound or no error."""
    if summary.efficiency_percent is None:
        return None
    if len(summary.position_rmse_by_run) != len(summary.efficiency_by_run):
        return LimitReached(summary.efficiency_percent, None, summary.runs)
    interval = _interval_of(summary.position_rmse_by_run, summary.efficiency_by_run)
    return LimitReached(summary.efficiency_percent, *interval)


@lru_cache(maxsize=64)
def _interval_of(
    errors_by_run: tuple[float, ...], efficiency_by_run: tuple[float, ...]
) -> tuple[tuple[float, float] | None, int]:
    """Interval of the efficiency, and of how many runs; several places ask, and of many runs it takes seconds."""
    errors, efficiencies = np.array(errors_by_run), np.array(efficiency_by_run)
    finite = np.isfinite(errors) & np.isfinite(efficiencies)
    interval = None
    if finite.sum() >= MIN_PAIRS:
        low, high = rms_ratio_interval(0.01 * efficiencies[finite] * errors[finite], errors[finite], CONFIDENCE)
        interval = 100.0 * low, 100.0 * high
    return interval, int(finite.sum())


def _digits(percent: float) -> int:
    """Digits of an end of the interval, so that one just below 100 % is not printed as 100."""
    return 1 if 99.0 < percent < 101.0 else 0
