"""Verdict on the filters: the best one, by how much, and whether the runs show it.

Filters are compared on the same recordings, see `benchmark.statistics`. The one with the smallest position error of
those that never diverged is held against each of the others; `pairwise` holds each against each, by every question.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

from stereo_slam_env.benchmark.statistics.differences import (
    MIN_PAIRS,
    Difference,
    Finding,
    ShareDifference,
    listed,
    percent_words,
    share_difference,
)
from stereo_slam_env.benchmark.statistics.measures import POSE_NEES, POSITION, difference_between
from stereo_slam_env.benchmark.statistics.remarks import Reach, limit_reached
from stereo_slam_env.evaluation.bands import DOF
from stereo_slam_env.evaluation.figures import readable
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.evaluation.run_figures import Figures, RunFigures, common_keys
from stereo_slam_env.evaluation.trial import FEWEST_FRAMES


class Consistency(Enum):
    """Consistency of a filter: its mean NEES with respect to the band, or what is to be doubted before it."""

    CONSISTENT = "consistent"
    OVERCONFIDENT = "overconfident"
    DOUBTFUL = "calibration, frames or truth"
    CAUTIOUS = "too cautious"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class FilterComparison:
    """The best filter against another one, on the recordings that both completed."""

    best: str
    other: str
    difference: Difference  # by which the position error of the other one is larger
    divergences: ShareDifference  # of the other one: whether it diverges in more recordings
    # Whether the best one is better: its error is shown to be smaller, or the other one diverged, be it by chance.
    shown: bool
    tied: bool  # whether the other one never diverged and has the same error on every recording
    words: str  # the conclusion, a clause

    @property
    def is_sure(self) -> bool:
        """Whether it is better by more than divergences that may be chance."""
        return Finding.WORSE in (self.difference.finding, self.divergences.finding)


@dataclass(frozen=True)
class Verdict:
    """Verdict on all filters: the first lines of a report."""

    # Filter with the smallest position error of those that never diverged; None where there is none, or no error.
    best: str | None
    comparisons: Mapping[str, FilterComparison]  # by name of the other filter
    headline: str  # a few sentences
    # The sentences of the headline by the question they answer: "lost" (whether the first filter did not come through),
    # "best" (who, by how much, is it sure), "consistent", "limit", "cost"; what is not known is left out.
    answers: Mapping[str, str] = field(default_factory=dict)

    def _repr_html_(self) -> str:
        from stereo_slam_env.recording.notebook_html import paragraph

        return "".join(paragraph(answer) for answer in self.answers.values()) or paragraph(self.headline)

    @property
    def leaders(self) -> tuple[str, ...]:
        """The best one and those that tie with it."""
        tied = (name for name, comparison in self.comparisons.items() if comparison.tied)
        return () if self.best is None else (self.best, *tied)

    @property
    def is_shown(self) -> bool:
        """Whether the runs show the leaders to be better than all others; False where there are no others."""
        rivals = [comparison for comparison in self.comparisons.values() if not comparison.tied]
        return bool(rivals) and all(comparison.shown and comparison.is_sure for comparison in rivals)


def judge(summaries: Sequence[FilterSummary], figures: Figures) -> Verdict:
    """Compare the filters on accuracy; consistency, distance from the limit and cost of the best one beside it."""
    scored = [s for s in summaries if s.position_rmse_m is not None]
    steady = [s for s in scored if s.diverged == 0]
    if not steady:
        return Verdict(None, {}, _no_best(summaries, figures) if not scored else none_left(summaries))
    best = min(steady, key=lambda s: float(s.position_rmse_m or 0.0))
    rivals = [s for s in summaries if s is not best]
    comparisons = {
        s.filter_name: against_best(best, s, figures[best.filter_name], figures[s.filter_name], len(rivals))
        for s in rivals
    }
    answers = {
        "lost": _first_lost(summaries),
        "best": _accuracy(best, rivals, comparisons),
        "consistent": _consistency_words(best),
        "limit": _limit_words(best),
        "cost": _cost(best, rivals),
    }
    answers = {question: words for question, words in answers.items() if words}
    return Verdict(best.filter_name, comparisons, " ".join(answers.values()), answers)


def against_best(
    best: FilterSummary, other: FilterSummary, best_figures: RunFigures, other_figures: RunFigures, comparisons: int = 1
) -> FilterComparison:
    """Compare another filter with the best one, by position error, on the recordings that both completed."""
    keys = common_keys(best_figures, other_figures)
    difference = difference_between(other_figures, best_figures, POSITION, comparisons)
    divergences = share_difference(other_figures.diverged(keys), best_figures.diverged(keys), comparisons=comparisons)
    return FilterComparison(
        best=best.filter_name,
        other=other.filter_name,
        difference=difference,
        divergences=divergences,
        shown=bool(other.diverged) or difference.finding is Finding.WORSE,
        tied=difference.tied and not other.diverged,
        words=_comparison_words(other, difference, divergences),
    )


def consistency(summary: FilterSummary) -> Consistency:
    """Judge the mean pose NEES against its band; where something else explains it, that is to be settled first."""
    if summary.pose_anees is None or summary.pose_anees_band is None:
        return Consistency.UNKNOWN
    low, high = summary.pose_anees_band
    if summary.pose_anees > high:
        return Consistency.DOUBTFUL if summary.doubt else Consistency.OVERCONFIDENT
    return Consistency.CAUTIOUS if summary.pose_anees < low else Consistency.CONSISTENT


def loss(summary: FilterSummary) -> str:
    """Word for the incomplete runs of a filter: "failed" where it raised, "diverged" where it strayed, or both."""
    if not summary.failures:
        return "diverged"
    return "failed" if summary.diverged == len(summary.failures) else "diverged or failed"


def lost_words(summary: FilterSummary) -> str:
    """Number of runs in which a filter diverged or failed, in words."""
    where = "the only run" if summary.runs == 1 else f"{summary.diverged} of {summary.runs} runs"
    return f"{loss(summary)} in {where}"


def sureness(summary: FilterSummary) -> str:
    """Basis of a statement on consistency: "as far as one run can tell", "by the mean of 10 runs"."""
    figure = summary.consistency.get("pose")
    runs, frames = (summary.runs if figure is None else figure.runs), int(summary.figures.get("frames") or 0)
    of = f" of {frames} frames" if runs == 1 else f" of {frames} frames in all"
    of = of if frames < _FEW_FRAMES * runs else ""
    if runs >= MIN_PAIRS:
        return f"by the mean of {runs} runs{of}"
    return f"as far as {'one run' if runs == 1 else f'{runs} runs'}{of} can tell"


_FEW_FRAMES = 20
"""Of shorter runs the number of frames is said."""


def _comparison_words(other: FilterSummary, difference: Difference, divergences: ShareDifference) -> str:
    name = other.filter_name
    if difference.count == 0:
        return f"{name} {lost_words(other)}" if other.diverged else f"no run to compare with {name}"
    if other.diverged:
        if divergences.finding is Finding.WORSE:
            return f"{name} {lost_words(other)}"
        chance = ", which may be chance" if other.diverged < other.runs else ""
        worse = f", and run by run its error is {percent_words(difference.percent)} ({difference.evidence})"
        return f"{name} {lost_words(other)}{chance}{worse if difference.finding is Finding.WORSE else ''}"
    if difference.tied:
        return f"the error of {name} is {difference.tie_words}"
    if difference.shown:
        return f"the error of {name} is {percent_words(difference.percent)} ({difference.evidence})"
    if difference.count == 1:
        return f"the error of {name} is {percent_words(difference.percent)} on this drive, but one drive proves nothing"
    if difference.interval is None:
        return (
            f"{difference.count} runs are too few to compare it with {name}, {difference.needed} are needed "
            f"(the error of {name} is {percent_words(difference.percent)})"
        )
    return f"the difference from {name} is not significant ({difference.evidence})"


# ---- the headline ---------------------------------------------------------------------------------------------------


def _no_best(summaries: Sequence[FilterSummary], figures: Figures) -> str:
    """Reason why no filter has an error."""
    if all(len(s.failures) == s.runs for s in summaries):
        return none_left(summaries)
    scored = max(of_run["frames"] for s in summaries for of_run in figures[s.filter_name].of_run.values())
    if scored:
        return (
            f"Too short for a verdict: {scored} frame{'s have' if scored > 1 else ' has'} ground truth after the first "
            f"one, which is not scored, and at least {FEWEST_FRAMES} are needed."
        )
    return "There is no ground truth here: only innovations and cost can be compared."


def _first_lost(summaries: Sequence[FilterSummary]) -> str:
    """Sentence on the filter that is listed first, the default of a scenario, where it did not come through."""
    first = summaries[0]
    if not first.diverged:
        return ""
    return f"{first.filter_name}, the first of the {len(summaries)} filters, {lost_words(first)}."


def none_left(summaries: Sequence[FilterSummary]) -> str:
    """Headline where no filter came through every run."""
    lost = "; ".join(f"{s.filter_name} {lost_words(s)}" for s in summaries[:_MOST_WORDED])
    if len(summaries) == 1:
        return f"There is no verdict: {lost}."
    more = f"; and {len(summaries) - _MOST_WORDED} more" if len(summaries) > _MOST_WORDED else ""
    return f"None came through every run: {lost}{more}."


def _accuracy(best: FilterSummary, rivals: Sequence[FilterSummary], comparisons: Mapping[str, FilterComparison]) -> str:
    error = f"{readable(best.position_rmse_m)} m"
    if not rivals:
        return f"{best.filter_name} has a position error of {error}."
    tied = [c for c in comparisons.values() if c.tied]
    undecided = _undecided([c for c in comparisons.values() if not (c.shown or c.tied)])
    settled = _nearest([c for c in comparisons.values() if c.shown])
    who = listed([best.filter_name, *(c.other for c in tied)])
    if tied:
        widest = max((c.difference for c in tied), key=lambda difference: difference.largest)
        error = f"{error}, {widest.tie_words}"
    smallest = f"{who} {'tie for' if tied else 'has'} the smallest position error"
    if undecided:
        first = f"{smallest}, {error}. {_begun(undecided)}."
    elif not settled:
        first = f"{who} tie: their position error is {error}."
    elif all(c.is_sure for c in comparisons.values() if c.shown):
        first = f"{who} {'tie as' if tied else 'is'} the most accurate, with a position error of {error}."
    else:
        first = f"{smallest} of the filters that never diverged, {error}."
    return f"{first} {_begun(settled)}." if settled else first


def _begun(words: str) -> str:
    """Clause as the begin of a sentence; the name of a filter stays as it is."""
    return re.sub("^(the|on|one) ", lambda match: match[0].capitalize(), words)


def _undecided(open_ones: Sequence[FilterComparison]) -> str:
    """Words on rivals that are not shown to be worse; of many only the names."""
    if len(open_ones) > _MOST_WORDED:
        names = ", ".join(c.other for c in open_ones[:_MOST_WORDED])
        names += f" and {len(open_ones) - _MOST_WORDED} more"
        most = max((c.difference for c in open_ones), key=lambda d: d.count)
        if most.count == 1:
            return f"one drive proves nothing about {names}"
        if most.count and most.too_few:
            return f"{most.count} runs are too few to compare it with {names}, {most.needed} are needed"
        return f"the differences from {names} are not significant"
    few = [c for c in open_ones if c.difference.count and c.difference.interval is None]
    if len(few) > 1 and len({c.difference.count for c in few}) == 1:
        return "; ".join([_too_few(few), *(c.words for c in open_ones if c not in few)])
    return "; ".join(c.words for c in open_ones)


def _too_few(open_ones: Sequence[FilterComparison]) -> str:
    """Words on several rivals with the same, too small number of runs."""
    first, *other_errors = ((c.other, percent_words(c.difference.percent)) for c in open_ones)
    errors = [f"the error of {first[0]} is {first[1]}", *(f"that of {name} {words}" for name, words in other_errors)]
    runs, needed = open_ones[0].difference.count, open_ones[0].difference.needed
    if runs == 1:
        return f"on this drive {listed(errors)}, but one drive proves nothing"
    return f"{runs} runs are too few for a comparison, {needed} are needed ({listed(errors)})"


def _nearest(settled: Sequence[FilterComparison]) -> str:
    """Words on the nearest rivals; those that diverged count as the farthest."""
    in_order = sorted(settled, key=lambda c: (c.divergences.only_a, c.difference.percent))
    more = len(settled) - _MOST_WORDED
    words = "; ".join(c.words for c in in_order[:_MOST_WORDED])
    return f"{words}; and {more} more" if more > 0 else words


_MOST_WORDED = 3

_HONESTY = {
    Consistency.CONSISTENT: "inside its band ({band}): it is consistent",
    Consistency.OVERCONFIDENT: "above its band ({band}): it is overconfident",
    Consistency.DOUBTFUL: "above its band ({band}), and its covariance is not judged: calibration, frames or truth",
    Consistency.CAUTIOUS: "below its band ({band}): it claims more uncertainty than it has",
}


def _consistency_words(best: FilterSummary) -> str:
    state = consistency(best)
    if state is Consistency.UNKNOWN:
        return f"The consistency of {best.filter_name} is not known."
    mean, band = pose_nees(best)
    doubt = f": {best.doubt}" if state is Consistency.DOUBTFUL else ""
    judged = f"{_HONESTY[state].format(band=band)}{doubt}"
    return f"The pose NEES / 6 of {best.filter_name} is {mean}, {judged}, {sureness(best)}."


def pose_nees(summary: FilterSummary) -> tuple[str, str]:
    """Mean pose NEES and its band, both by the degrees of freedom, so that 1 is ideal: "0.85", "0.37 to 1.94"."""
    assert summary.pose_anees is not None
    assert summary.pose_anees_band is not None
    dof = DOF["pose"]
    low, high = (end / dof for end in summary.pose_anees_band)
    return POSE_NEES.text(summary.pose_anees), f"{low:.2f} to {high:.2f}"


def _limit_words(best: FilterSummary) -> str:
    reached = limit_reached(best)
    if reached is None:
        return ""
    bound = "the Cramér–Rao bound" + ("" if best.bound_position_m is None else f", {readable(best.bound_position_m)} m")
    if reached.reach in (Reach.SHORT, Reach.OPEN):
        sure = reached.sureness if reached.interval is None else f"95 % interval {reached.sureness}"
        open_ = ", so it may be optimal" if reached.reach is Reach.OPEN else ""
        return f"Its efficiency is {reached.value} ({sure}{open_}) of {bound}."
    if reached.reach is Reach.AT:
        return f"Its error is at the limit: its efficiency, {reached.sureness}, may be 100 % of {bound}."
    if reached.reach is Reach.BEYOND:
        return (
            f"Its error is below {bound} (efficiency {reached.sureness}): the bound is an average over drives of the "
            f"assumed motion; these were easier, perhaps by chance, or the filter is told more."
        )
    return f"Its error is {reached.value} ({reached.sureness}): {bound}."


def _cost(best: FilterSummary, rivals: Sequence[FilterSummary]) -> str:
    if best.ms_per_frame is None:
        return ""
    quicker = [s for s in rivals if s.ms_per_frame is not None and s.ms_per_frame < best.ms_per_frame]
    quickest = min(quicker, key=lambda s: float(s.ms_per_frame or 0.0), default=None)
    beside = ""
    if quickest is not None and quickest.ms_per_frame:
        excess = 100.0 * (best.ms_per_frame / quickest.ms_per_frame - 1.0)
        beside = f", {percent_words(excess, 'more')} than {quickest.filter_name}"
    return f"{best.filter_name} takes {readable(best.ms_per_frame)} ms a frame{beside}{timed_words(best, ' (', ')')}."


def timed_words(summary: FilterSummary, before: str = "", after: str = "") -> str:
    """Number of drives on which the filter was timed, in words; empty where that is all that it finished."""
    if summary.timed in (None, summary.runs - len(summary.failures)):
        return ""
    return f"{before}timed on {summary.timed} of {summary.runs} drives{after}"
