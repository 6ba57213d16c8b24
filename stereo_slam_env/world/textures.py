"""Procedural textures by name, the same bits every time: detail for cameras to see, made without image files."""

from __future__ import annotations

from functools import cache
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from stereo_slam_env.world import painting, street_textures
from stereo_slam_env.world.painting import SPECKLES, Painter

Image = NDArray[np.uint8]
_PAINTERS: dict[str, Painter] = SPECKLES | {
    name.removeprefix("_paint_").replace("_", "-"): painter
    for module in (street_textures, painting)
    for name, painter in vars(module).items()
    if name.startswith("_paint_")
}
"""The textures of one tint, and the functions `_paint_<name>`."""
TEXTURES: tuple[str, ...] = tuple(_PAINTERS)
"""Names a `Material` may use."""


VARIANTS = 4
"""How many versions of each texture there are."""


@cache
def texture(name: str, variant: int = 0) -> Image:
    """The texture as RGB uint8 (H, W, 3), top row first; read-only.

    Variant 0 is the standard; others differ from it in details, contrast and brightness. A `ValueError` where there is
    no such texture or variant.
    """
    if name not in _PAINTERS:
        raise ValueError(f"texture must be one of {', '.join(TEXTURES)}, got {name!r}")
    if not 0 <= variant < VARIANTS:
        raise ValueError(f"variant must be from 0 to {VARIANTS - 1}, got {variant!r}")
    rng = np.random.default_rng([crc32(name.encode()), variant] if variant else crc32(name.encode()))
    painted = _PAINTERS[name](rng)
    if variant:
        mean = painted.mean(axis=(0, 1))
        painted = mean * rng.uniform(0.85, 1.1) + (painted - mean) * rng.uniform(0.7, 1.3)
    image: Image = np.rint(np.clip(painted, 0.0, 1.0) * 255).astype(np.uint8)
    image.flags.writeable = False
    return image
