"""Gate for continuous integration: whether anything is worse than in a baseline.

Baseline and runs are packets. Several of a system that is not deterministic are a distribution: of each recording the
geometric mean over them counts, and recordings are the sample. With so few recordings that a test could show nothing,
the runs are the sample, two groups of them; and with fewer of these, too, a change of more than a limit decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from filters.contract.validation import markdown
from filters.geometry.arrays import FloatArray
from stereo_slam_env.benchmark.statistics.differences import (
    Difference,
    Finding,
    as_percent,
    group_needed,
    pairs_needed,
    signed,
)
from stereo_slam_env.benchmark.statistics.measures import DIVERGED, POSE_NEES, POSITION, ROTATION, TIME, difference_by
from stereo_slam_env.evaluation.figures import Figure, readable

GATED = (POSITION, ROTATION, POSE_NEES)
"""Measures that are looked at; divergences beside them, and the time if it is asked for."""
_Trials = Mapping[tuple[str, str], Mapping[tuple[str, int | None], list[Mapping[str, Any]]]]
"""By cell and filter, then by recording: a row a run."""


@dataclass(frozen=True)
class GateRow:
    """One measure of one filter against the baseline."""

    filter_name: str
    """Label; in a grid with the name of the cell before it."""
    measure: str
    """In words, with its unit."""
    before: float | None
    """Over recordings and runs, as the tables of `bench` have it; of divergences their number."""
    after: float | None
    """The same of the run that is judged."""
    change_percent: float | None
    """Of the geometric mean, of consistency of the distance from 1; > 0 is worse; None where there is none."""
    by: str
    """What decided: "recordings", "runs" or "limit"."""
    failed: bool
    """Whether it is worse."""
    words: str
    """The reason, one line."""


@dataclass(frozen=True)
class Gate:
    """A baseline against runs."""

    rows: tuple[GateRow, ...]
    """By filter, then measure."""
    missing: tuple[str, ...]
    """Filters and recordings of the baseline that the runs do not have: that fails, too."""

    @property
    def passed(self) -> bool:
        """Whether nothing is worse or missing."""
        return not self.missing and not any(row.failed for row in self.rows)

    @property
    def headline(self) -> str:
        """The result in a sentence."""
        failed = [row for row in self.rows if row.failed]
        if self.passed:
            return f"Passed: nothing is worse in {len(self.rows)} comparisons."
        sentences = [f"{row.measure} of {row.filter_name}: {row.words}" for row in failed[:3]]
        more = [f"{len(failed) - 3} more"] if len(failed) > 3 else []
        return f"Failed: {'; '.join([*self.missing, *sentences, *more])}."

    def as_markdown(self) -> str:
        """Headline and a table, for a pull request."""
        heads = ["| filter | measure | baseline | now | change | |", "|---|---|--:|--:|--:|---|"]
        lines = [f"**{markdown(self.headline)}**", "", *heads]
        for row in self.rows:
            before, after = ("–" if value is None else readable(value, ".4g") for value in (row.before, row.after))
            change = "–" if row.change_percent is None else f"{signed(row.change_percent, 1)} %"
            name = markdown(row.filter_name)
            mark = "**worse**: " if row.failed else ""
            lines.append(f"| {name} | {row.measure} | {before} | {after} | {change} | {mark}{row.words} |")
        lines += [
            "",
            "Figures are over runs as in the tables of bench (root mean square of errors, mean of NEES, median of"
            " times); their change is the geometric mean of it over recordings.",
        ]
        return "\n".join(lines) + "\n"


def gate(
    baseline: Sequence[Mapping[str, Any]],
    runs: Sequence[Mapping[str, Any]],
    *,
    limit_percent: float = 5.0,
    with_time: bool = False,
) -> Gate:
    """Hold packets of runs against those of a baseline.

    Parameters
    ----------
    baseline, runs : sequence of mapping
        Packets, of `packets.packet_of`; several: runs of the same.
    limit_percent : float
        Change from which on a measure is worse where recordings and runs are too few for a test.
    with_time : bool
        Whether the time a frame is looked at, too, which depends on the machine.

    Raises
    ------
    ValueError
        There is nothing that both have.
    """
    was, now = _trials(baseline), _trials(runs)
    missing = [f"{_name(key)} is missing" for key in was if key not in now]
    common = [key for key in was if key in now]
    if not common:
        raise ValueError("baseline and runs have no filter in common: give runs of the same study")
    measures = (*GATED, *((TIME,) if with_time else ()))
    comparisons = len(common) * len(measures)
    rows: list[GateRow] = []
    for key in common:
        lost = [recording for recording in was[key] if recording not in now[key]]
        if lost:
            missing.append(f"{_name(key)} was not run on {len(lost)} of {len(was[key])} recordings")
        shared = [recording for recording in was[key] if recording in now[key]]
        before, after = ([side[key][recording] for recording in shared] for side in (was, now))
        if not shared:
            continue
        rows.append(_divergences(_name(key), before, after))
        found = (_row(_name(key), measure, before, after, limit_percent, comparisons) for measure in measures)
        rows += [row for row in found if row is not None]
    return Gate(tuple(rows), tuple(missing))


def _trials(packets: Sequence[Mapping[str, Any]]) -> _Trials:
    found: dict[tuple[str, str], dict[tuple[str, int | None], list[Mapping[str, Any]]]] = {}
    for packet in packets:
        for cell in packet["cells"]:
            for label, trials in cell["trials"].items():
                of_filter = found.setdefault((cell["name"] if len(packet["cells"]) > 1 else "", label), {})
                for trial in trials:
                    of_filter.setdefault((trial["recording"], trial["seed"]), []).append(trial)
    return found


def _name(key: tuple[str, str]) -> str:
    return ": ".join(filter(None, key))


def _divergences(name: str, before: list[list[Mapping[str, Any]]], after: list[list[Mapping[str, Any]]]) -> GateRow:
    """More runs that diverged or failed are worse, by share."""
    shares = [np.mean([bool(row["diverged"]) for rows in side for row in rows]) for side in (before, after)]
    counts = [sum(bool(row["diverged"]) for rows in side for row in rows) for side in (before, after)]
    totals = [sum(map(len, side)) for side in (before, after)]
    failed = bool(shares[1] > shares[0])
    words = f"{counts[0]} of {totals[0]} runs before, {counts[1]} of {totals[1]} now"
    return GateRow(name, DIVERGED.label, float(counts[0]), float(counts[1]), None, "limit", failed, words)


def _row(
    name: str,
    measure: Figure,
    before: list[list[Mapping[str, Any]]],
    after: list[list[Mapping[str, Any]]],
    limit: float,
    comparisons: int,
) -> GateRow | None:
    """A measure against the baseline; None where neither has it."""
    sides = [[np.array([measure.of(row) for row in rows]) for rows in side] for side in (before, after)]
    values = [np.concatenate(side) for side in sides]
    finite_values = [one[np.isfinite(one)] for one in values]
    if not len(finite_values[0]):
        return None
    combined = np.mean if measure.over_runs is None else measure.over_runs.of_values
    was, now = (float(combined(one)) if len(one) else None for one in finite_values)
    about = partial(GateRow, name, measure.title, was, now)
    if not len(finite_values[1]):
        return about(None, "limit", True, "it is not known any more")
    means = [np.array([_mean(one) for one in side]) for side in sides]
    runs = min(map(len, finite_values))
    difference: Difference
    if len(means[0]) >= pairs_needed(comparisons):
        by, difference = "recordings", difference_by(measure, means[1], means[0], comparisons=comparisons)
    elif len(means[0]) == 1 and runs >= group_needed(comparisons):
        by = "runs"
        difference = difference_by(measure, values[1], values[0], paired=False, comparisons=comparisons)
    else:
        difference = difference_by(measure, means[1], means[0])
        percent = as_percent(difference.estimate)
        failed = percent > limit
        words = difference.tie_words if difference.tied else f"more than {limit:g} % is worse; too few runs for a test"
        return about(percent, "limit", failed, words)
    finding_words = {Finding.WORSE: "shown", Finding.BETTER: "better"}.get(difference.finding, Finding.NOT_SHOWN.value)
    words = difference.tie_words if difference.tied else f"{finding_words} ({difference.evidence})"
    return about(as_percent(difference.estimate), by, difference.finding is Finding.WORSE, words)


def _mean(values: FloatArray) -> float:
    """Geometric mean of the runs on a recording; NaN where one is not known."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return float(np.exp(np.mean(np.log(values))))
