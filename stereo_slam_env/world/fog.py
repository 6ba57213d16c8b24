"""Fog: the same scene where nothing farther than the visibility can be made out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from filters.validation import positive
from stereo_slam_env.world.scene import Scene, Vector

_RANGES = 3.0
"""The visibility is so many haze ranges: exp(-3) = 5 % of the contrast is left, the limit of what is seen."""
_DEPTH = 60.0
"""How thick the layer of fog is overhead, m: what it leaves of the blue of the sky."""


def in_fog(scene: Scene, visibility: float) -> Scene:
    """The scene in fog; layout, colours and sun stay.

    The sky fades to the grey of its horizon. Call it after `with_other_look`, which draws air of its own.

    Parameters
    ----------
    scene : Scene
        Any.
    visibility : float
        Distance at which 5 % of the contrast is left (Koschmieder's law, C = exp(-3 d / visibility)), m. Where the
        scene is hazier already, that stays.

    Raises
    ------
    ValueError
        `visibility` is not positive.
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
