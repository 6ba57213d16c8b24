"""One scenario or a grid of them: what a run of the benchmark consists of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from stereo_slam_env.benchmark.scenarios.labels import require_label
from stereo_slam_env.benchmark.scenarios.scenario import Scenario


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

    Raises
    ------
    ValueError
        No cells, or their names cannot be those of folders.
    """

    name: str
    cells: tuple[Cell, ...]
    factorial: Mapping[str, tuple[Any, ...]] | None = None

    def __post_init__(self) -> None:
        if not self.cells:
            raise ValueError("cells must be at least one")
        names = [cell.name for cell in self.cells]
        for name in names if self.is_grid else ():
            require_label("name of a cell", name, longest=200)  # of a grid: all its factors
            if names.count(name) > 1:
                raise ValueError(f"cells must have different names, got {name!r} twice")

    @classmethod
    def of(cls, scenario: Scenario) -> Study:
        """A study of one scenario."""
        return cls(scenario.name, (Cell(scenario.name, {}, scenario),))

    @property
    def is_grid(self) -> bool:
        """Whether there are cells to be told apart."""
        return bool(self.cells[0].factors) or len(self.cells) > 1

    def only_scenario(self) -> Scenario:
        """The scenario of a study of one cell.

        Raises
        ------
        ValueError
            There are several.
        """
        if len(self.cells) != 1:
            raise ValueError(f"{self.name!r} is a grid of {len(self.cells)} scenarios, not one")
        return self.cells[0].scenario

    def with_scenarios(self, change: Callable[[Scenario], Scenario]) -> Study:
        """The same study with every scenario changed."""
        return replace(self, cells=tuple(replace(cell, scenario=change(cell.scenario)) for cell in self.cells))

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form; `from_dict` reads it."""
        return {
            "name": self.name,
            "cells": [
                {"name": cell.name, "factors": dict(cell.factors), "scenario": cell.scenario.as_dict()}
                for cell in self.cells
            ],
            "factorial": None if self.factorial is None else {key: list(v) for key, v in self.factorial.items()},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Study:
        """A study from its JSON form."""
        cells = (Cell(c["name"], c["factors"], Scenario.from_dict(c["scenario"])) for c in data["cells"])
        crossed = data["factorial"]
        return cls(
            data["name"], tuple(cells), None if crossed is None else {key: tuple(v) for key, v in crossed.items()}
        )


def factorial_label(levels: Mapping[str, Any]) -> str:
    """Label of the filter with these levels: "inverse-depth+joint+so3" of {"landmark": "inverse-depth", ...}."""
    return "+".join(str(level).lower().replace(" ", "-") for level in levels.values())
