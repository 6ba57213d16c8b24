"""Painters of what moves: each picture covers one side of a body once."""

from __future__ import annotations

import cv2
import numpy as np

from filters.validation import BoolArray, FloatArray
from stereo_slam_env.world.painting import Painter, grain, grey, noise

_NAMES = ("FRACHT", "MILCH", "BLITZ", "NORDGAS", "PAKET 24", "OBST", "KRONE", "ALPEN")
_PLATES = ("KA S 1203", "B LM 417", "M UV 9021", "HD EK 388")


def _written(shape: tuple[int, int], text: str, at: tuple[int, int], scale: float, thickness: int) -> BoolArray:
    """Where the ink is when `text` is written with its lower left corner `at` (x, y)."""
    ink = np.zeros(shape, dtype=np.uint8)
    cv2.putText(ink, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, 255, thickness)
    return np.asarray(ink > 127)


def _plate(image: FloatArray, rng: np.random.Generator, x: int, y: int) -> None:
    """A number plate of 56 x 14 px with its upper left corner at (x, y)."""
    image[y : y + 14, x : x + 56] = 1.15
    image[y : y + 14, x : x + 4] = [0.2, 0.3, 0.8]
    text = _PLATES[rng.integers(len(_PLATES))].replace(" ", "")
    image[_written(image.shape[:2], text, (x + 6, y + 11), 0.32, 1)] = 0.1


def _car_side(rng: np.random.Generator) -> FloatArray:
    """The lower half of a car from the side: wheel arches, doors, handles, mouldings."""
    image = grain(rng, 256, 0.93, 0.015)[:96]
    image *= np.linspace(1.07, 0.86, 96)[:, None, None]
    for seam in (78, 126, 174):
        image[6:84, seam : seam + 2] = 0.35
    for handle in (110, 158):
        image[24:29, handle : handle + 13] = 0.25
        image[24:26, handle : handle + 13] = 1.15
    image[44:47] *= 0.72
    image[47:49] *= 1.15
    image[86:] *= 0.35
    rows, columns = np.mgrid[:96, :256]
    for wheel in (50, 208):
        image[np.hypot(rows - 96, columns - wheel) < 30] = 0.10
    image[30:38, 236:242] = [1.1, 0.6, 0.2]
    return image


def _car_end(rng: np.random.Generator) -> FloatArray:
    """Front or rear of a car: lid, grille, plate, bumper."""
    image = grain(rng, 256, 0.94, 0.015)[:96, :192]
    image[8:10, 14:178] = 0.45
    image[52:54] = 0.4
    image[10:52, 14:16] = image[10:52, 176:178] = 0.45
    image[18:34:5, 66:126] = 0.3
    image[14:22, 90:102] = 1.2
    image[62:84] *= 0.6
    image[86:] = 0.15
    _plate(image, rng, 68, 38)
    return image


def _car_window(rng: np.random.Generator) -> FloatArray:
    """Side windows: the sky in the panes, pillars, seats behind."""
    image: FloatArray = np.repeat(np.linspace(0.62, 0.22, 64)[:, None, None], 256, axis=1) * np.array([0.85, 0.97, 1.1])
    image += grey(noise(rng, 256, 16, 0.04)[:64])
    for seat in (70, 160):
        image[24:, seat : seat + 26] = 0.12
        image[14:26, seat + 6 : seat + 20] = 0.15
    image[:, 120:132] = image[:, :8] = image[:, -8:] = 0.75
    image[:4] = image[-4:] = 0.08
    return image


def _livery(rng: np.random.Generator) -> FloatArray:
    """The side of a van or a lorry: a name in large letters, a stripe, an emblem, small print."""
    image = grain(rng, 512, 0.95, 0.01)[:256]
    color = rng.uniform(0.05, 0.75, 3)
    top = int(rng.integers(150, 176))
    image[top : top + 26] = color
    image[top + 32 : top + 38] = color
    center = (int(rng.integers(60, 90)), int(rng.integers(70, 100)))
    emblem = np.hypot(*(np.mgrid[:256, :512] - np.array([center[1], center[0]])[:, None, None])) / 46
    image[emblem < 1.0] = color
    image[emblem < 0.7] = 0.95
    image[emblem < 0.4] = 1.0 - color
    name = _NAMES[rng.integers(len(_NAMES))]
    image[_written((256, 512), name, (140, 122), 2.3 if len(name) < 7 else 1.9, 9)] = color
    number = "0721 " + str(int(rng.integers(10_000, 99_999)))
    image[_written((256, 512), number, (150, 226), 1.1, 3)] = 0.2
    image[:6] = image[-8:] = 0.45
    image[:, ::128] *= 0.72
    return image


def _cargo_doors(rng: np.random.Generator) -> FloatArray:
    """The rear of a van or a lorry: two doors with bars, warning stripes, a plate."""
    image = grain(rng, 256, 0.92, 0.015)
    image[8:200, 126:130] = 0.2
    for bar in (88, 164):
        image[8:200, bar : bar + 5] = 0.55
        image[8:200, bar + 5] = 0.25
        image[96:106, bar - 12 : bar + 16] = 0.35
    for hinge in (30, 100, 170):
        image[hinge : hinge + 12, 4:16] = image[hinge : hinge + 12, 240:252] = 0.4
    rows, columns = np.mgrid[200:226, :256]
    image[200:226] = np.where(((rows + columns) // 20 % 2)[..., None], [0.95, 0.95, 0.9], [0.85, 0.12, 0.1])
    image[226:] = 0.18
    _plate(image, rng, 100, 232)
    name = _NAMES[rng.integers(len(_NAMES))]
    image[_written((256, 256), name, (24, 66), 1.0, 4)] = rng.uniform(0.05, 0.6, 3)
    return image


def _cloth(rng: np.random.Generator) -> FloatArray:
    """Clothes: stripes or checks, a seam, buttons."""
    image = grain(rng, 128, 0.9, 0.04)
    if rng.random() < 0.5:
        image[::16] *= 0.45
        image[1::16] *= 0.45
        image[2::16] *= 0.45
    else:
        image *= np.where(np.add.outer(np.arange(128) // 16, np.arange(128) // 16) % 2, 1.0, 0.65)[..., None]
    image[:, 62:65] = 0.3
    return image


BODY_PAINTERS: dict[str, Painter] = {
    "car-side": _car_side,
    "car-end": _car_end,
    "car-window": _car_window,
    "livery": _livery,
    "cargo-doors": _cargo_doors,
    "cloth": _cloth,
}
