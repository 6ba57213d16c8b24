"""Scenes by name: what stands around a route, what moves on it, and in what light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from filters.known_names import did_you_mean
from stereo_slam_env.world import corridor, field, groves, street
from stereo_slam_env.world.looks import with_other_look
from stereo_slam_env.world.road import road_along
from stereo_slam_env.world.routes import Route
from stereo_slam_env.world.scene import Scene
from stereo_slam_env.world.traffic import traffic


@dataclass(frozen=True)
class Surroundings:
    """A kind of scene.

    Attributes
    ----------
    description : str
        One line.
    build : callable
        (route, generator) -> what stands along the route, with landmarks.
    walkway : float
        Where pedestrians walk, m to either side of the centreline.
    """

    description: str
    build: Callable[[Route, np.random.Generator], Scene]
    walkway: float


SURROUNDINGS: dict[str, Surroundings] = {
    "street": Surroundings("houses, trees, lamps, signs, parked cars", street.build_street, street.WALKWAY),
    "field": Surroundings("plain meadows, everything to see is 60 to 250 m away", field.build_field, field.WALKWAY),
    "corridor": Surroundings("smooth walls, few doors, lamps and signs", corridor.build_corridor, corridor.WALKWAY),
    "groves": Surroundings("open country, small groups of things 7 to 21 m aside", groves.build_groves, field.WALKWAY),
}
"""All work along any route and are the same for the same generator."""


def build_scene(
    surroundings: str,
    route: Route,
    rng: np.random.Generator,
    *,
    moving_cars: int = 0,
    pedestrians: int = 0,
    randomise: bool = False,
) -> Scene:
    """Build a scene along a route.

    Layout, traffic and look have streams of their own: asking for traffic or another look leaves the layout as it is.

    Parameters
    ----------
    surroundings : str
        Name in `SURROUNDINGS`.
    route : Route
        Path of the camera, in the right-hand lane of a road.
    rng : numpy.random.Generator
        Source of the layout; its children are those of the rest.
    moving_cars, pedestrians : int
        How many are to move near the nominal drive; fewer where there is no room for more.
    randomise : bool
        Draw textures, colours, sun, sky and haze at random too.

    Raises
    ------
    ValueError
        No such surroundings, or a negative number.
    """
    if surroundings not in SURROUNDINGS:
        hint = did_you_mean(surroundings, SURROUNDINGS)
        raise ValueError(
            f"surroundings must be one of {', '.join(map(repr, SURROUNDINGS))}, got {surroundings!r}{hint}"
        )
    for name, count in (("moving_cars", moving_cars), ("pedestrians", pedestrians)):
        if count < 0:
            raise ValueError(f"{name} must not be negative, got {count}")
    traffic_rng, look_rng = rng.spawn(2)
    chosen = SURROUNDINGS[surroundings]
    scene = chosen.build(route, rng)
    if moving_cars or pedestrians:
        moving = traffic(
            route,
            road_along(route),
            scene.solids,
            chosen.walkway,
            traffic_rng,
            cars=moving_cars,
            pedestrians=pedestrians,
        )
        scene = replace(scene, moving=moving)
    return with_other_look(scene, look_rng) if randomise else scene
