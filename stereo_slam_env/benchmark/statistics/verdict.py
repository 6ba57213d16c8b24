"""What may be said about the filters: who is better, by how much, and whether the runs show it.

Filters are compared on the same recordings, see `benchmark.statistics`. The one with the smallest position error of
those that never diverged is held against each of the others; `compare_all` holds each against each, by every question.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import combinations

from stereo_slam_env.benchmark.metrics.results import FilterRun, FilterSummary
from stereo_slam_env.benchmark.statistics.differences import (
    Difference,
    Finding,
    larger,
    signed,
)
from stereo_slam_env.benchmark.statistics.measures import (
    POSITION,
    QUESTIONS,
    Measure,
    RunFigures,
    common_keys,
    figures_of,
)
from stereo_slam_env.benchmark.statistics.shares import ShareDifference, paired_share


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
        95 % confidence interval of it; None with too few runs for one.
    finding : Finding
        About the other one, by its error: worse, or no difference shown (better, where the best one is that only by
        its root mean square).
    shown : bool
        Whether the runs show that the best one is better: in its error, or because the other one diverged.
    difference : Difference
        The error of the other one by that of the best one.
    divergences : ShareDifference
        Which of them diverges in more recordings; of the other one.
    words : str
        The conclusion, a clause.
    """

    best: str
    other: str
    runs: int
    excess_percent: float
    interval_percent: tuple[float, float] | None
    finding: Finding
    shown: bool
    difference: Difference
    divergences: ShareDifference
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
        A few sentences.
    answers : mapping of str to str
        The sentences of the headline by the question they answer: "best" (who, by how much, is it sure),
        "consistent", "limit", "cost"; what is not known is left out.
    """

    best: str | None
    comparisons: Mapping[str, Comparison]
    headline: str
    answers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PairVerdict:
    """One filter against another one, by one measure.

    Attributes
    ----------
    measure : Measure
        What is compared.
    filter_name, against : str
        Who against whom.
    difference : Difference
        Of the measure; for consistency, of the distance from the ideal.
    words : str
        "12 % smaller (−15 to −9 % at 95 % confidence, 10 paired runs)", or that no difference is shown.
    """

    measure: Measure
    filter_name: str
    against: str
    difference: Difference
    words: str

    @property
    def finding(self) -> Finding:
        """Whether the filter is shown to be better or worse than the other one."""
        return self.difference.finding


@dataclass(frozen=True)
class PairwiseTable:
    """Each filter against each other one, or all against a baseline.

    Attributes
    ----------
    filters : tuple of str
        In the order of the summaries.
    measures : tuple of Measure
        Those that some pair could be compared by.
    cells : mapping of (key of the measure, filter, against) to PairVerdict
        Both directions of every pair.
    """

    filters: tuple[str, ...]
    measures: tuple[Measure, ...]
    cells: Mapping[tuple[str, str, str], PairVerdict]

    def cell(self, measure: Measure, filter_name: str, against: str) -> PairVerdict | None:
        """The verdict on `filter_name`; None where the two were not compared."""
        return self.cells.get((measure.key, filter_name, against))


def judge(
    runs: Sequence[FilterRun],
    summaries: Sequence[FilterSummary],
    *,
    divergence_percent: float = 10.0,
    figures: Mapping[str, RunFigures] | None = None,
) -> Verdict:
    """Compare the filters on accuracy, and put consistency, distance from the limit and cost of the best one beside it.

    Parameters
    ----------
    runs : sequence of FilterRun
        All runs.
    summaries : sequence of FilterSummary
        Of the same runs.
    divergence_percent : float
        As in `summarise`.
    figures : mapping of str to RunFigures, optional
        `figures_of(runs)`, where it is at hand.
    """
    scored = [s for s in summaries if s.position_rmse_m is not None]
    steady = [s for s in scored if s.diverged == 0]
    if not scored:
        return Verdict(None, {}, "There is no ground truth here: only innovations and cost can be compared.")
    if not steady:
        return Verdict(None, {}, "Every filter diverged in at least one run.")
    best = min(steady, key=lambda s: float(s.position_rmse_m or 0.0))
    rivals = [s for s in summaries if s is not best]
    figures = figures_of(runs, divergence_percent=divergence_percent) if figures is None else figures
    comparisons = {
        s.filter_name: against_best(best, s, figures[best.filter_name], figures[s.filter_name], len(rivals))
        for s in rivals
    }
    answers = {
        "best": _accuracy(best, rivals, comparisons),
        "consistent": _CONSISTENCY_WORDS[consistency(best)],
        "limit": _limit(best),
        "cost": _cost(best, rivals),
    }
    answers = {question: words for question, words in answers.items() if words}
    return Verdict(best.filter_name, comparisons, " ".join(answers.values()), answers)


def against_best(
    best: FilterSummary, other: FilterSummary, best_figures: RunFigures, other_figures: RunFigures, comparisons: int = 1
) -> Comparison:
    """Compare another filter with the best one, by position error, on the recordings that both completed.

    Parameters
    ----------
    best, other : FilterSummary
        Of the two.
    best_figures, other_figures : RunFigures
        Run by run.
    comparisons : int
        Number of comparisons made at once.
    """
    keys = common_keys(best_figures, other_figures)
    errors = (figures.values(POSITION, keys) for figures in (other_figures, best_figures))
    difference = POSITION.difference(*errors, comparisons=comparisons)
    divergences = paired_share(other_figures.diverged(keys), best_figures.diverged(keys), comparisons=comparisons)
    return Comparison(
        best=best.filter_name,
        other=other.filter_name,
        runs=difference.count,
        excess_percent=difference.percent,
        interval_percent=difference.interval_percent,
        finding=difference.finding,
        shown=bool(other.diverged) or difference.finding is Finding.WORSE,
        difference=difference,
        divergences=divergences,
        words=_comparison_words(other, difference, divergences),
    )


def compare_all(
    runs: Sequence[FilterRun],
    summaries: Sequence[FilterSummary],
    *,
    baseline: str | None = None,
    measures: Sequence[Measure] = QUESTIONS,
    figures: Mapping[str, RunFigures] | None = None,
) -> PairwiseTable:
    """Compare each filter with each other one, question by question.

    Intervals and tests are corrected for the number of pairs; each question stands for itself.

    Parameters
    ----------
    runs, summaries, figures : sequence, sequence, mapping
        As `judge`.
    baseline : str, optional
        Compare all with this one only.
    measures : sequence of Measure
        The questions: by default how accurate in position and rotation, how honest, how fast.

    Raises
    ------
    ValueError
        There is no such baseline.
    """
    names = tuple(s.filter_name for s in summaries)
    if baseline is not None and baseline not in names:
        raise ValueError(f"baseline must be one of {', '.join(names)}, got {baseline!r}")
    pairs = [(a, b) for a, b in combinations(names, 2) if baseline in (None, a, b)]
    figures = figures_of(runs) if figures is None else figures
    cells: dict[tuple[str, str, str], PairVerdict] = {}
    for measure in measures:
        for a, b in pairs:
            keys = common_keys(figures[a], figures[b])
            values = (figures[name].values(measure, keys) for name in (a, b))
            difference = measure.difference(*values, comparisons=len(pairs))
            if difference.count:
                cells[measure.key, a, b] = _pair_verdict(measure, a, b, difference)
                cells[measure.key, b, a] = _pair_verdict(measure, b, a, difference.reversed)
    known = {key for key, _, _ in cells}
    return PairwiseTable(names, tuple(m for m in measures if m.key in known), cells)


def consistency(summary: FilterSummary) -> Consistency:
    """Judge the mean pose NEES against its band."""
    if summary.pose_anees is None or summary.pose_anees_band is None:
        return Consistency.UNKNOWN
    low, high = summary.pose_anees_band
    if summary.pose_anees > high:
        return Consistency.OVERCONFIDENT
    return Consistency.CAUTIOUS if summary.pose_anees < low else Consistency.CONSISTENT


def change_words(measure: Measure, difference: Difference) -> str:
    """What a difference of a measure comes to, with its evidence in brackets."""
    if difference.identical:
        return f"the same in all {difference.count} runs"
    if not difference.shown:
        return f"{Finding.NOT_SHOWN.value} ({difference.evidence})"
    if measure.ideal is not None:
        nearer = "nearer to" if difference.estimate < 0.0 else "farther from"
        return f"{nearer} its ideal ({difference.evidence})"
    if not measure.is_ratio:
        more = "less" if difference.estimate < 0.0 else "more"
        return f"{abs(difference.estimate):.3g} {more} ({difference.evidence})"
    if measure.larger_is_better:
        return f"{larger(difference.reversed.percent)} ({difference.reversed.evidence})"
    return f"{larger(difference.percent)} ({difference.evidence})"


def finding_words(measure: Measure, difference: Difference) -> str:
    """The finding and what it comes to: "worse: 12 % larger (+9 to +15 % ...)", "no difference shown (...)"."""
    words = change_words(measure, difference)
    return f"{difference.finding.value}: {words}" if difference.shown else words


def _pair_verdict(measure: Measure, a: str, b: str, difference: Difference) -> PairVerdict:
    return PairVerdict(measure, a, b, difference, change_words(measure, difference))


def _comparison_words(other: FilterSummary, difference: Difference, divergences: ShareDifference) -> str:
    name = other.filter_name
    if difference.count == 0:
        return f"{name} completed no run" if other.diverged else f"no run to compare with {name}"
    if other.diverged:
        chance = "" if divergences.finding is Finding.WORSE else ", which may be chance"
        return f"{name} diverged in {other.diverged} of {other.runs} runs{chance}"
    if difference.finding is Finding.WORSE:
        return f"the error of {name} is {larger(difference.percent)} ({difference.evidence})"
    if difference.finding is Finding.BETTER:
        return f"run by run the error of {name} is {larger(difference.percent)} ({difference.evidence})"
    if difference.count == 1:
        return f"one run shows no general difference ({name} is at {signed(difference.percent)} % in it)"
    if difference.identical:
        return f"{name} has the same errors in all {difference.count} runs"
    if difference.interval is None:
        return (
            f"{difference.count} runs are too few to show a difference to {name}, "
            f"{difference.needed} are needed ({name} is at {signed(difference.percent)} % on average)"
        )
    return f"no difference to {name} is shown ({difference.evidence})"


def _accuracy(best: FilterSummary, rivals: Sequence[FilterSummary], comparisons: Mapping[str, Comparison]) -> str:
    error = f"{best.position_rmse_m:.3g} m"
    undecided = _undecided([c for c in comparisons.values() if not c.shown])
    settled = _nearest([c for c in comparisons.values() if c.shown])
    if not rivals:
        return f"{best.filter_name} has a position error of {error}."
    if undecided:
        first = f"{best.filter_name} has the smallest position error, {error}, but {undecided}."
    else:
        first = f"{best.filter_name} is the most accurate, with a position error of {error}."
    return f"{first} Behind it: {settled}." if settled else first


def _undecided(open_ones: Sequence[Comparison]) -> str:
    """With many rivals their names only: the figures are in the tables."""
    if len(open_ones) <= _MOST_WORDED:
        return "; ".join(c.words for c in open_ones)
    names = ", ".join(c.other for c in open_ones[:_MOST_WORDED])
    return f"no difference to {names} and {len(open_ones) - _MOST_WORDED} more is shown"


def _nearest(settled: Sequence[Comparison]) -> str:
    """The rivals that come nearest; those that diverged are the farthest."""
    in_order = sorted(settled, key=lambda c: (c.divergences.only_a, c.excess_percent))
    more = len(settled) - _MOST_WORDED
    words = "; ".join(c.words for c in in_order[:_MOST_WORDED])
    return f"{words}; and {more} more" if more > 0 else words


_MOST_WORDED = 3

_CONSISTENCY_WORDS = {
    Consistency.CONSISTENT: "It knows how wrong it is: its NEES lies inside its band.",
    Consistency.OVERCONFIDENT: "It is overconfident: its NEES lies above its band.",
    Consistency.CAUTIOUS: "It claims more uncertainty than it has: its NEES lies below its band.",
    Consistency.UNKNOWN: "Its consistency is not known.",
}


def _limit(best: FilterSummary) -> str:
    if best.efficiency_percent is None:
        return ""
    bound = f", {best.bound_position_m:.3g} m" if best.bound_position_m is not None else ""
    if best.efficiency_percent >= 99.5:
        return f"Its error is at the limit of what theory allows (Cramér–Rao bound{bound})."
    return f"It reaches {best.efficiency_percent:.0f} % of what theory allows (Cramér–Rao bound{bound})."


def _cost(best: FilterSummary, rivals: Sequence[FilterSummary]) -> str:
    if best.ms_per_frame is None:
        return ""
    quicker = [s for s in rivals if s.ms_per_frame is not None and s.ms_per_frame < best.ms_per_frame]
    quickest = min(quicker, key=lambda s: float(s.ms_per_frame or 0.0), default=None)
    beside = ""
    if quickest is not None and quickest.ms_per_frame:
        beside = f", {best.ms_per_frame / quickest.ms_per_frame:.2g} times {quickest.filter_name}"
    return f"It takes {best.ms_per_frame:.3g} ms a frame{beside}."
