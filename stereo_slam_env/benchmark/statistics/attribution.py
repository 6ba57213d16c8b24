"""Effects of the options of a filter, from runs of all their combinations.

Every response is a logarithm (of an error, of NEES by its degrees of freedom, of time), so that effects are factors.
Seeds are blocks, because a hard recording is hard for all: an effect is estimated on every seed, see `effects`, and
its interval and test are those of the mean over seeds, see `differences`. Both are corrected for the number of
effects of the same kind on the same response.

A run that diverged has no error worth averaging. It is left out; a combination that diverged on more than half of the
seeds is left out altogether. Both are said, and how often every level diverged is counted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.benchmark.scenarios.study import factorial_label
from stereo_slam_env.benchmark.statistics.effects import Response, ResponseAttribution, explain
from stereo_slam_env.benchmark.statistics.measures import POSE_NEES, POSITION, TIME
from stereo_slam_env.evaluation.run_figures import Figures


@dataclass(frozen=True)
class Attribution:
    """Effects of the options on all responses."""

    factors: Mapping[str, tuple[Any, ...]]
    """Levels of every factor, the first one is what the others are held against."""
    seeds: int
    """Number of seeds that took part."""
    combinations: int
    """Number of combinations that took part."""
    responses: tuple[ResponseAttribution, ...]
    """One for each response."""
    diverged_percent: Mapping[tuple[str, Any], float]
    """Share of the runs with that level that diverged or failed."""
    notes: tuple[str, ...]
    """What was left out, and why."""
    conclusion: str
    """A few sentences."""


def attribute_runs(factorial: Mapping[str, Sequence[Any]], figures: Figures) -> Attribution:
    """Effects of the options of a filter on position error, consistency and time.

    Parameters
    ----------
    factorial : mapping of str to sequence
        Levels of each option; the filters of the runs are named after `factorial_label`.
    figures : mapping of str to RunFigures
        Of the runs of all combinations, or of most; others are not looked at.

    Raises
    ------
    ValueError
        No run has the name of a combination, or too few are left to tell the factors apart.
    """
    factors = {name: tuple(levels) for name, levels in factorial.items()}
    labels = [factorial_label(dict(zip(factors, levels, strict=True))) for levels in product(*factors.values())]
    figures = {name: of_filter for name, of_filter in figures.items() if name in set(labels)}
    if not figures:
        raise ValueError(f"runs must be of filters named after their options, like {labels[0]!r}: there are none")
    keys = list(dict.fromkeys(key for of_filter in figures.values() for key in of_filter.of_run))
    shape = (*(len(levels) for levels in factors.values()), len(keys))
    ran, diverged = np.zeros((len(labels), len(keys)), dtype=bool), np.zeros((len(labels), len(keys)), dtype=bool)
    values = {measure: np.full((len(labels), len(keys)), np.nan) for measure in (POSITION, POSE_NEES, TIME)}
    for row, label in enumerate(labels):
        of_filter = figures.get(label)
        for column, key in enumerate(keys):
            if of_filter is not None and key in of_filter.of_run:
                ran[row, column] = True
                diverged[row, column] = of_filter.of_run[key]["diverged"] > 0
                for measure, table in values.items():
                    table[row, column] = measure.of(of_filter.of_run[key])
    responses = {
        measure.label: Response(_logarithms(table).reshape(shape), measure.unit, None if measure.ideal is None else 1.0)
        for measure, table in values.items()
        if np.isfinite(table).any()
    }
    return attribute(factors, responses, ran=ran.reshape(shape), diverged=diverged.reshape(shape))


def attribute(
    factors: Mapping[str, Sequence[Any]],
    responses: Mapping[str, Response],
    *,
    ran: BoolArray | None = None,
    diverged: BoolArray | None = None,
) -> Attribution:
    """Main effects and interactions of crossed factors, seeds being blocks.

    The first level of each factor, of at least two, is what the others are held against. `ran` and `diverged`
    (*levels, S) say whether there was such a run, and whether it diverged; None: all ran, none diverged.

    Raises
    ------
    ValueError
        A factor has one level, or its levels are not all different, a response has another shape than the factors, or
        what is missing leaves factors that cannot be told apart.
    """
    for name, levels in factors.items():
        if len(levels) < 2 or len({str(level) for level in levels}) < len(levels):
            raise ValueError(f"factor {name!r} must have at least two different levels, got {list(levels)}")
    counts = tuple(len(levels) for levels in factors.values())
    for name, response in responses.items():
        if response.logarithms.shape[:-1] != counts:
            raise ValueError(
                f"response {name!r} must be of shape (*levels, seeds) with levels {counts}, "
                f"got {response.logarithms.shape}"
            )
    shape = next(iter(responses.values())).logarithms.shape
    ran = np.ones(shape, dtype=bool) if ran is None else ran
    diverged = np.zeros(shape, dtype=bool) if diverged is None else diverged
    out = diverged.sum(axis=-1) * 2 > ran.sum(axis=-1)
    usable = ran & ~diverged & ~out[..., None]
    usable_runs = {
        name: [k for k in range(len(levels)) if np.take(usable, k, axis=axis).any()]
        for axis, (name, levels) in enumerate(factors.items())
    }
    factors_left = {name: tuple(factors[name][k] for k in ks) for name, ks in usable_runs.items() if len(ks) >= 2}
    if not factors_left:
        raise ValueError("too many combinations are missing or diverged: no factor has two levels left")
    grid = np.ix_(*usable_runs.values(), range(shape[-1]))
    results, left_out = [], set()
    for name, response in responses.items():
        logarithms = np.where(usable, response.logarithms, np.nan)[grid]
        logarithms = logarithms.reshape(*map(len, factors_left.values()), shape[-1])
        result, cannot = explain(name, replace(response, logarithms=logarithms), factors_left)
        results.append(result)
        left_out |= set(cannot)
    return Attribution(
        factors=factors_left,
        seeds=int(usable.any(axis=tuple(range(len(counts)))).sum()),
        combinations=int(usable.any(axis=-1).sum()),
        responses=tuple(results),
        diverged_percent=_diverged_percent(factors, ran, diverged),
        notes=(*_missing(factors, ran, diverged, out), *_not_estimated(factors, factors_left, sorted(left_out))),
        conclusion=" ".join(result.conclusion for result in results),
    )


def _diverged_percent(
    factors: Mapping[str, Sequence[Any]], ran: BoolArray, diverged: BoolArray
) -> dict[tuple[str, Any], float]:
    percents = {}
    for axis, (name, levels) in enumerate(factors.items()):
        for k, level in enumerate(levels):
            runs = int(np.take(ran, k, axis=axis).sum())
            if runs:
                percents[name, level] = 100.0 * float(np.take(diverged, k, axis=axis).sum()) / runs
    return percents


def _missing(factors: Mapping[str, Sequence[Any]], ran: BoolArray, diverged: BoolArray, out: BoolArray) -> list[str]:
    """Notes on combinations without runs and on runs that diverged."""
    absent, added, partly = [], [], []
    for place, levels in zip(np.ndindex(out.shape), product(*factors.values()), strict=True):
        label = factorial_label(dict(zip(factors, levels, strict=True)))
        lost = f"{label} ({diverged[place].sum()} of {ran[place].sum()})"
        if not ran[place].any():
            absent.append(label)
        elif out[place]:
            added.append(lost)
        elif diverged[place].any():
            partly.append(lost)
    notes = [f"There are no runs of {_some(absent)}."] if absent else []
    notes += [f"Left out, because more than half of the runs diverged: {_some(added)}."] if added else []
    return notes + ([f"Runs that diverged are left out, which flatters {_some(partly)}."] if partly else [])


def _not_estimated(
    factors: Mapping[str, Sequence[Any]], left: Mapping[str, Sequence[Any]], left_out: Sequence[tuple[int, ...]]
) -> list[str]:
    notes = []
    for name, levels in factors.items():
        lost = [str(level) for level in levels if level not in left.get(name, ())]
        if name not in left:
            notes.append(f"Nothing can be said about {name}: fewer than two of its levels are left.")
        elif lost:
            notes.append(f"Nothing can be said about {name} = {', '.join(lost)}.")
    names = list(left)
    pairs = [f"{names[i]} and {names[j]}" for i, j in left_out]
    return notes + [f"The interaction of {pair} cannot be estimated from what is left." for pair in pairs]


def _some(words: Sequence[str], most: int = 6) -> str:
    return ", ".join(words[:most]) + (f" and {len(words) - most} more" if len(words) > most else "")


def _logarithms(values: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(values > 0.0, np.log(values), np.nan))
