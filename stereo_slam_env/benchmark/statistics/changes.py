"""Changes between two runs of the benchmark: the values before and after, what is shown, and that in words.

Values are those of the table of figures, as everywhere. A change is run by run: the geometric mean of the ratios on the
same recordings, which a single hard recording does not decide, so it is not the ratio of the two values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from filters.geometry.arrays import BoolArray
from stereo_slam_env.benchmark.statistics.differences import (
    TIE_PERCENT,
    Difference,
    Finding,
    group_needed,
    listed,
    pairs_needed,
    share_difference,
    signed,
)
from stereo_slam_env.benchmark.statistics.measures import DIVERGED, MEASURES, TIME, change_words
from stereo_slam_env.evaluation.figures import Figure

MOST_WORDED = 3
"""Of more changes, filters or cells than that, a sentence says only how many more there are."""
MOST_ROWS = 24
"""So many changes fit a screen."""
_FIGURES = {figure.label: figure for figure in (*MEASURES, DIVERGED)}


@dataclass(frozen=True)
class Change:
    """One measure of one filter, before and after."""

    filter_name: str  # label; in a grid with the name of the cell before it
    measure: str  # in words: "position error", "diverged runs"
    unit: str  # of `before` and `after`; may be empty
    # Over the common recordings, combined as the table of figures does; of divergences their number.
    before: float
    after: float
    count: int  # recordings, pairs where they are paired
    # Of by how much it became larger run by run; of consistency, of how much farther from the ideal it came; None where
    # there is none (too few runs, divergences).
    interval_percent: tuple[float, float] | None
    p_value: float  # corrected
    finding: Finding  # better or worse after than before, or no difference shown
    words: str
    brief: str  # `words` in few characters: "+30 % (+25 to +35 %)"; may be empty
    needed: int  # with fewer runs no outcome could be shown
    tied: bool = False  # whether nothing has changed, to within `TIE_PERCENT`
    identical: bool = False  # whether no value has changed at all
    cell: str = ""  # of the grid

    @property
    def too_few(self) -> bool:
        """Whether no outcome whatever could have shown a change."""
        return self.count < self.needed

    @property
    def title(self) -> str:
        """Measure and unit: "position error, m"."""
        return f"{self.measure}, {self.unit}" if self.unit else self.measure

    @property
    def values(self) -> tuple[str, str]:
        """Before and after, with the digits that every table gives them."""
        before, after = (_FIGURES[self.measure].text_of(value) for value in (self.before, self.after))
        return before, after


@dataclass(frozen=True)
class RunComparison:
    """Changes from one run of the benchmark to another one."""

    before: str
    """Folder of the first run."""
    after: str
    """Folder of the second run."""
    paired: bool
    """Whether their measurements are bit-identical, recording by recording."""
    changes: tuple[Change, ...]
    """By filter, then measure."""
    filters_before: tuple[str, ...]
    """Filters that only the first run has."""
    filters_after: tuple[str, ...]
    """Filters that only the second run has."""
    recordings_before: tuple[str, ...]
    """Recordings that only the first run has."""
    recordings_after: tuple[str, ...]
    """Recordings that only the second run has."""
    warnings: tuple[str, ...]
    """What the reader must know before believing the table, one sentence each."""
    headline: str
    """What changed significantly, in a few sentences."""

    @property
    def shown(self) -> tuple[Change, ...]:
        """The changes that the runs show."""
        return tuple(change for change in self.changes if change.finding is not Finding.NOT_SHOWN)

    @property
    def how(self) -> str:
        """Basis of a change: "run by run", or two samples."""
        return how(paired=self.paired)

    @property
    def columns(self) -> tuple[str, ...]:
        """Headings of `as_rows`."""
        return ("finding", "filter", "measure", "before", "after", f"change {self.how}")

    def as_rows(self, most: int = MOST_ROWS) -> list[tuple[str, ...]]:
        """Cells of a table of the shown changes, see `columns`; of more than `most` those of the first measures."""
        order = list(dict.fromkeys(change.measure for change in self.changes))
        first_changes = sorted(self.shown, key=lambda change: order.index(change.measure))[:most]
        return [(c.finding.value, c.filter_name, c.title, *c.values, c.brief) for c in self.shown if c in first_changes]

    @property
    def rest(self) -> tuple[str, ...]:
        """Note on what `as_rows` leaves out: a line for all cells (or filters of one scenario) that came out alike."""
        alike: dict[str, list[str]] = {}
        for name in dict.fromkeys(change.cell or change.filter_name for change in self.changes):
            of_cell = [change for change in self.changes if name == (change.cell or change.filter_name)]
            not_shown = [change for change in of_cell if change.finding is Finding.NOT_SHOWN]
            if not_shown:
                which = "" if len(not_shown) == len(of_cell) else f"in {len(not_shown)} more measures "
                alike.setdefault(which + _outcome(not_shown), []).append(name)
        more = len(self.shown) - len(self.as_rows())
        lines = [f"{few(names)}: {outcome}." for outcome, names in alike.items()]
        return (f"{more} more changes are shown; the page has them all.", *lines) if more else tuple(lines)

    def __str__(self) -> str:
        table = [" | ".join(row) for row in (self.columns, *self.as_rows())] if self.shown else []
        return "\n".join([self.headline, *self.warnings, *table, *self.rest])


def change_of(measure: Figure, difference: Difference, before: float, after: float) -> Change:
    """The change of a measure, from these values over runs, with its difference run by run (after against before)."""
    percent = difference.reversed if measure.larger_is_better else difference
    brief = f"{signed(percent.estimate, 2)}{measure.unit}"
    if measure.ideal is not None:
        nearer = {Finding.BETTER: "nearer to 1", Finding.WORSE: "farther from 1"}
        brief = nearer.get(difference.finding, "")
    elif measure.is_ratio:
        brief = f"{signed(percent.percent)} %"
    interval = "" if percent.interval is None or measure.ideal is not None else f" ({percent.interval_words})"
    return Change(
        filter_name="",
        measure=measure.label,
        unit=measure.unit,
        before=before,
        after=after,
        count=difference.count,
        interval_percent=percent.interval_percent,
        p_value=difference.p_value,
        finding=difference.finding,
        words=change_words(measure, difference),
        brief="" if difference.tied else brief + interval,
        needed=difference.needed,
        tied=difference.tied,
        identical=difference.identical,
    )


def divergences_changed(after: BoolArray, before: BoolArray, *, paired: bool, comparisons: int) -> Change:
    """The change of the number of runs that diverged; see `share_difference`."""
    share = share_difference(after, before, paired=paired, comparisons=comparisons)
    lost, are_lost = int(before.sum()), int(after.sum())
    words = f"{lost} of {len(before)} runs before, {are_lost} of {len(after)} after"
    same = np.array_equal(after, before)
    if same:
        words = f"the same {are_lost} of {len(after)} runs"
    elif share.finding is Finding.NOT_SHOWN:
        words = f"{words}, which may be chance"
    return Change(
        filter_name="",
        measure=DIVERGED.label,
        unit="",
        before=lost,
        after=are_lost,
        count=share.count,
        interval_percent=None,
        p_value=share.p_value,
        finding=share.finding,
        words=words,
        brief=f"of {len(before)} and {len(after)} runs",
        needed=(pairs_needed if paired else group_needed)(comparisons),
        tied=same,
        identical=same,
    )


# ---- in words --------------------------------------------------------------------------------------------------------


def how(*, paired: bool) -> str:
    """Basis of a change in percent, beside values over runs."""
    return "run by run" if paired else "of geometric means"


def headline(changes: Sequence[Change], *, paired: bool) -> str:
    """Sentence on what changed significantly; where nothing did, whether it could have been seen."""
    sentences = []
    for finding in (Finding.WORSE, Finding.BETTER):
        shown = [f"{c.measure} of {c.filter_name}: {c.words}" for c in changes if c.finding is finding]
        if shown:
            more = f"; and {len(shown) - MOST_WORDED} more" if len(shown) > MOST_WORDED else ""
            words = "; ".join(shown[:MOST_WORDED])
            sentences.append(f"{finding.value.capitalize()} after than before, {how(paired=paired)}: {words}{more}.")
    if sentences:
        return " ".join(sentences)
    figure_changes = [change for change in changes if change.measure != TIME.label]
    if not figure_changes:
        return "Nothing could be compared" + (" but the time, of which no difference is shown." if changes else ".")
    if all(change.tied for change in figure_changes):
        about = not all(change.identical for change in figure_changes)
        return f"Nothing has changed{f' by {TIE_PERCENT:g} % or more' if about else ''} but perhaps the time."
    return f"No difference is shown in {len(changes)} comparisons{_too_few(figure_changes)}."


def _outcome(changes: Sequence[Change]) -> str:
    """Reason why none of these changes is shown."""
    figure_changes = [change for change in changes if change.measure != TIME.label]
    if all(change.tied for change in figure_changes):
        timed = "" if all(change.tied for change in changes) else " but perhaps the time"
        return f"the same in all runs{timed}" if figure_changes else Finding.NOT_SHOWN.value
    return f"{Finding.NOT_SHOWN.value}{_too_few(changes)}"


def _too_few(changes: Sequence[Change]) -> str:
    """Words where so few runs could not have shown any of the changes."""
    moved = [change for change in changes if not change.tied and change.measure != TIME.label]
    if not moved or not all(change.too_few for change in moved):
        return ""
    most, needed = max(change.count for change in moved), min(change.needed for change in moved)
    return f": {most} run{' is' if most == 1 else 's are'} too few, {needed} are needed"


def few(words: Sequence[str]) -> str:
    """The first of many names, and how many more there are."""
    more = len(words) - MOST_WORDED
    return f"{', '.join(words[:MOST_WORDED])} and {more} more" if more > 0 else listed(words)
