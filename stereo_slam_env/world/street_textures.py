"""Painters of what stands in a street and of what lies under it."""

from __future__ import annotations

import cv2
import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.world.painting import Painter, grain, grey, noise, tinted


def _asphalt(rng: np.random.Generator) -> FloatArray:
    """The road across its width: two lanes between two parking strips; one repeat is a dash and a gap."""
    image = grain(rng, 512, 0.36, 0.025)
    for lane_edge, dashed in ((0.195, False), (0.5, True), (0.805, False)):
        column = int(lane_edge * 512)
        rows = slice(0, 230) if dashed else slice(0, 512)
        image[rows, column - 4 : column + 4] = 0.88 + noise(rng, 512, 4, 0.03)[rows, :8, None]
    image[:, :6] = image[:, -6:] = 0.6
    image[::128, : int(0.19 * 512)] = image[::128, int(0.81 * 512) :] = 0.5
    return image


def _paving(rng: np.random.Generator) -> FloatArray:
    image = grain(rng, 256, 0.66, 0.02)
    slabs = rng.uniform(-0.05, 0.05, (8, 4))
    image += np.kron(slabs, np.ones((32, 64)))[..., None]
    image[::32] -= 0.14
    image[:, ::64] -= 0.14
    return image


def _grass(rng: np.random.Generator) -> FloatArray:
    shade = noise(rng, 256, 2, 0.05) + noise(rng, 256, 16, 0.05) + noise(rng, 256, 64, 0.04)
    return tinted((0.40, 0.50, 0.25), 1.0 + shade)


def _leaves(rng: np.random.Generator) -> FloatArray:
    shade = noise(rng, 128, 4, 0.16) + noise(rng, 128, 16, 0.12)
    return tinted((0.62, 0.85, 0.42), np.clip(0.75 + shade, 0.3, 1.0))


def _bark(rng: np.random.Generator) -> FloatArray:
    stripes = cv2.GaussianBlur(rng.standard_normal((128, 128)), (1, 31), 0)
    return tinted((0.55, 0.45, 0.36), 1.0 + 0.5 * np.asarray(stripes))


def _bricks(rng: np.random.Generator, size: int, strength: float) -> FloatArray:
    """Courses of bricks around level 1."""
    rows, columns = size // 8, size // 16
    image = 1.0 + np.kron(rng.uniform(-strength, strength, (rows, columns)), np.ones((8, 16)))
    for course in range(0, rows, 2):
        image[course * 8 : course * 8 + 8] = np.roll(image[course * 8 : course * 8 + 8], 8, axis=1)
    image[::8] *= 0.86
    return grey(image)


def _glass(rng: np.random.Generator, height: int, width: int) -> FloatArray:
    """One window pane: sky reflected at the top, perhaps a curtain or a light."""
    fade = np.linspace(0.62, 0.30, height)[:, None, None] * np.array([0.85, 0.97, 1.1])
    pane = np.broadcast_to(fade, (height, width, 3)) * rng.uniform(0.75, 1.1)
    pane = pane.copy()
    kind = rng.random()
    if kind < 0.3:
        drawn = int(height * rng.uniform(0.25, 0.7))
        pane[:drawn] = np.array([0.86, 0.82, 0.74]) * rng.uniform(0.8, 1.0)
        pane[:drawn:4] *= 0.88
    elif kind < 0.5:
        side = int(width * rng.uniform(0.2, 0.35))
        pane[:, :side] = pane[:, -side:] = np.array([0.80, 0.72, 0.66]) * rng.uniform(0.8, 1.05)
    elif kind < 0.6:
        pane *= np.array([1.7, 1.45, 1.0])
    return pane


