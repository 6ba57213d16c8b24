"""Corridor: long smooth walls with a ceiling, few doors, lamps and signs; little to track."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.world.props import LAMP, STEEL, Placed, facing_points
from stereo_slam_env.world.road import ASPHALT_HEIGHT, Road, RoadNetwork, Strip, network_along, paved, road_along
from stereo_slam_env.world.routes import Route, once_per_route
from stereo_slam_env.world.scene import Box, Look, Material, Primitive, Ribbon, Scene

WALKWAY = 3.5
"""Where pedestrians walk: along the walls, m from the centreline."""
HALF_WIDTH, _HEIGHT = 4.2, 3.3
CLEARANCE = 3.2
"""A wall that is nearer than this to any centreline would stand on a road: it is left out, m."""
_THICKNESS = 0.3
_CHORD, _LONGEST, _SHORTEST = 0.03, 12.0, 1.0
"""How far a piece of wall may be off the bend that it follows, and how long it is, m."""
_TIGHT = 0.25
"""Where the road bends more (1/m), nothing is mounted on the walls."""
_GAPS, _DOOR_SHARE = (5.0, 14.0), 0.7
"""Between two things on a wall, m; the rest are signs."""
_END = 20.0
"""What is further along the road than this from its end is not the end, m."""
_PER_DETAIL = 6
"""Landmarks on each detail of a wall."""
_WALL = Material((0.93, 0.92, 0.88), "concrete", (23.0, 23.0))
_FLOOR = Material((0.66, 0.66, 0.68), "concrete", (31.0, 31.0))
_CEILING = Material((0.80, 0.80, 0.80))
_SKIRTING = Material((0.42, 0.44, 0.48))
_FRAME = Material((0.30, 0.33, 0.38))
_DOORS = ((0.50, 0.60, 0.72), (0.70, 0.50, 0.42), (0.62, 0.66, 0.60))
_DIM = Look(haze_range=3000.0)
_Free = Callable[[FloatArray], BoolArray]
"""Which points (N, 2) are on no road."""


def build_corridor(route: Route, rng: np.random.Generator) -> Scene:
    """Walls, ceiling, doors, lamps and signs along `route`; its few landmarks are on doors, frames, lamps and signs."""
    road, network = road_along(route), network_along(route)
    details: list[Primitive] = []
    for piece in road.fresh_stretches:
        for side in (1.0, -1.0):
            for at in _mounts(road, piece, side, network, rng):
                details += _door(at, rng) if rng.random() < _DOOR_SHARE else _notice(at, rng)
        for station in np.arange(road.stations[piece.start] + 6.0, road.stations[piece.stop - 1], 14.0).tolist():
            details += _lamp(Placed(*road.place(station, 0.0)))
    points = facing_points(details, _PER_DETAIL * len(details), 3.3, network, rng)
    return Scene(
        network.ground(60.0, _FLOOR),
        (*_shell(route), *details),
        _floor(route),
        points,
        look=_DIM,
    )


@once_per_route
def _shell(route: Route) -> tuple[Primitive, ...]:
    """Walls and ceiling of the corridor."""
    road, network = road_along(route), network_along(route)

    def free(points: FloatArray) -> BoolArray:
        return network.distance(points) >= CLEARANCE

    shell: list[Primitive] = []
    for piece in road.fresh_stretches:
        for side in (1.0, -1.0):
            edge = road.edge(np.array(_joints(road, piece)), side * HALF_WIDTH)
            shell += [slab for start, end in pairwise(edge) for slab in _wall(start, end, side, free)]
        shell += _ceiling(road, piece)
    return (*shell, *_end(road, 0, 1.0), *_end(road, len(road.points) - 1, -1.0))


@once_per_route
def _floor(route: Route) -> tuple[Ribbon, ...]:
    return paved([road_along(route)], [Strip(HALF_WIDTH + 0.1, ASPHALT_HEIGHT, _FLOOR)])


def _joints(road: Road, piece: slice) -> list[int]:
    """Cuts of a piece of road: chords that stay near the bend."""
    joints, spacing = [piece.start], float(road.stations[1])
    while joints[-1] < piece.stop - 1:
        ahead = np.abs(road.bends[joints[-1] : joints[-1] + int(_LONGEST / spacing)]).max()
        length = np.clip(np.sqrt(8 * _CHORD / max(float(ahead), 1e-6)), _SHORTEST, _LONGEST)
        joints.append(min(joints[-1] + int(length / spacing), piece.stop - 1))
    return joints


def _wall(start: FloatArray, end: FloatArray, outwards: float, free: _Free) -> list[Primitive]:
    """Slabs with a skirting from `start` to `end`, to the left (`outwards` 1) or right (-1) of that line."""
    along = end - start
    length = float(np.hypot(*along))
    if length < 0.05:
        return []
    if not free(np.linspace(start, end, 13)).all():
        if length <= 1.5 * _SHORTEST:
            return []
        cuts = np.linspace(start, end, int(np.ceil(length / _SHORTEST)) + 1)
        return [slab for a, b in pairwise(cuts) for slab in _wall(a, b, outwards, free)]
    at = Placed(0.5 * (start + end), float(np.arctan2(along[1], along[0])))
    y = outwards * 0.5 * _THICKNESS
    return [
        at.box((0, y, 0), (length + 0.02, _THICKNESS, _HEIGHT), _WALL),
        at.box((0, y, 0), (length + 0.02, _THICKNESS + 0.04, 0.14), _SKIRTING, solid=False),
    ]


def _ceiling(road: Road, piece: slice) -> list[Primitive]:
    slabs: list[Primitive] = []
    for first, last in pairwise(_joints(road, piece)):
        along = road.points[last] - road.points[first]
        length = float(np.hypot(*along))
        bend = float(np.abs(road.bends[first : last + 1]).max())
        at = Placed(0.5 * (road.points[first] + road.points[last]), float(np.arctan2(along[1], along[0])))
        size = (length * (1.0 + (HALF_WIDTH + _THICKNESS) * bend) + 0.05, 2 * (HALF_WIDTH + _THICKNESS), 0.2)
        slabs.append(at.box((0, 0, _HEIGHT), size, _CEILING, solid=False))
    return slabs


def _end(road: Road, index: int, outwards: float) -> list[Primitive]:
    """A wall across the end of the road, except where another stretch of it passes."""
    other_points = cKDTree(road.points[np.abs(road.stations - road.stations[index]) > _END])

    def free(points: FloatArray) -> BoolArray:
        return np.asarray(other_points.query(points)[0] >= CLEARANCE)

    left, right = (road.place(float(road.stations[index]), sign * (HALF_WIDTH + _THICKNESS))[0] for sign in (1, -1))
    return _wall(right, left, outwards, free)


def _mounts(road: Road, piece: slice, side: float, network: RoadNetwork, rng: np.random.Generator) -> list[Placed]:
    """Places on a wall, at its surface, with local x along it and local y into it."""
    places, station = [], float(road.stations[piece.start] + rng.uniform(2.0, _GAPS[1]))
    while station < road.stations[piece.stop - 1] - 2.0:
        xy, yaw = road.place(station, side * (HALF_WIDTH - 0.04))
        straight = np.abs(np.interp(station, road.stations, road.bends)) < _TIGHT
        if straight and network.distance(xy) >= HALF_WIDTH - 0.2:
            places.append(Placed(xy, yaw if side > 0 else yaw + np.pi))
        station += float(rng.uniform(*_GAPS))
    return places


def _door(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    leaf = Material(_DOORS[rng.integers(len(_DOORS))], "door", (1.0, 2.1), int(rng.integers(4)))
    parts: list[Primitive] = [
        at.box((0, 0, 0.03), (1.0, 0.08, 2.1), leaf, solid=False),
        at.box((0, 0, 2.13), (1.24, 0.16, 0.12), _FRAME, solid=False),
    ]
    return parts + [at.box((x, 0, 0.03), (0.12, 0.16, 2.1), _FRAME, solid=False) for x in (-0.56, 0.56)]


def _notice(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    picture = Material((1.0, 1.0, 1.0), "notice", (1.0, 0.5), int(rng.integers(4)))
    return [at.box((0, 0, float(rng.uniform(1.5, 2.2))), (1.0, 0.08, 0.5), picture, solid=False)]


def _lamp(at: Placed) -> list[Primitive]:
    tube: Box = at.box((0, 0, _HEIGHT - 0.12), (1.3, 0.28, 0.1), LAMP, solid=False)
    return [tube, *(at.box((x, 0, _HEIGHT - 0.14), (0.06, 0.32, 0.14), STEEL, solid=False) for x in (-0.66, 0.66))]
