"""Compiled plan of a street: what stands where beside the roads, and the primitives that it is made of.

Numba compiles it when it is first used and keeps the result on disk. Import it where a scene is built.
"""

from __future__ import annotations

import math

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.world.compiled import RADIUS, claim
from stereo_slam_env.world.props import BAY, BIN, CAR, GROUND_FLOOR, HOUSE, LAMP_POST, SIGN, TOWER, TREE
from stereo_slam_env.world.road import SPACING
from stereo_slam_env.world.scene import BALL, BOX, CYLINDER, TABLE_COLUMNS

NUMBERS = 15
"""Columns of a thing: kind, place (x, y), yaw, and what has been drawn of it, see `_draw`."""
_SETBACKS, _GAPS = np.array([0.4, 0.4, 1.2, 3.5]), np.array([0.05, 0.05, 0.6, 4.0, 7.0])
_AT_KERB = np.array([LAMP_POST, TREE, SIGN, BIN])
_SHARES = np.cumsum([0.34, 0.32, 0.14, 0.20]) / np.cumsum([0.34, 0.32, 0.14, 0.20])[-1]
"""Of the things at the kerb, summed up."""
_CROWN_LOW = np.array([(-0.45, -0.45, 1.0), (-0.45, -0.45, 1.05), (-0.45, -0.45, 0.75)])
_CROWN_HIGH = np.array([(0.45, 0.45, 1.35), (0.45, 0.45, 1.4), (0.45, 0.45, 1.1)])
"""Limits of each ball of a crown: its middle off the trunk in x and y, its radius, m."""
_PARTS = np.array([6, 2, 22, 4, 4, 3, 2])
"""Primitives of each kind of thing."""
_LIFTS = (0.5, 1.2, 1.9)


