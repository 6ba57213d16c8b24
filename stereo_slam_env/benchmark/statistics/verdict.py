"""Verdict on the filters: the best one, by how much, and whether the runs show it.

Filters are compared on the same recordings, see `benchmark.statistics`. The one with the smallest position error of
those that never diverged is held against each of the others; `pairwise` holds each against each, by every question.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from stereo_slam_env.benchmark.statistics.differences import Difference, Finding, ShareDifference, share_difference
from stereo_slam_env.benchmark.statistics.measures import POSITION, difference_between
from stereo_slam_env.benchmark.statistics.remarks import LimitReached, limit_reached
from stereo_slam_env.benchmark.statistics.sentences import sentence
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


class Missing(Enum):
    """Reason why no filter is the best."""

    TRUTH = "no ground truth"
    FRAMES = "too few frames with ground truth"
    FINISHED = "no filter came through every run"


@dataclass(frozen=True)
class FilterComparison:
    """The best filter against another one, on the recordings that both completed."""

    other: str
    summary: FilterSummary  # of the other one
    difference: Difference  # by which the position error of the other one is larger
    divergences: ShareDifference  # of the other one: whether it diverges in more recordings

    @property
    def shown(self) -> bool:
        """Whether the best one is better: its error is shown to be smaller, or the other one diverged, be it once."""
        return bool(self.summary.diverged) or self.difference.finding is Finding.WORSE

    @property
    def tied(self) -> bool:
        """Whether the other one never diverged and has the same error on every recording."""
        return self.difference.tied and not self.summary.diverged

    @property
    def is_sure(self) -> bool:
        """Whether it is better by more than divergences that may be chance."""
        return Finding.WORSE in (self.difference.finding, self.divergences.finding)

    @property
    def gives_interval(self) -> bool:
        """Whether its words give an interval: not those of a tie, nor of divergences that are no chance."""
        d, is_chance = self.difference, self.divergences.finding is not Finding.WORSE
        is_worded = not self.summary.diverged or (is_chance and d.finding is Finding.WORSE)
        return is_worded and d.interval is not None and not d.tied

    @property
    def words(self) -> str:
        """The conclusion, a clause."""
        return sentence("rival", self)


@dataclass(frozen=True)
class Verdict:
    """Verdict on all filters: the first lines of a report."""

    # Filter with the smallest position error of those that never diverged; None where there is none, or no error.
    best: str | None
    comparisons: Mapping[str, FilterComparison]  # by name of the other filter
    summaries: Sequence[FilterSummary]  # of all filters, in the order of the scenario
    missing: Missing | None = None  # why there is no best one
    frames: int = 0  # with ground truth, where they are too few

    def _repr_html_(self) -> str:
        from stereo_slam_env.recording.notebook_html import paragraph

        return "".join(map(paragraph, self.lines))

    @property
    def headline(self) -> str:
        """The verdict in a few sentences."""
        return " ".join(self.lines)

    @property
    def lines(self) -> list[str]:
        """The headline, an answer a line."""
        return list(self.answers.values()) if self.best is not None else [sentence("none_best", self, FEWEST_FRAMES)]

    @cached_property
    def answers(self) -> Mapping[str, str]:
        """Sentences of the headline by question; those without an answer are left out.

        They are "lost" (whether the first filter did not come through), "best" (which one, by how much, is it sure),
        "consistent", "limit" and "cost".
        """
        if self.best is None:
            return {}
        templates = {"lost": "first_lost", "best": "best", "consistent": "consistent", "limit": "limit", "cost": "cost"}
        answers = {question: sentence(template, self) for question, template in templates.items()}
        return {question: answer for question, answer in answers.items() if answer}

    @property
    def summary(self) -> FilterSummary:
        """Figures of the best filter."""
        return next(s for s in self.summaries if s.filter_name == self.best)

    @property
    def leaders(self) -> tuple[str, ...]:
        """The best one and those that tie with it."""
        tied = (name for name, comparison in self.comparisons.items() if comparison.tied)
        return () if self.best is None else (self.best, *tied)

    @property
    def first_lost(self) -> FilterComparison | None:
        """The filter that is listed first, the default of a scenario, where it did not come through every run."""
        return self.comparisons.get(self.summaries[0].filter_name) if self.summaries[0].diverged else None

    @property
    def widest_tie(self) -> Difference:
        """Difference of the filter that ties least closely."""
        return max((c.difference for c in self.comparisons.values() if c.tied), key=lambda d: d.largest)

    @property
    def undecided(self) -> list[FilterComparison]:
        """Filters that are neither shown to be worse nor tie."""
        return [c for c in self.comparisons.values() if not (c.shown or c.tied)]

    @property
    def beaten(self) -> list[FilterComparison]:
        """Filters that are shown to be worse, the nearest first; those that diverged are the farthest."""
        rivals = [c for c in self.comparisons.values() if c.shown]
        return sorted(rivals, key=lambda c: (c.divergences.only_a, c.difference.percent))

    @property
    def shared_evidence(self) -> int | None:
        """Number of paired runs behind all intervals, where it is the same; None where it is not."""
        counts = {c.difference.count for c in self.comparisons.values() if c.gives_interval}
        return counts.pop() if len(counts) == 1 else None

    @property
    def is_shown(self) -> bool:
        """Whether the runs show the leaders to be better than all others; False where there are no others."""
        rivals = [comparison for comparison in self.comparisons.values() if not comparison.tied]
        return bool(rivals) and all(comparison.shown and comparison.is_sure for comparison in rivals)

    @property
    def consistency(self) -> Consistency:
        """Consistency of the best filter."""
        return consistency(self.summary)

    @property
    def limit(self) -> LimitReached | None:
        """Bound over error of the best filter."""
        return limit_reached(self.summary)

    @property
    def quickest(self) -> FilterSummary | None:
        """The filter that takes the least time, where that is not the best one."""
        timed = [s for s in self.summaries if s.ms_per_frame is not None]
        quickest = min(timed, key=lambda s: float(s.ms_per_frame or 0.0), default=None)
        return quickest if quickest is not None and quickest.ms_per_frame != self.summary.ms_per_frame else None


def judge(summaries: Sequence[FilterSummary], figures: Figures) -> Verdict:
    """Compare the filters on accuracy; consistency, distance from the limit and cost of the best one beside it."""
    scored = [s for s in summaries if s.position_rmse_m is not None]
    steady = [s for s in scored if s.diverged == 0]
    if not steady:
        frames = max(of_run["frames"] or 0 for s in summaries for of_run in figures[s.filter_name].of_run.values())
        lost = scored or all(len(s.failures) == s.runs for s in summaries)
        missing = Missing.FINISHED if lost else Missing.FRAMES if frames else Missing.TRUTH
        return Verdict(None, {}, summaries, missing, frames)
    best = min(steady, key=lambda s: float(s.position_rmse_m or 0.0))
    rivals = [s for s in summaries if s is not best]
    comparisons = {
        s.filter_name: against_best(s, figures[best.filter_name], figures[s.filter_name], len(rivals)) for s in rivals
    }
    return Verdict(best.filter_name, comparisons, summaries)


def against_best(
    other: FilterSummary, best_figures: RunFigures, other_figures: RunFigures, comparisons: int = 1
) -> FilterComparison:
    """Compare another filter with the best one, by position error, on the recordings that both completed."""
    keys = common_keys(best_figures, other_figures)
    lost = other_figures.diverged(keys), best_figures.diverged(keys)
    return FilterComparison(
        other=other.filter_name,
        summary=other,
        difference=difference_between(other_figures, best_figures, POSITION, comparisons),
        divergences=share_difference(*lost, comparisons=comparisons),
    )


def consistency(summary: FilterSummary) -> Consistency:
    """Judge the mean pose NEES against its band; where something else explains it, that is to be settled first."""
    if summary.pose_anees is None or summary.pose_anees_band is None:
        return Consistency.UNKNOWN
    low, high = summary.pose_anees_band
    if summary.pose_anees > high:
        return Consistency.DOUBTFUL if summary.doubt else Consistency.OVERCONFIDENT
    return Consistency.CAUTIOUS if summary.pose_anees < low else Consistency.CONSISTENT
