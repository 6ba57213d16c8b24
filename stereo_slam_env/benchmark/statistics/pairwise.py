"""Each filter against each other one, question by question: which differences the runs show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from stereo_slam_env.benchmark.statistics.differences import Difference, Finding
from stereo_slam_env.benchmark.statistics.measures import QUESTIONS, Measure
from stereo_slam_env.benchmark.statistics.words import percent_words
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import Figures, common_keys


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


def compare_all(
    summaries: Sequence[FilterSummary],
    figures: Figures,
    *,
    baseline: str | None = None,
    measures: Sequence[Measure] = QUESTIONS,
) -> PairwiseTable:
    """Compare each filter with each other one, question by question.

    Intervals and tests are corrected for the number of pairs; each question stands for itself.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        One for each filter.
    figures : mapping of str to RunFigures
        Of the same runs, see `figures_of`.
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
    cells: dict[tuple[str, str, str], PairVerdict] = {}
    for measure in measures:
        for a, b in pairs:
            keys = common_keys(figures[a], figures[b])
            values = (measure.by_run(figures[name], keys) for name in (a, b))
            difference = measure.difference(*values, comparisons=len(pairs))
            if difference.count:
                cells[measure.key, a, b] = _pair_verdict(measure, a, b, difference)
                cells[measure.key, b, a] = _pair_verdict(measure, b, a, difference.reversed)
    known = {key for key, _, _ in cells}
    return PairwiseTable(names, tuple(m for m in measures if m.key in known), cells)


def change_words(measure: Measure, difference: Difference) -> str:
    """What a difference of a measure comes to, with its evidence in brackets."""
    if difference.tied:
        return difference.tie_words
    if not difference.shown:
        return f"{Finding.NOT_SHOWN.value} ({difference.evidence})"
    if measure.ideal is not None:
        nearer = "nearer to" if difference.estimate < 0.0 else "farther from"
        return f"{nearer} its ideal ({difference.evidence})"
    if not measure.is_ratio:
        more = "less" if difference.estimate < 0.0 else "more"
        return f"{abs(difference.estimate):.3g} {more} ({difference.evidence})"
    found = difference.reversed if measure.larger_is_better else difference
    return f"{percent_words(found.percent)} ({found.evidence})"


def finding_words(measure: Measure, difference: Difference) -> str:
    """The finding and what it comes to: "worse: 12 % larger (+9 to +15 % ...)", "no difference shown (...)"."""
    words = change_words(measure, difference)
    return f"{difference.finding.value}: {words}" if difference.shown else words


def _pair_verdict(measure: Measure, a: str, b: str, difference: Difference) -> PairVerdict:
    return PairVerdict(measure, a, b, difference, change_words(measure, difference))
