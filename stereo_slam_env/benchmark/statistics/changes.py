"""Changes between two runs of the benchmark: the values before and after, what is shown, and that in words.

Values are those of the table of figures, as everywhere. A change is run by run: the geometric mean of the ratios on the
same recordings, which a single hard recording does not decide, so it is not the ratio of the two values.
"""

from __future__ import annotations

from dataclasses import dataclass

from stereo_slam_env.benchmark.statistics.differences import Difference, Finding, ShareDifference, signed
from stereo_slam_env.benchmark.statistics.measures import DIVERGED, TIME
from stereo_slam_env.benchmark.statistics.sentences import few, sentence
from stereo_slam_env.evaluation.figures import Figure

MOST_ROWS = 24
"""So many changes fit a screen."""


@dataclass(frozen=True)
class Change:
    """One measure of one filter, before and after."""

    filter_name: str  # label; in a grid with the name of the cell before it
    figure: Figure  # the measure
    # Over the common recordings, combined as the table of figures does; of divergences their number.
    before: float
    after: float
    runs: tuple[int, int]  # before and after
    difference: Difference | ShareDifference  # by which it is worse after than before
    cell: str = ""  # of the grid

    @property
    def measure(self) -> str:
        """The measure in words: "position error", "diverged runs"."""
        return self.figure.label

    @property
    def unit(self) -> str:
        """Unit of `before` and `after`; may be empty."""
        return "" if self.figure is DIVERGED else self.figure.unit

    @property
    def is_time(self) -> bool:
        """Whether it is of time, which depends on the machine."""
        return self.figure is TIME

    @property
    def finding(self) -> Finding:
        """Better or worse after than before, or no difference shown."""
        return self.difference.finding

    @property
    def interval_percent(self) -> tuple[float, float] | None:
        """Interval of how much larger it became run by run, or how much farther from the ideal; None: there is none."""
        return self._of_value.interval_percent

    @property
    def _of_value(self) -> Difference | ShareDifference:
        """Difference by which the value is larger, where `difference` is by how much it is worse."""
        if isinstance(self.difference, ShareDifference) or not self.figure.larger_is_better:
            return self.difference
        return self.difference.reversed

    @property
    def words(self) -> str:
        """The change with its evidence."""
        if isinstance(self.difference, ShareDifference):
            return sentence("share_change", self)
        return sentence("change", self.figure, self.difference)

    @property
    def brief(self) -> str:
        """The change in few characters: "+30 % (+25 to +35 %)"; may be empty."""
        change = self._of_value
        if isinstance(change, ShareDifference):
            return f"of {self.runs[0]} and {self.runs[1]} runs"
        if change.tied:
            return ""
        if self.figure.ideal is not None:
            return {Finding.BETTER: "nearer to 1", Finding.WORSE: "farther from 1"}.get(change.finding, "")
        interval = "" if change.interval is None else f" ({change.interval_words})"
        value = f"{signed(change.percent)} %" if self.figure.is_ratio else f"{signed(change.estimate, 2)}{self.unit}"
        return f"{value}{interval}"

    @property
    def title(self) -> str:
        """Measure and unit: "position error, m"."""
        return f"{self.measure}, {self.unit}" if self.unit else self.measure

    @property
    def values(self) -> tuple[str, str]:
        """Before and after, with the digits that every table gives them."""
        before, after = (self.figure.text_of(value) for value in (self.before, self.after))
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

    @property
    def headline(self) -> str:
        """What changed significantly, in a few sentences; where nothing did, whether it could have been seen."""
        return sentence("changed", self)

    @property
    def shown(self) -> tuple[Change, ...]:
        """The changes that the runs show."""
        return tuple(change for change in self.changes if change.finding is not Finding.NOT_SHOWN)

    @property
    def shown_by_finding(self) -> dict[Finding, list[Change]]:
        """The changes that the runs show, worse and better ones."""
        groups = {f: [c for c in self.changes if c.finding is f] for f in (Finding.WORSE, Finding.BETTER)}
        return {finding: changes for finding, changes in groups.items() if changes}

    @property
    def how(self) -> str:
        """Basis of a change: "run by run", or of two samples."""
        return "run by run" if self.paired else "of geometric means"

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
                alike.setdefault(which + sentence("not_changed", not_shown), []).append(name)
        more = len(self.shown) - len(self.as_rows())
        lines = [f"{few(names)}: {outcome}." for outcome, names in alike.items()]
        return (f"{more} more changes are shown; the page has them all.", *lines) if more else tuple(lines)

    def __str__(self) -> str:
        table = [" | ".join(row) for row in (self.columns, *self.as_rows())] if self.shown else []
        return "\n".join([self.headline, *self.warnings, *table, *self.rest])
