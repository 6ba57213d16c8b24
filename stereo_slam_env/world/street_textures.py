"""Procedural textures by name, the same bits every time, and the painters of a street and of what moves in it."""

from __future__ import annotations

from functools import cache
from zlib import crc32

import cv2
import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import FloatArray
from stereo_slam_env.world import painting, street_textures
from stereo_slam_env.world.painting import SPECKLES, Painter, grain, grey, noise, tinted, written


def _paint_asphalt(rng: np.random.Generator) -> FloatArray:
    """The road across its width: two lanes between two parking strips; one repeat is a dash and a gap."""
    image = grain(rng, 512, 0.36, 0.025)
    for lane_edge, dashed in ((0.195, False), (0.5, True), (0.805, False)):
        column = int(lane_edge * 512)
        rows = slice(0, 230) if dashed else slice(0, 512)
        image[rows, column - 4 : column + 4] = 0.88 + noise(rng, 512, 4, 0.03)[rows, :8, None]
    image[:, :6] = image[:, -6:] = 0.6
    image[::128, : int(0.19 * 512)] = image[::128, int(0.81 * 512) :] = 0.5
    return image


def _paint_paving(rng: np.random.Generator) -> FloatArray:
    image = grain(rng, 256, 0.66, 0.02)
    slabs = rng.uniform(-0.05, 0.05, (8, 4))
    image += np.kron(slabs, np.ones((32, 64)))[..., None]
    image[::32] -= 0.14
    image[:, ::64] -= 0.14
    return image


def _paint_bark(rng: np.random.Generator) -> FloatArray:
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


def _paint_plaster(rng: np.random.Generator) -> FloatArray:
    return _facade(grain(rng, 512, 0.95, 0.02), rng, (0.40, 0.58), bands=True)


def _paint_brick(rng: np.random.Generator) -> FloatArray:
    return _facade(_bricks(rng, 512, 0.10) * 0.86, rng, (0.46, 0.54), bands=False)


def _paint_office(rng: np.random.Generator) -> FloatArray:
    image = _facade(grain(rng, 512, 0.9, 0.02), rng, (0.86, 0.60), bands=False)
    image[::128] = 0.55
    return image


def _paint_balcony(rng: np.random.Generator) -> FloatArray:
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


def _paint_shop(rng: np.random.Generator) -> FloatArray:
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


def _paint_roof(rng: np.random.Generator) -> FloatArray:
    image = grain(rng, 128, 0.8, 0.05)
    image[::16] *= 0.8
    return image


_NAMES = ("FRACHT", "MILCH", "BLITZ", "NORDGAS", "PAKET 24", "OBST", "KRONE", "ALPEN")
_PLATES = ("KA S 1203", "B LM 417", "M UV 9021", "HD EK 388")


def _plate(image: FloatArray, rng: np.random.Generator, x: int, y: int) -> None:
    """A number plate of 56 x 14 px with its upper left corner at (x, y)."""
    image[y : y + 14, x : x + 56] = 1.15
    image[y : y + 14, x : x + 4] = [0.2, 0.3, 0.8]
    text = _PLATES[rng.integers(len(_PLATES))].replace(" ", "")
    image[written(image.shape[:2], text, (x + 6, y + 11), 0.32, 1)] = 0.1


def _paint_car_side(rng: np.random.Generator) -> FloatArray:
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


def _paint_car_end(rng: np.random.Generator) -> FloatArray:
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


def _paint_car_window(rng: np.random.Generator) -> FloatArray:
    """Side windows: the sky in the panes, pillars, seats behind."""
    image: FloatArray = np.repeat(np.linspace(0.62, 0.22, 64)[:, None, None], 256, axis=1) * np.array([0.85, 0.97, 1.1])
    image += grey(noise(rng, 256, 16, 0.04)[:64])
    for seat in (70, 160):
        image[24:, seat : seat + 26] = 0.12
        image[14:26, seat + 6 : seat + 20] = 0.15
    image[:, 120:132] = image[:, :8] = image[:, -8:] = 0.75
    image[:4] = image[-4:] = 0.08
    return image


def _paint_livery(rng: np.random.Generator) -> FloatArray:
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
    image[written((256, 512), name, (140, 122), 2.3 if len(name) < 7 else 1.9, 9)] = color
    number = "0721 " + str(int(rng.integers(10_000, 99_999)))
    image[written((256, 512), number, (150, 226), 1.1, 3)] = 0.2
    image[:6] = image[-8:] = 0.45
    image[:, ::128] *= 0.72
    return image


def _paint_cargo_doors(rng: np.random.Generator) -> FloatArray:
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
    image[written((256, 256), name, (24, 66), 1.0, 4)] = rng.uniform(0.05, 0.6, 3)
    return image


def _paint_cloth(rng: np.random.Generator) -> FloatArray:
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
