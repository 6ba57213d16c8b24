"""Scenes by name: what stands along a route, what moves there, and the light."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from filters.contract.validation import did_you_mean, positive
from stereo_slam_env.world import corridor, field, groves, street
from stereo_slam_env.world.looks import with_other_look
from stereo_slam_env.world.routes import Route, load_registrations, require_new
from stereo_slam_env.world.scene import Scene
from stereo_slam_env.world.traffic import traffic

Builder = Callable[[Route, np.random.Generator], Scene]


@dataclass(frozen=True)
class Surroundings:
    """A kind of scene: one line, its builder, and where pedestrians walk, m to either side of the centreline."""

    description: str
    build: Builder
    walkway: float


_SURROUNDINGS: dict[str, Surroundings] = {
    "street": Surroundings("houses, trees, lamps, signs, parked cars", street.build_street, street.WALKWAY),
    "field": Surroundings("plain meadows, everything to see is 60 to 250 m away", field.build_field, field.WALKWAY),
    "corridor": Surroundings("smooth walls, few doors, lamps and signs", corridor.build_corridor, corridor.WALKWAY),
    "groves": Surroundings("open country, small groups of things 7 to 21 m aside", groves.build_groves, field.WALKWAY),
}
SURROUNDINGS: Mapping[str, Surroundings] = MappingProxyType(_SURROUNDINGS)
"""Registered scenes by name; read-only, see `register_scene`. Each works along any route."""


def register_scene(name: str, builder: Builder, *, description: str | None = None, walkway: float = 5.0) -> None:
    """Give a scene a name that `gym.make(..., surroundings=name)`, scenarios and commands take.

    A name is known in the process that registers it; for commands and worker processes see `register_route`.

    Parameters
    ----------
    name : str
        A new one, of letters, digits, ".", "_" and "-".
    builder : callable
        (route, generator) -> `Scene`, in S: what stands along the route, with landmarks. Everything random comes from
        the generator.
    description : str, optional
        One line for lists; None: the first line of the builder's docstring.
    walkway : float
        Where pedestrians walk, m to either side of the centreline.

    Raises
    ------
    ValueError
        The name is taken or has other characters, `builder` cannot be called, or `walkway` is not positive.
    """
    require_new("scene", name, SURROUNDINGS)
    if not callable(builder):
        raise ValueError(f"builder must be a function (route, generator) -> Scene, got {builder!r}")
    line = (inspect.getdoc(builder) or "").partition("\n")[0] if description is None else description
    _SURROUNDINGS[name] = Surroundings(line, builder, positive("walkway", walkway))


def available_scenes() -> dict[str, str]:
    """Names of the registered scenes and one line on each."""
    load_registrations()
    return {name: kind.description for name, kind in SURROUNDINGS.items()}


def named_surroundings(name: str) -> Surroundings:
    """The registered scene of that name; a `ValueError` lists the names and the nearest one where there is none."""
    if name not in SURROUNDINGS:
        load_registrations()
    if name not in SURROUNDINGS:
        known = ", ".join(map(repr, SURROUNDINGS))
        raise ValueError(f"surroundings must be one of {known}, got {name!r}{did_you_mean(name, SURROUNDINGS)}")
    return SURROUNDINGS[name]


def build_scene(
    surroundings: str,
    route: Route,
    rng: np.random.Generator,
    *,
    moving_cars: int = 0,
    pedestrians: int = 0,
    randomise: bool = False,
) -> Scene:
    """Build the scene of that name along a route, the path of the camera in the right-hand lane of a road.

    Layout, traffic and look have streams of their own: asking for traffic or another look leaves the layout as it is.

    Parameters
    ----------
    surroundings : str
        A registered name.
    route : Route
    rng : numpy.random.Generator
    moving_cars, pedestrians : int
        How many are to move near the nominal drive; fewer where there is no room for more.
    randomise : bool
        Draw textures, colours, sun, sky and haze at random too.

    Raises
    ------
    ValueError
        No such surroundings, or a negative number.
    """
    chosen = named_surroundings(surroundings)
    for name, count in (("moving_cars", moving_cars), ("pedestrians", pedestrians)):
        if count < 0:
            raise ValueError(f"{name} must not be negative, got {count}")
    traffic_rng, look_rng = rng.spawn(2)
    scene = chosen.build(route, rng)
    if moving_cars or pedestrians:
        moving = traffic(route, scene.solids, chosen.walkway, traffic_rng, cars=moving_cars, pedestrians=pedestrians)
        scene = replace(scene, moving=moving)
    return with_other_look(scene, look_rng) if randomise else scene
