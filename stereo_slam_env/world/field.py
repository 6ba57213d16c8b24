"""An open field: a lane through plain meadows, and everything there is to see far away."""

from __future__ import annotations

from functools import partial

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.world import country_props as country
from stereo_slam_env.world.layout import Layout, Make
from stereo_slam_env.world.road import ASPHALT_HEIGHT, RoadNetwork, Strip, paved, road_along
from stereo_slam_env.world.routes import Route
from stereo_slam_env.world.scene import Material, Scene
from stereo_slam_env.world.surface_points import facing_points

WALKWAY = 4.2
"""Where pedestrians walk: at the edge of the lane, m from the centreline."""
NEAREST, FARTHEST = 65.0, 250.0
"""How far things stand from the nearest centreline, m."""
_AREA = 900.0
"""m^2 for each try to put something."""
_PER_THING = 60
"""Landmarks."""
_ROOM = 3.0
_HILLS = 0.04
"""Share of the tries."""
LANE = Strip(3.7, ASPHALT_HEIGHT, Material((1.0, 1.0, 1.0), "track", (37.3, 37.3)))
MEADOW = Material((1.0, 1.0, 1.0), "meadow", (61.3, 61.3))


def build_field(route: Route, rng: np.random.Generator) -> Scene:
    """Lay out tree lines, hedges, farms, pylons, water towers and wooded hills far from `route`.

    Parameters
    ----------
    route : Route
        Path of the camera. Nothing solid stands within 60 m of it.
    rng : numpy.random.Generator
        Source of the layout.

    Returns
    -------
    Scene
        In S, with its landmarks, all on things far away.
    """
    road = road_along(route)
    network = RoadNetwork([road])
    layout = Layout(network)
    low, high = road.points.min(axis=0) - FARTHEST, road.points.max(axis=0) + FARTHEST
    places = rng.uniform(low, high, (int(np.prod(high - low) / _AREA), 2))
    away = network.distance(places)
    places = places[(away > NEAREST) & (away < FARTHEST)]
    # Hills first, while there is room.
    hills = places[: int(_HILLS * len(places))]
    built = sum(layout.claim(xy, 0.0, (country.HILL_FOOT,) * 2, _ROOM, NEAREST, country.hill) for xy in hills)
    built += sum(_put_something(layout, xy, rng) for xy in places[len(hills) :])
    solids = [p for p in layout.primitives if p.solid]
    points = facing_points(solids, _PER_THING * built, 25.0, network.nearest, rng)
    return Scene(
        network.ground(FARTHEST + 320.0, MEADOW),
        tuple(layout.primitives),
        paved([road], [LANE]),
        np.arange(len(points), dtype=np.int64),
        points,
    )


def _put_something(layout: Layout, xy: FloatArray, rng: np.random.Generator) -> bool:
    length, yaw = float(rng.uniform(25.0, 55.0)), float(rng.uniform(0.0, np.pi))
    kinds: tuple[tuple[Make, tuple[float, float], float], ...] = (  # what, its footprint, its share
        (partial(country.tree_line, length=length, rng=rng), (length, 5.0), 0.38),
        (partial(country.hedge, length=length, rng=rng), (length, 3.6), 0.24),
        (partial(country.farm, rng=rng), (36.0, 16.0), 0.22),
        (country.pylon, (6.0, 14.0), 0.12),
        (country.water_tower, (10.0, 10.0), 0.04),
    )
    make, size, _ = kinds[rng.choice(len(kinds), p=[share for _, _, share in kinds])]
    return layout.claim(xy, yaw, size, _ROOM, NEAREST, make)
