"""Open country: plain meadows with everything far away, and groves, small groups of things beside the lane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.world.props import STEEL, Layout, Make, Placed, facing_points
from stereo_slam_env.world.road import (
    ASPHALT_HEIGHT,
    LANE_OFFSET,
    LEAD_IN,
    Road,
    Strip,
    network_along,
    paved,
    road_along,
)
from stereo_slam_env.world.routes import Route, once_per_route
from stereo_slam_env.world.scene import Material, Primitive, Ribbon, Scene, Sphere, Vector

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
SPREAD = 3.0
"""How far a group reaches from its middle, along the lane and across, m."""
_STRETCH, _JITTER = (0.7, 1.3), 4.0
"""How the distance from group to group varies; what each group is off its place, m."""
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


@dataclass(frozen=True)
class Groups:
    """Pattern of groups along a road."""

    spacing: float = 15.0
    """Mean distance from group to group along the lane, m."""
    offsets: tuple[float, float] = (10.0, 18.0)
    """Least and largest distance from the path of the camera to the middle of a group, m."""
    other_side: float = 0.7
    """Probability that the next group is on the other side."""
    run: tuple[float, float] | None = None
    """Shortest and longest stretch after which the side changes, m. None: it changes by chance alone."""


def build_groves(route: Route, rng: np.random.Generator) -> Scene:
    """Groups of trees, huts, woodpiles, boulders, signs, ... along `route`, mostly left and right in turn.

    Each has about 12 landmarks, on surfaces that face the road; nothing stands within 5 m of the centreline.
    """
    return _groups_along(route, rng, Groups())


def build_copses(route: Route, rng: np.random.Generator) -> Scene:
    """The same groups, in stretches of 30 to 110 m on one side of `route` and then on the other.

    How densely they stand (12 to 24 m), how far aside (8.5 m to between 11 and 18 m) and which side comes first are
    drawn for each scene: no schedule of looking is right in all of them.
    """
    spacing, farthest = float(rng.uniform(12.0, 24.0)), float(rng.uniform(11.0, 18.0))
    return _groups_along(route, rng, Groups(spacing, (8.5, farthest), other_side=0.0, run=(30.0, 110.0)))


def _groups_along(route: Route, rng: np.random.Generator, pattern: Groups) -> Scene:
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
        station += float(rng.uniform(0.0, pattern.spacing))
        turn = station if pattern.run is None else station + float(rng.uniform(*pattern.run))
        while station < end:
            if pattern.run is not None and station > turn:
                side, turn = -side, station + float(rng.uniform(*pattern.run))
            side = _place(layout, road, station, side, pattern, group, rng)
            station += pattern.spacing * float(rng.uniform(*_STRETCH))
    landmarks = np.concatenate(points)
    return Scene(network.ground(320.0, MEADOW), tuple(layout.primitives), lane_along(route), landmarks)


def _place(
    layout: Layout, road: Road, station: float, side: float, pattern: Groups, group: Make, rng: np.random.Generator
) -> float:
    """Put a group near `station` where there is room, and return its side (1 is left)."""
    for _ in range(_TRIES):
        side = -side if rng.random() < pattern.other_side else side
        xy, yaw = road.place(
            station + float(rng.uniform(-_JITTER, _JITTER)), side * float(rng.uniform(*pattern.offsets)) - LANE_OFFSET
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


_HEDGE = Material((0.62, 0.72, 0.50), "leaves", (3.1, 3.1))
_CROWNS = (
    Material((0.80, 0.92, 0.70), "leaves", (4.1, 4.1)),
    Material((0.66, 0.72, 0.48), "leaves", (4.7, 4.7)),
    Material((0.55, 0.66, 0.52), "leaves", (3.7, 3.7)),
)
_TRUNK = Material((0.7, 0.65, 0.6), "bark", (1.2, 2.0))
_TILES = (Material((0.72, 0.34, 0.26), "roof", (4.0, 4.0)), Material((0.45, 0.42, 0.42), "roof", (4.0, 4.0)))
_WALLS = ((0.94, 0.90, 0.80), (0.86, 0.62, 0.48), (0.90, 0.92, 0.94))
_FIELD_BOARDS = ((0.85, 0.36, 0.28), (0.80, 0.64, 0.46), (0.62, 0.58, 0.52))
_SHEETS = Material((0.86, 0.90, 0.92), "panels", (6.0, 6.0))
_WOODS = Material((0.85, 0.95, 0.85), "woods", (38.0, 38.0))
HILL_RADIUS, HILL_HEIGHT = 95.0, 17.0
HILL_FOOT = 2 * float(np.sqrt(2 * HILL_RADIUS * HILL_HEIGHT - HILL_HEIGHT**2))
"""Width of a hill where it comes out of the ground, m."""


def tree_line(at: Placed, length: float, rng: np.random.Generator) -> list[Primitive]:
    """Trees in a row along local x."""
    crown = _CROWNS[rng.integers(len(_CROWNS))]
    trees: list[Primitive] = []
    for x in np.arange(-0.5 * length + 2.5, 0.5 * length - 2.0, 5.0).tolist():
        height, radius = float(rng.uniform(2.5, 4.0)), float(rng.uniform(1.8, 2.6))
        y = float(rng.uniform(-0.6, 0.6))
        trees += [
            at.rod((x, y, 0.0), (x, y, height), 0.25, _TRUNK),
            Sphere(at.point(x, y, height + 0.6 * radius), radius, crown),
            Sphere(at.point(x, y, height + 1.7 * radius), 0.75 * radius, crown),
        ]
    return trees


def hedge(at: Placed, length: float, rng: np.random.Generator) -> list[Primitive]:
    """A hedge along local x with a few bushes that stand out."""
    height = float(rng.uniform(1.6, 2.8))
    bushes: list[Primitive] = [
        Sphere(at.point(float(rng.uniform(-0.45, 0.45)) * length, 0.0, height), float(rng.uniform(1.0, 1.8)), _HEDGE)
        for _ in range(int(length / 12))
    ]
    return [at.box((0, 0, 0), (length, 1.6, height), _HEDGE), *bushes]


def farm(at: Placed, rng: np.random.Generator) -> list[Primitive]:
    """A house, a barn and sometimes a silo on a yard of 36 x 16 m."""
    wall = Material(_WALLS[rng.integers(len(_WALLS))], "plaster", (12.8, 12.8))
    board = Material(_FIELD_BOARDS[rng.integers(len(_FIELD_BOARDS))], "planks", (14.0, 6.5))
    house_roof, barn_roof = (_TILES[i] for i in rng.permutation(2))
    built = [
        at.box((-10, 0, 0), (12.8, 9.0, 6.4), wall),
        *_roof(at, -10.0, 6.4, (12.8, 9.0), house_roof),
        at.box((7, 1, 0), (14.0, 11.0, 6.5), board),
        *_roof(at, 7.0, 6.5, (14.0, 11.0), barn_roof, y=1.0),
    ]
    if rng.random() < 0.6:
        built.append(at.rod((15.8, 0, 0), (15.8, 0, 11.0), 2.0, _SHEETS))
        built.append(Sphere(at.point(15.8, 0, 11.0), 2.0, _SHEETS))
    return built


def _roof(
    at: Placed, x: float, z: float, size: tuple[float, float], material: Material, y: float = 0.0
) -> list[Primitive]:
    """A pitched roof in steps."""
    return [
        at.box((x, y, z + 0.8 * i), (size[0] + 0.6, (size[1] + 1.2) * (1 - 0.24 * i), 0.8), material) for i in range(4)
    ]


def pylon(at: Placed) -> list[Primitive]:
    """A mast of a power line, 26 m tall; its arms along local y."""
    legs: list[Primitive] = [
        at.rod((2.4 * x, 2.4 * y, 0), (0.5 * x, 0.5 * y, 20), 0.16, STEEL) for x in (-1, 1) for y in (-1, 1)
    ]
    braces: list[Primitive] = [
        at.rod((x * 2.0, -2.0, z), (x * 1.6, 1.6, z + 4), 0.10, STEEL, solid=False) for x in (-1, 1) for z in (4, 10)
    ]
    arms: list[Primitive] = [
        at.box((0, 0, z), (0.5, width, 0.5), STEEL) for z, width in ((16.0, 11.0), (19.5, 14.0), (23.0, 9.0))
    ]
    isolators: list[Primitive] = [
        at.rod((0, y, 18.0), (0, y, 19.5), 0.18, _SHEETS, solid=False) for y in (-6.4, -3.4, 3.4, 6.4)
    ]
    return [*legs, *braces, at.rod((0, 0, 16), (0, 0, 26), 0.45, STEEL), *arms, *isolators]


def water_tower(at: Placed) -> list[Primitive]:
    """A tank on a column, 26 m tall."""
    return [
        at.rod((0, 0, 0), (0, 0, 17), 1.8, Material((0.86, 0.80, 0.72), "brick", (4.0, 4.0))),
        at.rod((0, 0, 17), (0, 0, 24), 5.0, _SHEETS),
        at.rod((0, 0, 24), (0, 0, 25), 3.2, _TILES[0]),
        at.rod((0, 0, 25), (0, 0, 26.5), 0.3, STEEL),
    ]


def hill(at: Placed) -> list[Primitive]:
    """A wooded hill."""
    return [Sphere(at.point(0.0, 0.0, HILL_HEIGHT - HILL_RADIUS), HILL_RADIUS, _WOODS)]


WALKWAY = 4.2
"""Where pedestrians walk: at the edge of the lane, m from the centreline."""
NEAREST, FARTHEST = 65.0, 250.0
"""How far things stand from the nearest centreline, m."""
_AREA = 900.0
"""m^2 for each try to put something."""
_PER_THING = 60
"""Landmarks on each thing."""
_FIELD_ROOM = 3.0
_HILLS = 0.04
"""Share of the tries."""
LANE = Strip(3.7, ASPHALT_HEIGHT, Material((1.0, 1.0, 1.0), "track", (37.3, 37.3)))
MEADOW = Material((1.0, 1.0, 1.0), "meadow", (61.3, 61.3))


def build_field(route: Route, rng: np.random.Generator) -> Scene:
    """Tree lines, hedges, farms, pylons, water towers and wooded hills, nothing solid within 60 m of `route`."""
    road, network = road_along(route), network_along(route)
    layout = Layout(network)
    low, high = road.points.min(axis=0) - FARTHEST, road.points.max(axis=0) + FARTHEST
    places = rng.uniform(low, high, (int(np.prod(high - low) / _AREA), 2))
    away = network.distance(places)
    places = places[(away > NEAREST) & (away < FARTHEST)]
    # Hills first, while there is room.
    hills = places[: int(_HILLS * len(places))]
    built = sum(layout.claim(xy, 0.0, (HILL_FOOT,) * 2, _FIELD_ROOM, NEAREST, hill) for xy in hills)
    built += sum(_put_something(layout, xy, rng) for xy in places[len(hills) :])
    solids = [p for p in layout.primitives if p.solid]
    points = facing_points(solids, _PER_THING * built, 25.0, network, rng)
    return Scene(network.ground(FARTHEST + 320.0, MEADOW), tuple(layout.primitives), lane_along(route), points)


@once_per_route
def lane_along(route: Route) -> tuple[Ribbon, ...]:
    """The paving of the lane."""
    return paved([road_along(route)], [LANE])


def _put_something(layout: Layout, xy: FloatArray, rng: np.random.Generator) -> bool:
    length, yaw = float(rng.uniform(25.0, 55.0)), float(rng.uniform(0.0, np.pi))
    kinds: tuple[tuple[Make, tuple[float, float], float], ...] = (  # what, its footprint, its share
        (partial(tree_line, length=length, rng=rng), (length, 5.0), 0.38),
        (partial(hedge, length=length, rng=rng), (length, 3.6), 0.24),
        (partial(farm, rng=rng), (36.0, 16.0), 0.22),
        (pylon, (6.0, 14.0), 0.12),
        (water_tower, (10.0, 10.0), 0.04),
    )
    make, size, _ = kinds[rng.choice(len(kinds), p=[share for _, _, share in kinds])]
    return layout.claim(xy, yaw, size, _FIELD_ROOM, NEAREST, make)
