"""What the painters of textures have in common: noise and tints."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import ArrayLike

from filters.validation import FloatArray

Painter = Callable[[np.random.Generator], FloatArray]
"""Paints an image (H, W, 3) of reflectances, about 0..1; sides are powers of two where it must repeat."""


def noise(rng: np.random.Generator, size: int, scale: int, strength: float) -> FloatArray:
    """Smooth, tileable noise of zero mean: features of about `scale` px."""
    coarse = rng.standard_normal((size // scale, size // scale))
    wrapped = np.pad(coarse, 2, mode="wrap")
    big = cv2.resize(wrapped, (wrapped.shape[1] * scale, wrapped.shape[0] * scale), interpolation=cv2.INTER_CUBIC)
    return strength * np.asarray(big[2 * scale : 2 * scale + size, 2 * scale : 2 * scale + size], dtype=np.float64)


def grey(value: ArrayLike) -> FloatArray:
    """An image (H, W) in grey: (H, W, 3)."""
    return np.repeat(np.asarray(value, dtype=np.float64)[..., None], 3, axis=2)


def tinted(color: tuple[float, float, float], level: ArrayLike) -> FloatArray:
    """`color` times an image (H, W): (H, W, 3)."""
    image: FloatArray = np.asarray(level, dtype=np.float64)[..., None] * np.array(color)
    return image


def grain(rng: np.random.Generator, size: int, level: float, strength: float) -> FloatArray:
    """Grey with noise of all scales."""
    return grey(level + noise(rng, size, 1, 0.4 * strength) + noise(rng, size, 4, 0.5 * strength)
                 + noise(rng, size, 32, strength))  # fmt: skip
