"""Scenes by name: what stands along a route, what moves there, and the light; the same scene in another look."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from filters.contract.validation import did_you_mean, positive
from stereo_slam_env.world import corridor, open_country, street
from stereo_slam_env.world.routes import Route, load_registrations, require_new
from stereo_slam_env.world.scene import Look, Material, Scene, Vector
from stereo_slam_env.world.street_textures import VARIANTS
from stereo_slam_env.world.traffic import Bus, traffic

Builder = Callable[[Route, np.random.Generator], Scene]


@dataclass(frozen=True)
class Surroundings:
    """A kind of scene: one line, its builder, and where pedestrians walk, m to either side of the centreline."""

    description: str
    build: Builder
    walkway: float


_SURROUNDINGS: dict[str, Surroundings] = {
    "street": Surroundings("houses, trees, lamps, signs, parked cars", street.build_street, street.WALKWAY),
    "field": Surroundings(
        "plain meadows, everything to see is 60 to 250 m away", open_country.build_field, open_country.WALKWAY
    ),
    "corridor": Surroundings("smooth walls, few doors, lamps and signs", corridor.build_corridor, corridor.WALKWAY),
    "groves": Surroundings(
        "open country, small groups of things 7 to 21 m aside", open_country.build_groves, open_country.WALKWAY
    ),
    "copses": Surroundings(
        "the same groups on one side for a while, then on the other", open_country.build_copses, open_country.WALKWAY
    ),
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
        names = ", ".join(map(repr, SURROUNDINGS))
        raise ValueError(f"surroundings must be one of {names}, got {name!r}{did_you_mean(name, SURROUNDINGS)}")
    return SURROUNDINGS[name]


def build_scene(
    surroundings: str,
    route: Route,
    rng: np.random.Generator,
    *,
    moving_cars: int = 0,
    pedestrians: int = 0,
    bus: Bus | None = None,
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
    bus : {"pulls-away", "leads", "stops-and-goes"}, optional
        A bus in the lane ahead.
    randomise : bool
        Draw textures, colours, sun, sky and haze at random too.

    Raises
    ------
    ValueError
        No such surroundings, or a negative number.
    """
    surroundings_chosen = named_surroundings(surroundings)
    for name, count in (("moving_cars", moving_cars), ("pedestrians", pedestrians)):
        if count < 0:
            raise ValueError(f"{name} must not be negative, got {count}")
    traffic_rng, look_rng = rng.spawn(2)
    scene = surroundings_chosen.build(route, rng)
    if moving_cars or pedestrians or bus is not None:
        counts = {"cars": moving_cars, "pedestrians": pedestrians}
        moving = traffic(route, scene.solids, surroundings_chosen.walkway, traffic_rng, **counts, bus=bus)
        scene = replace(scene, moving=moving)
    return with_other_look(scene, look_rng) if randomise else scene


_SKIES: tuple[tuple[Vector, Vector], ...] = (  # horizon, zenith
    ((219.0, 228.0, 236.0), (112.0, 160.0, 212.0)),
    ((206.0, 210.0, 214.0), (168.0, 176.0, 186.0)),
    ((236.0, 214.0, 190.0), (120.0, 140.0, 190.0)),
    ((190.0, 196.0, 204.0), (92.0, 110.0, 140.0)),
)
"""Fair, overcast, evening, before rain."""
_TINT, _SHADE = 0.08, 0.18
"""How much the colours and the brightness of materials vary."""


def with_other_look(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with other textures, colours, light and air; shapes and landmarks stay, equal materials stay equal."""
    look_rng, paint_rng = rng.spawn(2)
    repainted = scene.repainted(lambda material: _repainted(material, paint_rng))
    return replace(repainted, look=_relit(scene.look, look_rng))


def _repainted(material: Material, rng: np.random.Generator) -> Material:
    factors = rng.normal(1.0, _SHADE) + rng.normal(0.0, _TINT, 3)
    red, green, blue = np.clip(np.array(material.color) * factors, 0.03, 1.0).tolist()
    variant = int(rng.integers(VARIANTS))
    return replace(material, color=(red, green, blue), variant=variant if material.texture is not None else 0)


def _relit(look: Look, rng: np.random.Generator) -> Look:
    azimuth, height = rng.uniform(0.0, 2 * np.pi), np.radians(rng.uniform(20.0, 70.0))
    sun = (np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height))
    horizon, zenith = _SKIES[rng.integers(len(_SKIES))]
    return Look(
        sun=(float(sun[0]), float(sun[1]), float(sun[2])),
        ambient=float(rng.uniform(0.50, 0.80)),
        diffuse=float(rng.uniform(0.15, 0.50)),
        horizon=horizon,
        zenith=zenith,
        haze_range=look.haze_range * float(np.exp(rng.uniform(np.log(0.5), np.log(2.3)))),
    )


_RANGES = 3.0
"""The visibility is so many haze ranges: exp(-3) = 5 % of the contrast is left, the limit of what is seen."""
_DEPTH = 60.0
"""How thick the layer of fog is overhead, m: what it leaves of the blue of the sky."""


def in_fog(scene: Scene, visibility: float) -> Scene:
    """The scene in fog in which 5 % of the contrast is left at `visibility`, m; layout, colours and sun stay.

    Koschmieder's law: C = exp(-3 d / visibility); where the scene is hazier already, that stays. The sky fades to the
    grey of its horizon. Call it after `with_other_look`, which draws air of its own.
    """
    look = scene.look
    haze_range = min(look.haze_range, positive("visibility", visibility) / _RANGES)
    clear = float(np.exp(-_DEPTH / haze_range))
    fog = (float(np.mean(look.horizon)),) * 3
    horizon, zenith = _mixed(fog, look.horizon, clear), _mixed(fog, look.zenith, clear)
    return replace(scene, look=replace(look, horizon=horizon, zenith=zenith, haze_range=haze_range))


def _mixed(one: Vector, other: Vector, share: float) -> Vector:
    """`one` with a share of `other`."""
    red, green, blue = (np.array(one) + share * (np.array(other) - np.array(one))).tolist()
    return red, green, blue


BLANK = Material((0.75, 0.75, 0.75))
"""Light grey, so that the sunny side is not yet white."""


def without_texture(scene: Scene) -> Scene:
    """The scene with everything in it of one plain colour; shapes, landmarks, light and air stay.

    What is left to see is light and shade: where two surfaces meet that the sun lights differently, and outlines
    against what is hazier.
    """
    return scene.repainted(lambda material: BLANK)
