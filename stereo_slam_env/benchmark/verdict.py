"""What may be said about the filters: who is better, by how much, and whether the runs show it.

Two filters are compared on the same recordings. Their errors differ by a factor rather than by an amount (a hard
recording is hard for both), so the comparison is of log ratios: a paired t interval, Bonferroni-corrected for the
number of comparisons with the best filter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.stats import t as student

from filters.validation import FloatArray
from stereo_slam_env.benchmark.results import FilterRun, FilterSummary

MIN_RUNS_FOR_INTERVAL = 5

RunErrors = Mapping[tuple[str, int | None], float]
"""Position RMSE, m, of each recording (name, seed)."""


class Consistency(Enum):
    """Where the mean NEES of a filter lies with respect to its band."""

    CONSISTENT = "consistent"
    OVERCONFIDENT = "overconfident"
    CAUTIOUS = "too cautious"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class Comparison:
    """The best filter against another one.

    Attributes
    ----------
    best, other : str
        Names.
    runs : int
        Recordings that both completed.
    excess_percent : float
        How much larger the other one's error is (geometric mean over runs); NaN without a common run.
    interval_percent : pair of float, optional
        95 % confidence interval of it; None with fewer than `MIN_RUNS_FOR_INTERVAL` runs.
    shown : bool
        Whether the runs show that the best one is better.
    words : str
        The conclusion, a clause.
    """

    best: str
    other: str
    runs: int
    excess_percent: float
    interval_percent: tuple[float, float] | None
    shown: bool
    words: str


@dataclass(frozen=True)
class Verdict:
    """What the report says first.

    Attributes
    ----------
    best : str, optional
        Filter with the smallest position error of those that never diverged; None without truth or survivors.
    comparisons : mapping of str to Comparison
        By name of the other filter.
    headline : str
        One to three sentences.
    """

    best: str | None
    comparisons: Mapping[str, Comparison]
    headline: str


def judge(runs: Sequence[FilterRun], summaries: Sequence[FilterSummary]) -> Verdict:
    """Compare the filters on accuracy, and put consistency and cost of the best one beside it.

    Parameters
    ----------
    runs : sequence of FilterRun
        All runs.
    summaries : sequence of FilterSummary
        Of the same runs, in the same order per filter.
    """
    scored = [s for s in summaries if s.position_rmse_m is not None]
    steady = [s for s in scored if s.diverged == 0]
    if not scored:
        return Verdict(None, {}, "There is no ground truth here: only innovations and cost can be compared.")
    if not steady:
        return Verdict(None, {}, "Every filter diverged in at least one run.")
    best = min(steady, key=lambda s: float(s.position_rmse_m or 0.0))
    rivals = [s for s in summaries if s is not best]
    errors = {s.filter_name: errors_by_recording(runs, s) for s in summaries}
    comparisons = {
        s.filter_name: compare(best.filter_name, errors[best.filter_name], s, errors[s.filter_name], len(rivals))
        for s in rivals
    }
    return Verdict(best.filter_name, comparisons, _headline(best, rivals, comparisons))


def errors_by_recording(runs: Sequence[FilterRun], summary: FilterSummary) -> RunErrors:
    """Match the per-run errors of a summary with the recordings they belong to."""
    own = [run for run in runs if run.filter_name == summary.filter_name]
    keys = [(run.recording_name, run.seed) for run in own]
    return dict(zip(keys, summary.position_rmse_by_run, strict=True))


def compare(
    best: str, best_errors: RunErrors, other: FilterSummary, other_errors: RunErrors, comparisons: int = 1
) -> Comparison:
    """Compare two filters on the recordings that both completed.

    Parameters
    ----------
    best : str
        Name of the filter with the smaller error.
    best_errors, other_errors : mapping
        Position RMSE of each recording, m.
    other : FilterSummary
        The other filter.
    comparisons : int
        Number of comparisons made at once (Bonferroni).
    """
    name = other.filter_name
    common = [key for key in best_errors if np.isfinite(best_errors[key] * other_errors.get(key, np.nan))]
    a = np.array([best_errors[key] for key in common])
    b = np.array([other_errors[key] for key in common])
    n = len(common)
    if n == 0 or not (a > 0).all() or not (b > 0).all():
        words = f"{name} completed no run" if other.diverged else f"no run to compare with {name}"
        return Comparison(best, name, 0, float("nan"), None, bool(other.diverged), words)
    log_ratios = np.log(b / a)
    excess = _percent(log_ratios.mean())
    interval = _interval(log_ratios, 0.95, comparisons) if n >= MIN_RUNS_FOR_INTERVAL else None
    if other.diverged:
        shown, words = True, f"{name} diverged in {other.diverged} of {other.runs} runs"
    elif interval is not None:
        shown = interval[0] > 0
        bounds = " to ".join(_signed(bound) for bound in interval)
        evidence = f"{bounds} % at 95 % confidence, {n} paired runs"
        words = f"the error of {name} is {_larger(excess)} ({evidence})"
        words = words if shown else f"no difference to {name} is shown ({evidence})"
    elif n == 1:
        shown, words = False, f"one run shows no general difference ({name} is at {_signed(excess)} % in it)"
    elif a.max() < b.min():
        shown, words = (
            False,
            f"{n} runs are too few for an interval (in each of them {name} is worse, {_signed(excess)} % on average)",
        )
    else:
        shown, words = False, f"no difference to {name} is shown: the errors of the {n} runs overlap"
    return Comparison(best, name, n, excess, interval, shown, words)


def consistency(summary: FilterSummary) -> Consistency:
    """Judge the mean pose NEES against its band."""
    if summary.pose_anees is None or summary.pose_anees_band is None:
        return Consistency.UNKNOWN
    low, high = summary.pose_anees_band
    if summary.pose_anees > high:
        return Consistency.OVERCONFIDENT
    return Consistency.CAUTIOUS if summary.pose_anees < low else Consistency.CONSISTENT


def _interval(log_ratios: FloatArray, confidence: float, comparisons: int) -> tuple[float, float]:
    n = len(log_ratios)
    tail = 0.5 * (1 - confidence) / max(comparisons, 1)
    half = student.ppf(1 - tail, n - 1) * log_ratios.std(ddof=1) / np.sqrt(n)
    return _percent(log_ratios.mean() - half), _percent(log_ratios.mean() + half)


def _larger(percent: float) -> str:
    return f"{percent:.0f} % larger" if percent < 100 else f"{1 + percent / 100:.3g} times as large"


def _signed(percent: float) -> str:
    return f"{percent:+,.0f}".replace("-", "−")


def _percent(log_ratio: float) -> float:
    return float(100 * np.expm1(np.clip(log_ratio, -50, 50)))


def _headline(best: FilterSummary, rivals: Sequence[FilterSummary], comparisons: Mapping[str, Comparison]) -> str:
    error = f"{best.position_rmse_m:.3g} m"
    undecided = "; ".join(c.words for c in comparisons.values() if not c.shown)
    settled = "; ".join(c.words for c in comparisons.values() if c.shown)
    if not rivals:
        sentences = [f"{best.filter_name} has a position error of {error}."]
    elif undecided:
        sentences = [f"{best.filter_name} has the smallest position error, {error}, but {undecided}."]
    else:
        sentences = [f"{best.filter_name} is the most accurate, with a position error of {error}."]
    if settled:
        sentences.append(f"Behind it: {settled}.")
    sentences.append(
        {
            Consistency.CONSISTENT: "It knows how wrong it is: its NEES lies inside its band.",
            Consistency.OVERCONFIDENT: "It is overconfident: its NEES lies above its band.",
            Consistency.CAUTIOUS: "It claims more uncertainty than it has: its NEES lies below its band.",
            Consistency.UNKNOWN: "Its consistency is not known.",
        }[consistency(best)]
    )
    if best.ms_per_frame is not None:
        sentences.append(f"It takes {best.ms_per_frame:.3g} ms a frame.")
    return " ".join(sentences)
