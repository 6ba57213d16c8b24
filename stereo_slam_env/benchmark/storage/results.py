"""What came out of a run: its runs, their figures, and one summary of each filter."""

from __future__ import annotations

from dataclasses import dataclass

from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Bounds, Figures


@dataclass(frozen=True, eq=False)
class RunResults:
    """What came out of a run.

    Attributes
    ----------
    runs : tuple of FilterRun
        All of them.
    figures : mapping of str to RunFigures
        Of every run, by label of the filter; what tables, summaries and verdicts speak of.
    summaries : tuple of FilterSummary
        One of each filter.
    bounds : mapping of (str, seed) to Bound
        By recording, where there are any.
    """

    runs: tuple[FilterRun, ...]
    figures: Figures
    summaries: tuple[FilterSummary, ...]
    bounds: Bounds
