"""One scenario or a grid of them: what a run of the benchmark consists of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stereo_slam_env.benchmark.scenario import Scenario


@dataclass(frozen=True)
class Cell:
    """One point of a grid.

    Attributes
    ----------
    name : str
        Usable as a folder name; unique in its study.
    factors : mapping of str to value
        What distinguishes it, e.g. {"options.sigma": 2.0}; empty in a study of one cell.
    scenario : Scenario
        What is run.
    """

    name: str
    factors: Mapping[str, Any]
    scenario: Scenario


@dataclass(frozen=True)
class Study:
    """A scenario file: one cell, or one for each point of its grid.

    Attributes
    ----------
    name : str
        For titles.
    cells : tuple of Cell
        At least one.
    factorial : mapping of str to tuple, optional
        Options of the filter whose levels were crossed, e.g. {"landmark": ("inverse-depth", "euclidean")}: the labels
        of the filters of every cell are those of `factorial_label`.
    """

    name: str
    cells: tuple[Cell, ...]
    factorial: Mapping[str, tuple[Any, ...]] | None = None


def factorial_label(levels: Mapping[str, Any]) -> str:
    """Label of the filter with these levels: "inverse-depth+joint+so3" of {"landmark": "inverse-depth", ...}."""
    return "+".join(str(level).lower().replace(" ", "-") for level in levels.values())
