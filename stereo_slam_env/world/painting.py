"""Painters of textures: noise and tints, and the surfaces of open country and corridor."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from filters.geometry.arrays import BoolArray, FloatArray

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


def written(shape: tuple[int, int], text: str, at: tuple[int, int], scale: float, thickness: int) -> BoolArray:
    """Mask of the ink of `text` written with its lower left corner `at` (x, y)."""
    ink = np.zeros(shape, dtype=np.uint8)
    cv2.putText(ink, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, thickness)
    return np.asarray(ink > 127)


class Speckle(NamedTuple):
    """A surface of one tint: brightness within bounds, and noise by scale (px) and strength."""

    color: tuple[float, float, float]
    size: int
    level: float
    noises: tuple[tuple[int, float], ...]
    bounds: tuple[float, float] = (-np.inf, np.inf)

    def __call__(self, rng: np.random.Generator) -> FloatArray:
        """Colours (size, size, 3) of the texture."""
        shade = sum(noise(rng, self.size, scale, strength) for scale, strength in self.noises)
        return tinted(self.color, np.clip(self.level + shade, *self.bounds))


SPECKLES = {
    "meadow": Speckle((0.46, 0.56, 0.30), 256, 1.0, ((64, 0.025), (16, 0.006))),  # hardly any contrast
    "track": Speckle((0.62, 0.59, 0.53), 256, 1.0, ((64, 0.02), (16, 0.006))),  # fine gravel, smooth from a car
    "woods": Speckle((0.45, 0.60, 0.34), 256, 0.8, ((4, 0.10), (8, 0.12), (32, 0.10)), (0.25, 1.15)),  # from afar
    "grass": Speckle((0.40, 0.50, 0.25), 256, 1.0, ((2, 0.05), (16, 0.05), (64, 0.04))),
    "leaves": Speckle((0.62, 0.85, 0.42), 128, 0.75, ((4, 0.16), (16, 0.12)), (0.3, 1.0)),
}


def _paint_planks(rng: np.random.Generator) -> FloatArray:
    """The wall of a barn: boards, a gate, two hatches."""
    image = grain(rng, 256, 0.86, 0.03) * np.repeat(rng.uniform(0.75, 1.1, 32), 8)[None, :, None]
    image[:, ::8] *= 0.55
    image[120:, 84:172] *= 0.45
    image[124:, 90:126] *= 1.5
    image[124:, 130:166] *= 1.5
    for hatch in (28, 204):
        image[70:100, hatch : hatch + 26] = 0.16
        image[66:70, hatch - 3 : hatch + 29] = 0.95
    return image


def _paint_panels(rng: np.random.Generator) -> FloatArray:
    """Sheets of painted metal with seams and rust."""
    image = grain(rng, 128, 0.9, 0.02)
    image *= np.kron(rng.uniform(0.8, 1.1, (4, 4)), np.ones((32, 32)))[..., None]
    image[::32] = image[:, ::32] = 0.4
    streaks: FloatArray = np.asarray(cv2.GaussianBlur(rng.standard_normal((128, 128)), (3, 31), 0))
    image *= np.clip(1.0 - 1.2 * np.abs(streaks), 0.5, 1.0)[..., None] * np.array([1.0, 0.97, 0.93])
    return image


def _paint_rock(rng: np.random.Generator) -> FloatArray:
    """Weathered stone: patches, grains and cracks."""
    level = 0.8 + noise(rng, 128, 32, 0.10) + noise(rng, 128, 8, 0.09) + noise(rng, 128, 2, 0.05)
    level -= 0.3 * (np.abs(noise(rng, 128, 16, 1.0)) < 0.06)
    return tinted((0.72, 0.70, 0.66), np.clip(level, 0.2, 1.1))


def _paint_logs(rng: np.random.Generator) -> FloatArray:
    """The sawn ends of stacked logs."""
    image = np.full((256, 256, 3), 0.2)
    for row in range(8):
        for column in range(8):
            at = (32 * column + 16 * (row % 2) + int(rng.integers(6, 11)), 32 * row + int(rng.integers(14, 19)))
            wood = rng.uniform(0.75, 1.1) * np.array([0.82, 0.63, 0.42])
            for radius, shade in ((16, 0.6), (13, 1.15), (9, 0.95), (8, 1.15), (5, 0.9), (4, 1.15), (1, 0.7)):
                for wrapped in (at[0], at[0] - 256):
                    cv2.circle(image, (wrapped, at[1]), radius, tuple((shade * wood).tolist()), -1, cv2.LINE_AA)
    return image


def _paint_straw(rng: np.random.Generator) -> FloatArray:
    """Pressed straw, bound with twine."""
    stalks: FloatArray = np.asarray(cv2.GaussianBlur(rng.standard_normal((128, 128)), (15, 1), 0))
    image = tinted((0.86, 0.72, 0.40), np.clip(0.85 + 0.45 * stalks + noise(rng, 128, 32, 0.06), 0.3, 1.15))
    image[:, 30:33] = image[:, 94:97] = 0.25
    return image


def _paint_concrete(rng: np.random.Generator) -> FloatArray:
    """Smooth wall, nearly uniform."""
    return grey(0.80 + noise(rng, 256, 64, 0.008))


def _paint_door(rng: np.random.Generator) -> FloatArray:
    """A steel door with a handle, a small window and a number."""
    image = grain(rng, 128, 0.85, 0.01)[:, :64]
    image[20:46, 20:44] = 0.25
    image[20:46, 31:33] = 0.8
    image[68:72, 46:58] = 0.15
    image[104:120, 8:56] *= 0.8
    image[written((128, 64), str(int(rng.integers(10, 99))), (16, 64), 0.5, 1)] = 0.1
    return image


def _paint_notice(rng: np.random.Generator) -> FloatArray:
    """A sign: an arrow and two lines of print on a coloured ground."""
    grounds = np.array([[0.1, 0.45, 0.25], [0.15, 0.3, 0.65], [0.75, 0.6, 0.1]])
    image: FloatArray = np.ones((64, 128, 3)) * grounds[rng.integers(3)]
    image[:3] = image[-3:] = image[:, :3] = image[:, -3:] = 0.95
    ink = np.zeros((64, 128), dtype=np.uint8)
    cv2.arrowedLine(ink, (40, 32), (12, 32), 255, 5, tipLength=0.5)
    exit_sign = written((64, 128), f"EXIT {int(rng.integers(1, 9))}", (50, 28), 0.55, 2)
    distance = written((64, 128), f"{int(rng.integers(20, 400))} m", (50, 52), 0.5, 1)
    image[(ink > 127) | exit_sign | distance] = 0.95
    return image
