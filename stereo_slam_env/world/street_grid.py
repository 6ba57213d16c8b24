"""A grid of streets: junctions, the roads between them, and the steps of a drive from road to road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from filters.geometry.arrays import BoolArray, FloatArray, IntArray

LEFT, STRAIGHT, RIGHT, BACK = 0, 1, 2, 3
"""Ways on from a junction; back, by a turn round, only where there is no other."""
_PREFERENCE = (STRAIGHT, RIGHT, LEFT)
"""Where the chosen road does not exist, the first of these that does is taken."""
_STRIDE = 0.5
"""Of a step, m, about: a street is driven in a whole number of them."""
_LANE = 1.75
"""Of the path that is driven, right of the middle of the street, m."""
_JUNCTIONS = (3, 6)
"""Fewest and most in a row, and in a column."""
_BLOCK = (38.0, 54.0)
"""Shortest and longest side of a block, m."""
_MISSING = 0.3
"""Largest share of the roads that is not built."""


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
    missing: frozenset[int] = frozenset()
    """Numbers of roads of the grid, see `slot`, that are not built; all others are connected."""

    def __deepcopy__(self, memo: dict[int, object]) -> StreetGrid:
        return self  # nobody changes it

    @property
    def slots(self) -> int:
        """Number of roads from each junction to the next, those that are not built included."""
        return 2 * len(self.columns) * len(self.rows) - len(self.columns) - len(self.rows)

    @property
    def count(self) -> int:
        """Number of roads."""
        return self.slots - len(self.missing)

    def slot(self, place: Place) -> int:
        """Number of the road of the grid, built or not, whichever its direction."""
        column, row, heading = place
        if heading % 2 == 0:
            return column * (len(self.rows) - 1) + row - (heading == 0)
        along_z = len(self.columns) * (len(self.rows) - 1)
        return along_z + row * (len(self.columns) - 1) + column - (heading == 1)

    def road(self, place: Place) -> int:
        """Number of the road among those that are built, whichever its direction."""
        return self._numbers[self.slot(place)]

    @cached_property
    def _numbers(self) -> list[int]:
        """Number of the road in each slot."""
        built = np.array([slot not in self.missing for slot in range(self.slots)])
        numbers: list[int] = (np.cumsum(built) - 1).tolist()
        return numbers

    def ways(self, place: Place) -> dict[int, Place]:
        """Choices at the junction ahead and the roads that they lead to; at a dead end the only one is back."""
        ways = {choice: self._beyond(place, choice) for choice in _PREFERENCE}
        on = {choice: beyond for choice, beyond in ways.items() if self._is_built(beyond)}
        return on or {BACK: self._beyond(place, BACK)}

    def taken(self, place: Place, choice: int) -> tuple[int, Place]:
        """The choice that is driven where `choice` is asked for, and where it leads."""
        ways = self.ways(place)
        possible = choice if choice in ways else next(iter(ways))
        return possible, ways[possible]

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
            further = (beyond for each in near for beyond in self.ways(each).values())
            near = [beyond for beyond in dict.fromkeys(further) if beyond not in visited]
            visited.update(near)
            count += 1
        return self.count

    def to_new(self, place: Place, driven: BoolArray) -> int:
        """The choice that leads to a road that has not been driven (R,) in the fewest roads."""
        ways = self.ways(place)
        return min(ways, key=lambda choice: self.roads_to(ways[choice], ~driven))

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
            turn, reach = _TURNS[possible], _REACHES[possible]
            for far, turning in ((self.length(place), turn), (self.length(next_place), turn[:0])):
                straight = 0.5 * far - reach
                count = max(round(straight / _STRIDE), 1)
                metres += [np.full(count, straight / count), np.full(len(turning), _STRIDE)]
                turns += [np.zeros(count), turning]
            place = next_place
        return np.concatenate([*metres, [_STRIDE]]), np.concatenate([*turns, [0.0]])

    def _beyond(self, place: Place, choice: int) -> Place:
        """Place that a choice leads to, on the grid or beyond its edge."""
        heading = (place.heading + choice - STRAIGHT) % 4
        return Place(place.column + (0, 1, 0, -1)[heading], place.row + (1, 0, -1, 0)[heading], heading)

    def _is_built(self, place: Place) -> bool:
        inside = 0 <= place.column < len(self.columns) and 0 <= place.row < len(self.rows)
        return inside and self.slot(place) not in self.missing


def random_streets(rng: np.random.Generator) -> StreetGrid:
    """Draw a grid of 3 to 6 by 3 to 6 junctions, blocks of random sides, without up to 30 % of its roads.

    Some roads end at the last junction. The start is on any road.
    """
    counts = rng.integers(_JUNCTIONS[0], _JUNCTIONS[1] + 1, 2)
    columns, rows = (np.concatenate([[0.0], np.cumsum(rng.uniform(*_BLOCK, count - 1))]) for count in counts)
    column, row = int(rng.integers(len(columns))), int(rng.integers(1, len(rows)))
    middle = 0.5 * (rows[row - 1] + rows[row])
    grid = StreetGrid(columns - columns[column] - _LANE, rows - middle, Place(column, row, 0))
    ends = _junctions(grid)
    built = list(range(grid.slots))
    for slot in rng.permutation(grid.slots)[: round(float(rng.uniform(0.0, _MISSING)) * grid.slots)].tolist():
        fewer = [each for each in built if each != slot]
        if slot != grid.slot(grid.start) and _are_connected(ends[fewer]):
            built = fewer
    return replace(grid, missing=frozenset(range(grid.slots)) - frozenset(built))


def _junctions(streets: StreetGrid) -> IntArray:
    """Numbers of the two junctions of each road of a grid; (slots, 2)."""
    ends = np.zeros((streets.slots, 2), dtype=np.int64)
    for column in range(len(streets.columns)):
        for row in range(len(streets.rows)):
            at = column * len(streets.rows) + row
            for place, behind in ((Place(column, row, 0), at - 1), (Place(column, row, 1), at - len(streets.rows))):
                if (row if place.heading == 0 else column) > 0:
                    ends[streets.slot(place)] = at, behind
    return ends


def _are_connected(ends: IntArray) -> bool:
    """Whether roads between junctions (R, 2) lead from each of them to each other."""
    size = int(ends.max()) + 1
    roads = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(size, size))
    labels = connected_components(roads, directed=False)[1]
    return bool(np.ptp(labels[ends]) == 0)


def _turned(steps: int, angle: float) -> FloatArray:
    """Rad in each step of a smooth turn by `angle`."""
    at = np.arange(steps) + 0.5
    shape = np.minimum(np.minimum(at, at[::-1]) / (steps / 3), 1.0)
    turn: FloatArray = angle * shape / shape.sum()
    return turn


def _offset(turn: FloatArray) -> tuple[float, float]:
    """Offset of the end of a turn from its beginning, forward and to the right, m."""
    yaw = np.cumsum(turn) - 0.5 * turn
    return float((_STRIDE * np.cos(yaw)).sum()), float((_STRIDE * np.sin(yaw)).sum())


def _turn_round(aside: float) -> FloatArray:
    """Rad in each step of a turn round to the left that begins with one to the right by `aside` rad."""
    begin = _turned(20, aside)
    return np.concatenate([begin, _turned(110, -np.pi - 2.0 * aside), begin])


_QUARTER = _turned(40, 0.5 * np.pi)
_ASIDE = float(brentq(lambda aside: _offset(_turn_round(aside))[1] + 2.0 * _LANE, 0.0, 1.5))
"""So that the car comes back in the other lane."""
_TURNS = {LEFT: -_QUARTER, STRAIGHT: _QUARTER[:0], RIGHT: _QUARTER, BACK: _turn_round(_ASIDE)}
_REACHES = {
    LEFT: _offset(_QUARTER)[0] + _LANE * -1.0,
    STRAIGHT: 0.0,
    RIGHT: _offset(_QUARTER)[0] + _LANE,
    BACK: 10.0,
}
"""How far before the junction a turn begins, and behind it ends, m."""