def _facade(wall: FloatArray, rng: np.random.Generator, window: tuple[float, float], bands: bool) -> FloatArray:
    """Four floors of four window bays on `wall` (512, 512, 3): each bay is one tile of the facade grid."""
    image, bay = wall, 128
    width, height = int(window[0] * bay), int(window[1] * bay)
    left, top = (bay - width) // 2, (bay - height) // 2 - 4
    for row in range(4):
        if bands:
            image[row * bay + 118 : row * bay + 128] *= 1.13
            image[row * bay + 117] *= 0.75
        for column in range(4):
            y, x = row * bay + top, column * bay + left
            image[y - 6 : y + height + 6, x - 6 : x + width + 6] = 0.93
            image[y + height + 6 : y + height + 10, x - 9 : x + width + 9] = 0.72
            image[y : y + height, x : x + width] = _glass(rng, height, width)
            image[y : y + height, x + width // 2 - 2 : x + width // 2 + 2] = 0.92
            image[y + height // 3 : y + height // 3 + 3, x : x + width] = 0.92
    return image


def _plaster_facade(rng: np.random.Generator) -> FloatArray:
    return _facade(grain(rng, 512, 0.95, 0.02), rng, (0.40, 0.58), bands=True)


def _brick_facade(rng: np.random.Generator) -> FloatArray:
    return _facade(_bricks(rng, 512, 0.10) * 0.86, rng, (0.46, 0.54), bands=False)


def _office_facade(rng: np.random.Generator) -> FloatArray:
    image = _facade(grain(rng, 512, 0.9, 0.02), rng, (0.86, 0.60), bands=False)
    image[::128] = 0.55
    return image


def _balcony_facade(rng: np.random.Generator) -> FloatArray:
    image = _facade(grain(rng, 512, 0.94, 0.025), rng, (0.56, 0.62), bands=False)
    for row in range(4):
        rail = image[row * 128 + 76 : row * 128 + 112, 20:236]
        rail[:3] = 0.25
        rail[:, ::8] = 0.3
    return image


def _shop_window(rng: np.random.Generator) -> FloatArray:
    """Goods on shelves behind glass that is brighter at the top; (308, 100, 3)."""
    pane = np.broadcast_to(np.array([0.62, 0.66, 0.68]), (308, 100, 3)).copy()
    for shelf in range(3):
        floor = 110 + 90 * shelf
        pane[floor : floor + 5] = 0.35
        at = 4
        while at < 90:
            width, height = int(rng.integers(6, 18)), int(rng.integers(18, 60))
            pane[floor - height : floor, at : at + width] = rng.uniform(0.2, 0.95, 3)
            at += width + int(rng.integers(2, 8))
    return pane * np.linspace(1.05, 0.6, 308)[:, None, None]


def _shop(rng: np.random.Generator) -> FloatArray:
    """Ground floor: four shop windows with a sign band above and a plinth below."""
    image = grain(rng, 512, 0.74, 0.03)
    for column in range(4):
        x = column * 128
        sign = rng.uniform(0.25, 0.95, 3)
        image[20:110, x + 4 : x + 124] = sign
        for letter in range(int(rng.integers(4, 8))):
            at = x + 18 + letter * 13
            image[44 : 44 + int(rng.integers(26, 42)), at : at + int(rng.integers(4, 10))] = 1.0 - 0.9 * sign
        image[130:450, x + 8 : x + 120] = 0.2
        image[136:444, x + 14 : x + 114] = _shop_window(rng)
        image[136:444, x + 62 : x + 66] = 0.2
    image[470:] *= 0.7
    return image


def _roof(rng: np.random.Generator) -> FloatArray:
    image = grain(rng, 128, 0.8, 0.05)
    image[::16] *= 0.8
    return image


STREET_PAINTERS: dict[str, Painter] = {
    "asphalt": _asphalt,
    "paving": _paving,
    "grass": _grass,
    "leaves": _leaves,
    "bark": _bark,
    "plaster": _plaster_facade,
    "brick": _brick_facade,
    "office": _office_facade,
    "balcony": _balcony_facade,
    "shop": _shop,
    "roof": _roof,
}
