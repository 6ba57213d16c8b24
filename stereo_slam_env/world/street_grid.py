"""A grid of streets: junctions, the roads between them, and the steps of a drive from road to road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray

LEFT, STRAIGHT, RIGHT = 0, 1, 2
"""What a driver may do at a junction."""
_FALL_BACK = (STRAIGHT, RIGHT, LEFT)
"""Where the chosen road does not exist, the first of these that does is taken; at every junction one does."""
_STRIDE = 0.5
"""Of a step, m, about: a street is driven in a whole number of them."""
_TURN_STEPS = 40
_LANE = 1.75
"""Of the path that is driven, right of the middle of the street, m."""
_JUNCTIONS = 4
"""In each row and in each column."""
_BLOCK = (38.0, 54.0)
"""Shortest and longest side of a block, m."""


class Place(NamedTuple):
    """Middle of a road between two junctions: the one ahead, and the direction: 0 is +z, 1 +x, 2 -z, 3 -x."""

    column: int
    row: int
    heading: int


@dataclass(frozen=True, eq=False)
class StreetGrid:
    """Streets along straight lines that cross; the start is in the middle of one, at W's origin, towards +z."""

    columns: FloatArray
    """Lateral positions x of the streets along z, m, ascending."""
    rows: FloatArray
    """Forward positions z of those along x, m, ascending."""
    start: Place

    def __deepcopy__(self, memo: dict[int, object]) -> StreetGrid:
        return self  # nobody changes it

    @property
    def count(self) -> int:
        """Number of roads, each from one junction to the next."""
        return 2 * len(self.columns) * len(self.rows) - len(self.columns) - len(self.rows)

    def beyond(self, place: Place, choice: int) -> Place | None:
        """Road that a choice leads to; None where there is no such road."""
        heading = (place.heading + choice - STRAIGHT) % 4
        column, row = place.column + (0, 1, 0, -1)[heading], place.row + (1, 0, -1, 0)[heading]
        inside = 0 <= column < len(self.columns) and 0 <= row < len(self.rows)
        return Place(column, row, heading) if inside else None

    def taken(self, place: Place, choice: int) -> tuple[int, Place]:
        """The choice that is driven where `choice` is asked for, and where it leads."""
        for possible in (choice, *_FALL_BACK):
            beyond = self.beyond(place, possible)
            if beyond is not None:
                return possible, beyond
        raise ValueError(f"there must be a road on from every junction, got columns {self.columns}, rows {self.rows}")

    def road(self, place: Place) -> int:
        """Number of the road, whichever its direction."""
        column, row, heading = place
        if heading % 2 == 0:
            return column * (len(self.rows) - 1) + row - (heading == 0)
        along_z = len(self.columns) * (len(self.rows) - 1)
        return along_z + row * (len(self.columns) - 1) + column - (heading == 1)

    def length(self, place: Place) -> float:
        """Length of the road, from junction to junction, m."""
        lines, at = (self.rows, place.row) if place.heading % 2 == 0 else (self.columns, place.column)
        behind = at - 1 if place.heading < 2 else at + 1
        return float(abs(lines[at] - lines[behind]))

    def roads_to(self, place: Place, wanted: BoolArray) -> int:
        """Number of roads that are driven after this one until one of those `wanted` (R,); 0: this is one."""
        near, visited, count = [place], {place}, 0
        while near:
            if any(wanted[self.road(each)] for each in near):
                return count
            further = (self.beyond(each, choice) for each in near for choice in _FALL_BACK)
            near = list({beyond: None for beyond in further if beyond is not None and beyond not in visited})
            visited.update(near)
            count += 1
        return self.count

    def to_new(self, place: Place, driven: BoolArray) -> int:
        """The choice that leads to a road that has not been driven (R,) in the fewest roads."""
        open_ways = [choice for choice in _FALL_BACK if self.beyond(place, choice) is not None]
        return min(open_ways, key=lambda choice: self.roads_to(self.taken(place, choice)[1], ~driven))

    @cached_property
    def tour(self) -> list[int]:
        """Choices by which all roads are driven."""
        driven, place, choices = np.zeros(self.count, dtype=np.bool_), self.start, []
        driven[self.road(place)] = True
        while not driven.all():
            choice, place = self.taken(place, self.to_new(place, driven))
            driven[self.road(place)] = True
            choices.append(choice)
        return choices

    def steps(self, choices: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Metres and rad of each step from the start to the middle of the last road, and one step more."""
        place, metres, turns = self.start, [], []
        for choice in choices:
            possible, next_place = self.taken(place, choice)
            for far, turning in ((self.length(place), 0), (self.length(next_place), 1)):
                straight = 0.5 * far if possible == STRAIGHT else 0.5 * far - _REACH + (STRAIGHT - possible) * _LANE
                count = max(round(straight / _STRIDE), 1)
                metres.append(np.full(count, straight / count))
                turns.append(np.zeros(count))
                if turning == 0 and possible != STRAIGHT:
                    metres.append(np.full(_TURN_STEPS, _STRIDE))
                    turns.append((possible - STRAIGHT) * _TURN)
            place = next_place
        return np.concatenate([*metres, [_STRIDE]]), np.concatenate([*turns, [0.0]])


def random_streets(rng: np.random.Generator) -> StreetGrid:
    """Blocks of random sides; the start is on a street in the middle, between the first two that cross it."""
    columns, rows = (np.concatenate([[0.0], np.cumsum(rng.uniform(*_BLOCK, _JUNCTIONS - 1))]) for _ in range(2))
    column = int(rng.integers(1, _JUNCTIONS - 1))
    middle = 0.5 * (rows[0] + rows[1])
    return StreetGrid(columns - columns[column] - _LANE, rows - middle, Place(column, 1, 0))


def _quarter() -> FloatArray:
    """Rad in each step of a turn to the right."""
    steps = np.arange(_TURN_STEPS) + 0.5
    shape = np.minimum(np.minimum(steps, steps[::-1]) / (_TURN_STEPS / 3), 1.0)
    turn: FloatArray = 0.5 * np.pi * shape / shape.sum()
    return turn


_TURN = _quarter()
_REACH = float((_STRIDE * np.cos(np.cumsum(_TURN) - 0.5 * _TURN)).sum())
"""How far a turn begins before the point at which the old and the new path cross, and ends behind it, m."""
