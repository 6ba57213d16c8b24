"""What has to be known to read the figures of a run: what they are held against, and innovations far from the claim."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.recording.recording import Reference, ReferenceKind

FAR = 2.0
"""An NIS by its degrees of freedom beyond this factor of 1, and outside its band, is remarked on.

The band alone is no measure: with the thousands of degrees of freedom of a drive it ends a few percent from 1, and the
noise of a real camera is not known so well. A factor of 2 is a sigma that is wrong by 40 %.
"""

_MOST_NAMED = 3
_CONSEQUENCES: dict[ReferenceKind, str] = {
    "independent truth": "",
    "odometry from the same images": " What is called error is the distance to it, whose own errors are not known: it "
    "shows gross faults, not which filter is better by a little, and there is no NEES.",
    "none": " There are neither errors nor NEES.",
}


def reference_remarks(runs: Sequence[FilterRun]) -> dict[Reference, str]:
    """What runs are held against, in words by reference; where there are several, with the recordings of each."""
    recordings: dict[Reference, dict[str, None]] = {}
    for run in runs:
        recordings.setdefault(run.reference, {})[run.recording_name] = None
    remarks = {}
    for reference, names in recordings.items():
        which = f" of {_named(list(names))}" if len(recordings) > 1 else ""
        remarks[reference] = f"Reference{which}: {reference}{_CONSEQUENCES[reference.kind]}"
    return remarks


def innovation_factor(summary: FilterSummary) -> float | None:
    """By how much the innovations of a filter are larger than it claims, in sigma; None where its NIS is near 1."""
    figure = summary.consistency.get("nis")
    if figure is None or not figure.mean > 0.0:
        return None
    low, high = figure.band
    far = figure.mean < min(low, 1.0 / FAR) or figure.mean > max(high, FAR)
    return float(np.sqrt(figure.mean)) if far else None


def innovation_remarks(summaries: Sequence[FilterSummary]) -> list[str]:
    """A sentence on filters whose innovations are far smaller than claimed, and one on those with far larger ones."""
    factors = {s.filter_name: factor for s in summaries if (factor := innovation_factor(s)) is not None}
    smaller = {name: factor for name, factor in factors.items() if factor < 1.0}
    larger = {name: factor for name, factor in factors.items() if factor > 1.0}
    remarks = []
    if smaller:
        causes = "too much noise is assumed, of pixels or of the motion, or errors last from frame to frame"
        remarks.append(f"{_far(smaller)}: {causes}.")
    if larger:
        remarks.append(f"{_far(larger)}: too little noise is assumed, or outliers come in.")
    return remarks


def times_the_claim(factor: float) -> str:
    """An `innovation_factor` in words, such as "4.9 times smaller than claimed"."""
    size = max(factor, 1.0 / factor)
    return f"{size:.{1 if size < 10.0 else 0}f} times {'smaller' if factor < 1.0 else 'larger'} than claimed"


def _far(factors: Mapping[str, float]) -> str:
    """The farthest of them is told."""
    farthest = max(factors.values(), key=lambda factor: abs(np.log(factor)))
    upto = "up to " if len(factors) > 1 else ""
    return (
        f"NIS is far from 1 (beyond a factor of {FAR:g}): "
        f"the innovations of {_named(list(factors))} are {upto}{times_the_claim(farthest)}"
    )


def _named(names: Sequence[str]) -> str:
    shown = list(names[:_MOST_NAMED])
    if len(names) > _MOST_NAMED:
        shown.append(f"{len(names) - _MOST_NAMED} more")
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"
