"""What moves: vehicles and people, each composed of primitives in its own frame (x forward, y left, z up)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stereo_slam_env.world.props import LAMP, PAINTS, RUBBER, STEEL, TAIL, Placed
from stereo_slam_env.world.scene import Box, Material, Primitive, Sphere, Vector
from stereo_slam_env.world.textures import VARIANTS

_HERE = Placed(np.zeros(2), 0.0)
_SKINS: tuple[Vector, ...] = ((0.93, 0.76, 0.64), (0.75, 0.56, 0.42), (0.45, 0.32, 0.24))
_CLOTHES: tuple[Vector, ...] = (
    (0.85, 0.25, 0.2),
    (0.25, 0.35, 0.75),
    (0.9, 0.85, 0.3),
    (0.85, 0.85, 0.88),
    (0.3, 0.6, 0.4),
    (0.55, 0.3, 0.6),
)
_TROUSERS: tuple[Vector, ...] = ((0.16, 0.18, 0.26), (0.3, 0.27, 0.24), (0.12, 0.12, 0.13))
_WHITE = Material((0.93, 0.93, 0.92))
_DECAL = 0.012
"""How far a picture stands off the body, m."""


def vehicle(rng: np.random.Generator) -> tuple[Primitive, ...]:
    """A car, a van or a lorry, at most 8 m long and 2.4 m wide."""
    kind = rng.choice(3, p=[0.55, 0.25, 0.20])
    return tuple((_car, _van, _lorry)[kind](rng))


def length_of(parts: tuple[Primitive, ...]) -> float:
    """Of the boxes of a body along its x axis, m."""
    boxes = [part for part in parts if isinstance(part, Box)]
    return max(b.center[0] + 0.5 * b.size[0] for b in boxes) - min(b.center[0] - 0.5 * b.size[0] for b in boxes)


def pedestrian(rng: np.random.Generator) -> tuple[Primitive, ...]:
    """A person of 1.6 to 1.9 m, half a metre wide."""
    tall = float(rng.uniform(0.92, 1.08))
    skin = Material(_chosen(_SKINS, rng))
    coat = Material(_chosen(_CLOTHES, rng), "cloth", (0.5, 0.62 * tall), _variant(rng))
    trousers, hair = Material(_chosen(_TROUSERS, rng)), Material(_chosen(_TROUSERS, rng))
    sleeve = replace(coat, texture=None)
    legs = [
        _HERE.rod((step, y, 0.0), (0.0, y, 0.85 * tall), 0.085, trousers) for step, y in ((0.16, 0.1), (-0.16, -0.1))
    ]
    arms = [
        _HERE.rod((step, y, 0.9 * tall), (0.0, y, 1.4 * tall), 0.055, sleeve, solid=False)
        for step, y in ((-0.14, 0.26), (0.14, -0.26))
    ]
    bag = _HERE.box((-0.2, 0.0, 0.98 * tall), (0.16, 0.3, 0.38), Material(_chosen(_CLOTHES, rng)), solid=False)
    return (
        *legs,
        _HERE.box((0, 0, 0.82 * tall), (0.26, 0.42, 0.62 * tall), coat),
        *arms,
        Sphere((0.0, 0.0, 1.58 * tall), 0.125, skin),
        Sphere((-0.03, 0.0, 1.62 * tall), 0.122, hair, solid=False),
        *((bag,) if rng.random() < 0.4 else ()),
    )


def _car(rng: np.random.Generator) -> list[Primitive]:
    long, tall = float(rng.uniform(0.95, 1.1)), float(rng.uniform(0.98, 1.15))
    paint, variant = Material(_chosen(PAINTS, rng)), _variant(rng)
    body, cabin = (4.2 * long, 1.76, 0.62), (2.35 * long, 1.56, 0.48 * tall)
    return [
        _HERE.box((0, 0, 0.03), (4.3 * long, 1.7, 0.02), RUBBER, solid=False),
        _HERE.box((0, 0, 0.25), body, paint),
        _HERE.box((-0.2, 0, 0.87), cabin, paint),
        _HERE.box((-0.2, 0, 0.87 + cabin[2]), (2.15 * long, 1.52, 0.08), paint),
        *_sides(0.0, 0.25, body, _picture(paint, "car-side", (body[0], body[2]), variant)),
        *_ends(0.0, 0.25, body, _picture(paint, "car-end", (body[1], body[2]), variant)),
        *_sides(-0.2, 0.87, cabin, _picture(_WHITE, "car-window", (cabin[0], cabin[2]), variant)),
        *_ends(-0.2, 0.87, cabin, _picture(_WHITE, "car-window", (cabin[1], cabin[2]), variant)),
        *_wheels((-1.3 * long, 1.35 * long), 0.33, 0.88),
        *_lights(0.5 * body[0], 0.6, 0.6),
    ]


def _van(rng: np.random.Generator) -> list[Primitive]:
    paint, variant = Material(_chosen(((0.95, 0.95, 0.93), (0.95, 0.85, 0.35), (0.75, 0.82, 0.9)), rng)), _variant(rng)
    body, nose = (3.9, 1.9, 1.75), (1.2, 1.85, 0.85)
    return [
        _HERE.box((0, 0, 0.03), (5.0, 1.8, 0.02), RUBBER, solid=False),
        _HERE.box((-0.6, 0, 0.35), body, paint),
        _HERE.box((1.95, 0, 0.35), nose, paint),
        *_sides(-0.6, 0.35, body, _picture(paint, "livery", (body[0], body[2]), variant)),
        *_rear(-0.6, 0.35, body, _picture(paint, "cargo-doors", (body[1], body[2]), variant)),
        *_front(1.95, 0.35, nose, _picture(paint, "car-end", (nose[1], nose[2]), variant)),
        *_front(-0.6, 1.22, (body[0], 1.7, 0.75), _picture(_WHITE, "car-window", (1.7, 0.75), variant)),
        *_wheels((-1.8, 1.8), 0.36, 0.93),
        *_lights(2.55, 0.7, 0.72, rear=-2.55),
    ]


def _lorry(rng: np.random.Generator) -> list[Primitive]:
    paint, variant = Material(_chosen(PAINTS, rng)), _variant(rng)
    cargo, cab = (5.4, 2.35, 2.2), (1.7, 2.2, 1.85)
    return [
        _HERE.box((0, 0, 0.03), (7.4, 2.2, 0.02), RUBBER, solid=False),
        _HERE.box((-1.0, 0, 0.95), cargo, _WHITE),
        _HERE.box((-1.0, 0, 0.55), (5.4, 1.0, 0.4), STEEL),
        _HERE.box((2.75, 0, 0.45), cab, paint),
        *_sides(-1.0, 0.95, cargo, _picture(_WHITE, "livery", (cargo[0], cargo[2]), variant)),
        *_rear(-1.0, 0.95, cargo, _picture(_WHITE, "cargo-doors", (cargo[1], cargo[2]), variant)),
        *_front(2.75, 0.45, (cab[0], cab[1], 0.8), _picture(paint, "car-end", (cab[1], 0.8), variant)),
        *_front(2.75, 1.35, (cab[0], 2.0, 0.8), _picture(_WHITE, "car-window", (2.0, 0.8), variant)),
        *_sides(2.9, 1.35, (1.0, cab[1], 0.7), _picture(_WHITE, "car-window", (1.0, 0.7), variant)),
        *_wheels((-2.9, -1.9, 2.7), 0.46, 1.1),
        *_lights(3.6, 0.85, 0.65, rear=-3.7),
    ]


def _picture(ground: Material, name: str, tile: tuple[float, float], variant: int) -> Material:
    return Material(ground.color, name, tile, variant)


def _sides(x: float, z: float, size: Vector, picture: Material) -> list[Primitive]:
    """Pictures on the left and right of a box whose bottom centre is at (x, 0, z)."""
    return [
        _HERE.box((x, sign * 0.5 * (size[1] + _DECAL), z), (size[0], _DECAL, size[2]), picture, solid=False)
        for sign in (1, -1)
    ]


def _front(x: float, z: float, size: Vector, picture: Material) -> list[Primitive]:
    return [_HERE.box((x + 0.5 * (size[0] + _DECAL), 0, z), (_DECAL, size[1], size[2]), picture, solid=False)]


def _rear(x: float, z: float, size: Vector, picture: Material) -> list[Primitive]:
    return [_HERE.box((x - 0.5 * (size[0] + _DECAL), 0, z), (_DECAL, size[1], size[2]), picture, solid=False)]


def _ends(x: float, z: float, size: Vector, picture: Material) -> list[Primitive]:
    return [*_front(x, z, size, picture), *_rear(x, z, size, picture)]


def _wheels(axles: tuple[float, ...], radius: float, half_track: float) -> list[Primitive]:
    tyres: list[Primitive] = []
    for x in axles:
        for y in (-half_track, half_track):
            inside = y - np.copysign(0.22, y)
            tyres.append(_HERE.rod((x, inside, radius), (x, y, radius), radius, RUBBER, solid=False))
            rim = y + np.copysign(0.02, y)
            tyres.append(_HERE.rod((x, y, radius), (x, rim, radius), 0.58 * radius, STEEL, solid=False))
    return tyres


def _lights(front: float, half_width: float, z: float, rear: float | None = None) -> list[Primitive]:
    ends = ((front, LAMP), (-front if rear is None else rear, TAIL))
    return [
        _HERE.box((x, y, z), (0.07, 0.34, 0.16), material, solid=False)
        for x, material in ends
        for y in (-half_width, half_width)
    ]


def _chosen(colors: tuple[Vector, ...], rng: np.random.Generator) -> Vector:
    return colors[rng.integers(len(colors))]


def _variant(rng: np.random.Generator) -> int:
    return int(rng.integers(VARIANTS))
