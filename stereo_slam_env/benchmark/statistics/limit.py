"""How near a filter comes to what theory allows: bound over error, with the interval that says how sure that is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from stereo_slam_env.benchmark.statistics.differences import CONFIDENCE, MIN_PAIRS
from stereo_slam_env.evaluation.cramer_rao import efficiency_interval
from stereo_slam_env.evaluation.results import FilterSummary


class Reach(Enum):
    """Where the bound over the error lies with respect to 100 %."""

    SHORT = "short of the limit"
    OPEN = "perhaps at the limit"
    AT = "at the limit"
    BEYOND = "beyond the limit"
    UNSURE = "not told from the limit"


@dataclass(frozen=True)
class LimitReached:
    """Bound over error of a filter.

    Attributes
    ----------
    percent : float
        Ratio of both root mean squares over runs.
    interval : pair of float, optional
        95 % interval of it over runs, in percent; None with fewer than `MIN_PAIRS`.
    runs : int
        How many have a bound and an error.
    """

    percent: float
    interval: tuple[float, float] | None
    runs: int

    @property
    def reach(self) -> Reach:
        """The bound holds on average and the ratio scatters: an interval with 100 % in it shows nothing more."""
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
        """The ratio, or where it would be 100 % or more, where that lies."""
        reach = self.reach
        if reach not in (Reach.SHORT, Reach.OPEN):
            return str(reach.value)
        return f"{self.percent:.0f} %" if self.percent >= 1.0 else f"{self.percent:.1g} %"

    @property
    def sureness(self) -> str:
        """The interval, or of how many runs the ratio is."""
        if self.interval is None:
            return f"{self.runs} run{'' if self.runs == 1 else 's'}"
        low, high = self.interval
        return f"{low:.{_digits(low)}f} to {high:.{_digits(high)}f} %"

    @property
    def words(self) -> str:
        """Both: "73 % (66 to 81 %)", "at the limit (82 to 140 %)"."""
        return f"{self.value} ({self.sureness})"


def limit_reached(summary: FilterSummary) -> LimitReached | None:
    """How near the filter comes; None where there is no bound or no error."""
    if summary.efficiency_percent is None:
        return None
    errors, efficiencies = np.array(summary.position_rmse_by_run), np.array(summary.efficiency_by_run)
    if len(errors) != len(efficiencies):
        return LimitReached(summary.efficiency_percent, None, summary.runs)
    known = np.isfinite(errors) & np.isfinite(efficiencies)
    interval = None
    if known.sum() >= MIN_PAIRS:
        interval = efficiency_interval(0.01 * efficiencies[known] * errors[known], errors[known], CONFIDENCE)
    return LimitReached(summary.efficiency_percent, interval, int(known.sum()))


def _digits(percent: float) -> int:
    """An end just short of 100 % must not be printed as 100."""
    return 1 if 99.0 < percent < 101.0 else 0
