"""The same scene in another look: drawn at random, in fog, or without texture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filters.contract.validation import positive
from stereo_slam_env.world.scene import Look, Material, Scene, Vector
from stereo_slam_env.world.textures import VARIANTS

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
