"""Open country with small groups of things beside the lane and nothing in between: where one looks matters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.world import wayside_props as wayside
from stereo_slam_env.world.field import LANE, MEADOW
from stereo_slam_env.world.layout import Layout
from stereo_slam_env.world.props import Placed
from stereo_slam_env.world.road import LANE_OFFSET, LEAD_IN, Road, RoadNetwork, paved, road_along
from stereo_slam_env.world.routes import Route
from stereo_slam_env.world.scene import Primitive, Scene
from stereo_slam_env.world.surface_points import facing_points

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
_TALL: tuple[_Prop, ...] = (wayside.tree, wayside.tree, wayside.hut, wayside.woodpile, wayside.bales)
_LOW: tuple[_Prop, ...] = (
    wayside.boulder,
    wayside.bush,
    wayside.milestone,
    wayside.signpost,
    wayside.fence,
)


def build_groves(route: Route, rng: np.random.Generator) -> Scene:
    """Lay out groups of trees, huts, woodpiles, boulders, signs, ... along `route`, on either side in turn.

    Parameters
    ----------
    route : Route
        Path of the camera. Nothing stands within 5 m of the centreline of its road.
    rng : numpy.random.Generator
        Source of the layout.

    Returns
    -------
    Scene
        In S, with about 12 landmarks a group, on surfaces that face the road.
    """
    road = road_along(route)
    network = RoadNetwork([road])
    layout = Layout(network)
    points: list[FloatArray] = []

    def group(at: Placed) -> list[Primitive]:
        things = _group(at, rng)
        count = int(rng.integers(PER_GROUP[0], PER_GROUP[1] + 1))
        points.append(facing_points(things, count, HIGHEST, network.nearest, rng))
        return things

    last = float(road.lane_stations[-1]) + _BEYOND
    for piece in road.stretches():
        station, end = float(road.stations[piece.start]), min(float(road.stations[piece.stop - 1]), last)
        side = float(rng.choice([-1.0, 1.0]))
        station += float(rng.uniform(0.0, SPACING))
        while station < end:
            side = _place(layout, road, station, side, group, rng)
            station += SPACING * float(rng.uniform(*_STRETCH))
    landmarks = np.concatenate(points)
    return Scene(
        network.ground(320.0, MEADOW),
        tuple(layout.primitives),
        paved([road], [LANE]),
        np.arange(len(landmarks), dtype=np.int64),
        landmarks,
    )


def _place(
    layout: Layout,
    road: Road,
    station: float,
    side: float,
    group: Callable[[Placed], list[Primitive]],
    rng: np.random.Generator,
) -> float:
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
