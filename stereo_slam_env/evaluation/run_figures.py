"""The figures of every run, computed once: tables, summaries, verdicts and reports all speak of these."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from filters.validation import BoolArray
from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.trial_metrics import trial_figures

RunKey = tuple[str, int | None]
"""What identifies a recording: its name and seed."""

Bounds = Mapping[RunKey, Bound]
"""Theoretical limits of recordings."""


@dataclass(frozen=True)
class RunFigures:
    """The figures of every run of a filter.

    Attributes
    ----------
    of_run : mapping of RunKey to mapping
        Of each run alone, see `trial_metrics`; None where not known.
    """

    of_run: Mapping[RunKey, Mapping[str, Any]]

    def of(self, runs: Iterable[FilterRun]) -> list[Mapping[str, Any]]:
        """The figures of these runs, in this order."""
        return [self.of_run[key_of(run)] for run in runs]

    def diverged(self, keys: Iterable[RunKey]) -> BoolArray:
        """Whether each run diverged or failed."""
        return np.array([self.of_run[key]["diverged"] > 0 for key in keys], dtype=bool)


Figures = Mapping[str, RunFigures]
"""By label of the filter."""


def key_of(run: FilterRun) -> RunKey:
    """The recording of a run."""
    return run.recording_name, run.seed


def figures_of(
    runs: Sequence[FilterRun], *, divergence_percent: float, bounds: Bounds | None = None
) -> dict[str, RunFigures]:
    """The figures of every run, by label of the filter, in order of first appearance.

    Parameters
    ----------
    runs : sequence of FilterRun
        Of any filters, each recording once.
    divergence_percent : float
        A run diverged if it ends farther from the truth than this share of the distance travelled: that of the
        scenario, so there is no default.
    bounds : mapping, optional
        Theoretical limits of the recordings, as far as they are known.

    Raises
    ------
    ValueError
        A filter ran twice on the same recording.
    """
    found: dict[str, dict[RunKey, Mapping[str, Any]]] = {}
    for run in runs:
        of_filter, key = found.setdefault(run.filter_name, {}), key_of(run)
        if key in of_filter:
            raise ValueError(f"runs must have each recording once a filter: {run.filter_name} ran twice on {key}")
        of_filter[key] = trial_figures(run, bound=(bounds or {}).get(key), divergence_percent=divergence_percent)
    return {name: RunFigures(of_run) for name, of_run in found.items()}


def common_keys(a: RunFigures, b: RunFigures) -> list[RunKey]:
    """Recordings that both were run on, in the order of `a`."""
    return [key for key in a.of_run if key in b.of_run]