@entry
def plan(
    points: FloatArray,
    circles: FloatArray,
    places: FloatArray,
    firsts: IntArray,
    half_width: float,
    kerb: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Houses, then towers, then what stands in the parking strips and on the pavements; (N, `NUMBERS`).

    `points` and `circles` of the roads are those of `RoadNetwork`; `places` has x, y, the unit vector to the left
    and the yaw of each point, those of road r from row `firsts[r]` on.
    """
    most = 64 + 2 * len(places)
    things, taken, count = np.empty((most, NUMBERS)), np.empty((most + 1, RADIUS + 1)), 0
    for what in range(3):
        for r in range(len(firsts) - 1):
            road = places[firsts[r] : firsts[r + 1]]
            length = (len(road) - 1) * SPACING
            for side in (1.0, -1.0):
                if what == 0:
                    station = rng.uniform(0.0, 4.0)
                    while station < length:
                        wide = 3.2 * float(rng.integers(3, 7))
                        deep = rng.uniform(8.0, 12.0)
                        front = side * (kerb + _SETBACKS[rng.integers(0, 4)])
                        thing = things[count]
                        thing[0], thing[4], thing[5], thing[6] = HOUSE, wide, deep, rng.integers(1, 4)
                        _put(thing, road, station + 0.5 * wide, front + math.copysign(0.5 * deep, front), 0.0)
                        free = _built(points, circles, taken, count, thing, (wide, deep), 0.3, kerb - 0.1, rng)
                        count += free
                        gap = _GAPS[rng.integers(0, 5)]
                        station += wide + gap if free else 2.0
                elif what == 1:
                    station = rng.uniform(0.0, 20.0)
                    while station < length:
                        wide, deep = rng.uniform(12.0, 20.0), rng.uniform(12.0, 20.0)
                        front = side * rng.uniform(26.0, 48.0)
                        thing = things[count]
                        thing[0], thing[4], thing[5], thing[6] = TOWER, wide, deep, rng.integers(3, 8)
                        _put(thing, road, station + 0.5 * wide, front + math.copysign(0.5 * deep, front), 0.0)
                        free = _built(points, circles, taken, count, thing, (wide, deep), 2.0, kerb - 0.1, rng)
                        count += free
                        station += wide + rng.uniform(2.0, 12.0) if free else 6.0
                else:
                    with_traffic, inwards = 0.0 if side < 0 else math.pi, -side * math.pi / 2
                    station = rng.uniform(2.0, 8.0)
                    while station < length:
                        if rng.random() < 0.6:
                            thing = things[count]
                            thing[0] = CAR
                            _put(thing, road, station, side * (half_width - 1.05), with_traffic)
                            clear = half_width - 2.1
                            count += _built(points, circles, taken, count, thing, (4.9, 1.9), 0.1, clear, rng)
                        station += rng.uniform(6.0, 9.0)
                    station = rng.uniform(3.0, 9.0)
                    while station < length:
                        thing = things[count]
                        thing[0] = _AT_KERB[np.searchsorted(_SHARES, rng.random(), side="right")]
                        turn = 0.0
                        if thing[0] == LAMP_POST:
                            turn = inwards
                        elif thing[0] == SIGN:
                            turn = with_traffic + math.pi
                        _put(thing, road, station, side * (half_width + 0.7), turn)
                        clear = half_width + 0.2
                        count += _built(points, circles, taken, count, thing, (0.6, 0.6), 0.1, clear, rng)
                        station += rng.uniform(5.0, 8.0)
    return things[:count].copy()


@kernel
def _put(thing: FloatArray, road: FloatArray, station: float, left: float, turn: float) -> None:
    """Put a thing `station` m along a road and `left` m to its left."""
    at = road[min(max(round(station / SPACING), 0), len(road) - 1)]
    thing[1], thing[2], thing[3] = at[0] + left * at[2], at[1] + left * at[3], at[4] + turn


@kernel
def _built(
    points: FloatArray,
    circles: FloatArray,
    taken: FloatArray,
    count: int,
    thing: FloatArray,
    size: tuple[float, float],
    room: float,
    clearance: float,
    rng: np.random.Generator,
) -> bool:
    """Whether there is room for a thing; then the rest of it is drawn."""
    if not claim(points, circles, taken, count, (thing[1], thing[2], thing[3]), size, room, clearance):
        return False
    if thing[0] == HOUSE:
        thing[7], thing[8], thing[9] = rng.integers(0, 10), rng.integers(0, 3), rng.integers(0, 2)
    elif thing[0] == TOWER:
        thing[7] = rng.integers(0, 10)
    elif thing[0] == CAR:
        thing[4], thing[5], thing[6] = rng.integers(0, 6), rng.uniform(0.95, 1.12), rng.uniform(0.95, 1.15)
    elif thing[0] == TREE:
        thing[4], thing[5] = rng.uniform(2.2, 3.0), rng.integers(0, 2)
        for k in range(3):
            for j in range(3):
                low = _CROWN_LOW[k, j]
                thing[6 + 3 * k + j] = low + (_CROWN_HIGH[k, j] - low) * rng.random()
    return True


@entry
def parts(things: FloatArray) -> FloatArray:
    """The primitives of things: rows of `scene.table_of`, and whether they are solid; (P, 9)."""
    rows = np.zeros((_PARTS.max() * len(things), TABLE_COLUMNS + 1))
    n = 0
    for thing in things:
        kind, at = thing[0], (thing[1], thing[2], math.cos(thing[3]), math.sin(thing[3]), thing[3])
        if kind == HOUSE:
            long, deep, floors = thing[4], thing[5], thing[6]
            top = GROUND_FLOOR + floors * BAY
            n = _box(rows, n, at, (0.0, 0.0, 0.0), (long, deep, GROUND_FLOOR), True)
            n = _box(rows, n, at, (0.0, 0.0, GROUND_FLOOR), (long, deep, floors * BAY), True)
            n = _box(rows, n, at, (0.0, 0.0, GROUND_FLOOR - 0.1), (long + 0.02, deep + 0.3, 0.25), True)
            n = _box(rows, n, at, (0.0, 0.0, top), (long + 0.1, deep + 0.6, 0.45), True)
            for side in (-0.3, 0.25):
                n = _box(rows, n, at, (side * long, 0.0, top + 0.45), (0.8, 0.8, 1.2), False)
        elif kind == TOWER:
            long, deep, high = thing[4], thing[5], thing[6] * BAY
            n = _box(rows, n, at, (0.0, 0.0, 0.0), (long, deep, high), True)
            n = _box(rows, n, at, (0.0, 0.0, high), (long + 0.4, deep + 0.4, 0.5), True)
        elif kind == CAR:
            long, tall = thing[5], thing[6]
            n = _box(rows, n, at, (0.0, 0.0, 0.03), (4.3 * long, 1.7, 0.02), False)
            n = _box(rows, n, at, (0.0, 0.0, 0.25), (4.2 * long, 1.76, 0.62), True)
            n = _box(rows, n, at, (-0.2, 0.0, 0.87), (2.35 * long, 1.56, 0.44 * tall), True)
            n = _box(rows, n, at, (-0.2, 0.0, 0.87 + 0.44 * tall), (2.15 * long, 1.52, 0.08), True)
            for x in (-1.32, -0.2, 0.88):
                for y in (-0.76, 0.76):
                    n = _box(rows, n, at, (x * long, y, 0.87), (0.1, 0.06, 0.46 * tall), False)
            for half_track, half_wide, radius in ((0.82, 0.1, 0.33), (0.92, 0.02, 0.19)):  # wheels and hubs
                for x in (-1.3, 1.35):
                    for y in (-half_track, half_track):
                        ends = (x * long, y - half_wide, 0.33), (x * long, y + half_wide, 0.33)
                        n = _rod(rows, n, at, ends[0], ends[1], radius, False)
            for x in (2.1, -2.1):
                for y in (-0.6, 0.6):
                    n = _box(rows, n, at, (x * long, y, 0.62), (0.08, 0.36, 0.15), False)
        elif kind == LAMP_POST:
            n = _rod(rows, n, at, (0.0, 0.0, 0.0), (0.0, 0.0, 0.9), 0.13, True)
            n = _rod(rows, n, at, (0.0, 0.0, 0.9), (0.0, 0.0, 6.2), 0.08, True)
            n = _rod(rows, n, at, (0.0, 0.0, 6.15), (1.5, 0.0, 6.4), 0.05, False)
            n = _box(rows, n, at, (1.7, 0.0, 6.32), (0.8, 0.26, 0.14), False)
        elif kind == TREE:
            n = _rod(rows, n, at, (0.0, 0.0, 0.0), (0.0, 0.0, thing[4]), 0.16, True)
            for k in range(3):
                x, y, radius = thing[6 + 3 * k : 9 + 3 * k]
                rows[n, 0], rows[n, 4], rows[n, 8] = BALL, radius, 1.0
                rows[n, 1], rows[n, 2], rows[n, 3] = _point(at, (x, y, thing[4] + _LIFTS[k]))
                n += 1
        elif kind == SIGN:
            n = _rod(rows, n, at, (0.0, 0.0, 0.0), (0.0, 0.0, 2.9), 0.05, True)
            n = _box(rows, n, at, (0.05, 0.0, 2.1), (0.04, 0.7, 0.7), True)
            n = _box(rows, n, at, (0.075, 0.0, 2.16), (0.02, 0.58, 0.58), False)
        else:
            n = _rod(rows, n, at, (0.0, 0.0, 0.0), (0.0, 0.0, 0.95), 0.28, True)
            n = _rod(rows, n, at, (0.0, 0.0, 0.95), (0.0, 0.0, 1.02), 0.31, True)
    return rows[:n].copy()


def of_kind(things: FloatArray, kind: int) -> BoolArray:
    """Mask (P,) of primitives that belong to things of a kind."""
    return np.asarray(np.repeat(things[:, 0] == kind, _PARTS[things[:, 0].astype(np.int64)]))


@kernel
def _point(at: tuple[float, ...], p: tuple[float, ...]) -> tuple[float, ...]:
    """A point in S from one at a place, as `props.Placed` has it."""
    x, y, cos, sin, _ = at
    return x + cos * p[0] - sin * p[1], y + sin * p[0] + cos * p[1], p[2]


@kernel
def _box(
    rows: FloatArray, n: int, at: tuple[float, ...], p: tuple[float, ...], size: tuple[float, ...], solid: bool
) -> int:
    """Make row n a box whose bottom face has its centre at `p`; n + 1."""
    row = rows[n]
    row[0], row[7], row[8] = BOX, at[4], 1.0 if solid else 0.0
    row[1], row[2], bottom = _point(at, p)
    row[3] = bottom + 0.5 * size[2]
    row[4], row[5], row[6] = size
    return n + 1


@kernel
def _rod(
    rows: FloatArray,
    n: int,
    at: tuple[float, ...],
    start: tuple[float, ...],
    end: tuple[float, ...],
    radius: float,
    solid: bool,
) -> int:
    """Make row n a cylinder; n + 1."""
    row = rows[n]
    row[0], row[7], row[8] = CYLINDER, radius, 1.0 if solid else 0.0
    row[1], row[2], row[3] = _point(at, start)
    row[4], row[5], row[6] = _point(at, end)
    return n + 1
