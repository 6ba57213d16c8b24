"""Groves: open country with small groups of things beside the lane and nothing in between."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.world.field import MEADOW, lane_along
from stereo_slam_env.world.layout import Layout, Make, facing_points
from stereo_slam_env.world.props import STEEL, Placed
from stereo_slam_env.world.road import LANE_OFFSET, LEAD_IN, Road, network_along, road_along
from stereo_slam_env.world.routes import Route
from stereo_slam_env.world.scene import Material, Primitive, Scene, Sphere, Vector

_BARK = Material((0.80, 0.74, 0.68), "bark", (1.2, 2.0))
_BUSHES = (
    Material((0.72, 0.84, 0.56), "leaves", (1.6, 1.6)),
    Material((0.84, 0.80, 0.52), "leaves", (1.9, 1.9)),
    Material((0.60, 0.74, 0.60), "leaves", (1.4, 1.4)),
)
_ROCKS: tuple[Vector, ...] = ((0.98, 0.96, 0.92), (0.78, 0.78, 0.82), (0.90, 0.80, 0.70))
_BOARDS: tuple[Vector, ...] = ((0.78, 0.34, 0.26), (0.78, 0.62, 0.46), (0.52, 0.58, 0.60))
_ROOF = Material((0.50, 0.40, 0.38), "roof", (1.6, 1.6))
_LOGS = Material((1.0, 1.0, 1.0), "logs", (1.3, 1.3))
_STRAW = Material((1.0, 1.0, 1.0), "straw", (1.3, 1.3))
_STONE = Material((0.95, 0.95, 0.93), "rock", (0.9, 0.9))
_RAIL = Material((0.92, 0.88, 0.82), "bark", (0.8, 1.4))
_CAP = Material((0.80, 0.22, 0.16))


def tree(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """A low fruit tree; its crown is a ball with two smaller ones."""
    height, radius = float(rng.uniform(1.5, 2.0)), float(rng.uniform(1.0, 1.3))
    crown = _BUSHES[rng.integers(len(_BUSHES))]
    lean = float(rng.uniform(-0.3, 0.3))
    return [
        at.rod((0, 0, 0), (lean, 0, height), 0.18, _BARK),
        Sphere(at.point(lean, 0, height + 0.7 * radius), radius, crown),
        Sphere(at.point(lean - 0.8 * radius, 0, height + 0.4 * radius), 0.6 * radius, crown),
        Sphere(at.point(lean + 0.7 * radius, 0.1, height + 1.1 * radius), 0.65 * radius, crown),
    ]


def hut(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """A shed of boards with a roof in two steps."""
    wall = Material(_BOARDS[rng.integers(len(_BOARDS))], "planks", (2.8, 2.3))
    return [
        at.box((0, 0, 0), (2.8, 1.8, 2.3), wall),
        at.box((0, 0, 2.3), (3.1, 2.2, 0.3), _ROOF),
        at.box((0, 0, 2.6), (3.1, 1.1, 0.3), _ROOF),
    ]


def woodpile(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """Logs stacked between posts, under a sheet."""
    height = float(rng.uniform(1.2, 1.7))
    posts: list[Primitive] = [at.rod((x, 0, 0), (x, 0, height + 0.3), 0.07, _RAIL) for x in (-1.3, 1.3)]
    return [at.box((0, 0, 0), (2.5, 1.0, height), _LOGS), at.box((0, 0, height), (2.6, 1.1, 0.06), STEEL), *posts]


def bales(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """Round bales: two, and often a third on top."""
    lying: list[Primitive] = [at.rod((x, -0.55, 0.65), (x, 0.55, 0.65), 0.65, _STRAW) for x in (-0.67, 0.67)]
    return [*lying, at.rod((0, -0.55, 1.76), (0, 0.55, 1.76), 0.65, _STRAW)] if rng.random() < 0.6 else lying


def boulder(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """A rock with a smaller one beside it."""
    rock = Material(_ROCKS[rng.integers(len(_ROCKS))], "rock", (2.2, 2.2))
    radius, side = float(rng.uniform(0.55, 0.85)), float(rng.choice([-1.0, 1.0]))
    return [
        Sphere(at.point(0, 0, 0.45 * radius), radius, rock),
        Sphere(at.point(0.9 * side * radius, -0.3, 0.2 * radius), 0.55 * radius, rock),
    ]


def bush(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """Two balls of leaves."""
    leaves = _BUSHES[rng.integers(len(_BUSHES))]
    radius = float(rng.uniform(0.5, 0.75))
    return [
        Sphere(at.point(-0.4 * radius, 0, 0.6 * radius), radius, leaves),
        Sphere(at.point(0.6 * radius, 0, 0.9 * radius), 0.8 * radius, leaves),
    ]


def milestone(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """A stone with a red cap."""
    height = float(rng.uniform(0.8, 1.2))
    return [at.box((0, 0, 0), (0.55, 0.4, height), _STONE), at.box((0, 0, height), (0.6, 0.45, 0.12), _CAP)]


def signpost(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """A sign on two posts, facing the lane."""
    picture = Material((1.0, 1.0, 1.0), "notice", (1.3, 0.65), int(rng.integers(4)))
    posts: list[Primitive] = [at.rod((x, 0, 0), (x, 0, 1.9), 0.05, STEEL) for x in (-0.45, 0.45)]
    return [*posts, at.box((0, -0.08, 1.2), (1.3, 0.06, 0.65), picture)]


def fence(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """Two rails between three posts."""
    height = float(rng.uniform(0.9, 1.2))
    posts: list[Primitive] = [at.rod((x, 0, 0), (x, 0, height), 0.09, _RAIL) for x in (-1.0, 0.0, 1.0)]
    rails: list[Primitive] = [
        at.rod((-1.1, -0.1, share * height), (1.1, -0.1, share * height), 0.06, _RAIL) for share in (0.45, 0.85)
    ]
    return [*posts, *rails]


CLEARANCE = 5.0
"""Nothing stands nearer to a centreline, m."""
OFFSETS = (10.0, 18.0)
"""From the path of the camera to the middle of a group, m."""
SPREAD = 3.0
"""How far a group reaches from its middle, along the lane and across, m."""
SPACING, _STRETCH, _JITTER = 15.0, (0.7, 1.3), 4.0
"""Mean distance from group to group along the lane and how it varies, m; what each group is off its place, m."""
_OTHER_SIDE = 0.7
"""How likely the next group is on the other side."""
PER_GROUP = (10, 14)
"""Landmarks, fewest and most."""
HIGHEST = 4.0
"""Of a landmark, m."""
_BEYOND = LEAD_IN - 1.0
"""How far groups go on before the start and after the end, m."""
_ROOM, _TRIES = 0.3, 6
_Prop = Callable[[Placed, np.random.Generator], list[Primitive]]
_TALL: tuple[_Prop, ...] = (tree, tree, hut, woodpile, bales)
_LOW: tuple[_Prop, ...] = (boulder, bush, milestone, signpost, fence)


def build_groves(route: Route, rng: np.random.Generator) -> Scene:
    """Groups of trees, huts, woodpiles, boulders, signs, ... along `route`, mostly left and right in turn.

    Each has about 12 landmarks, on surfaces that face the road; nothing stands within 5 m of the centreline.
    """
    road, network = road_along(route), network_along(route)
    layout = Layout(network)
    points: list[FloatArray] = []

    def group(at: Placed) -> list[Primitive]:
        things = _group(at, rng)
        count = int(rng.integers(PER_GROUP[0], PER_GROUP[1] + 1))
        points.append(facing_points(things, count, HIGHEST, network, rng))
        return things

    last = float(road.lane_stations[-1]) + _BEYOND
    for piece in road.fresh_stretches:
        station, end = float(road.stations[piece.start]), min(float(road.stations[piece.stop - 1]), last)
        side = float(rng.choice([-1.0, 1.0]))
        station += float(rng.uniform(0.0, SPACING))
        while station < end:
            side = _place(layout, road, station, side, group, rng)
            station += SPACING * float(rng.uniform(*_STRETCH))
    landmarks = np.concatenate(points)
    return Scene(network.ground(320.0, MEADOW), tuple(layout.primitives), lane_along(route), landmarks)


def _place(layout: Layout, road: Road, station: float, side: float, group: Make, rng: np.random.Generator) -> float:
    """Put a group near `station` where there is room, most likely not on `side`; return its side (1 is left)."""
    for _ in range(_TRIES):
        side = -side if rng.random() < _OTHER_SIDE else side
        xy, yaw = road.place(
            station + float(rng.uniform(-_JITTER, _JITTER)), side * float(rng.uniform(*OFFSETS)) - LANE_OFFSET
        )
        size = (2 * SPREAD, 2 * SPREAD)
        if layout.claim(xy, yaw if side > 0 else yaw + np.pi, size, _ROOM, CLEARANCE, group):
            break
    return side


def _group(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """Two tall things behind three low ones; the lane is at local -y."""
    places = [(x, float(rng.uniform(0.5, 2.0)), _TALL) for x in (-1.5, 1.5)]
    places += [(x, float(rng.uniform(-2.3, -0.9)), _LOW) for x in (-2.0, 0.0, 2.0)]
    things: list[Primitive] = []
    for x, y, kinds in places:
        spot = at.point(x + float(rng.uniform(-0.3, 0.3)), y, 0.0)
        make = kinds[rng.integers(len(kinds))]
        things += make(Placed(np.array(spot[:2]), at.yaw), rng)
    return things
