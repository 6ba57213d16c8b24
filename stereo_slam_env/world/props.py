"""Things in a street, each composed of a few primitives; their layout off the roads, and landmarks on them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.world.road import RoadNetwork
from stereo_slam_env.world.scene import Box, Cylinder, Material, Primitive, Sphere, Vector, table_of
from stereo_slam_env.world.street_textures import VARIANTS

HOUSE, TOWER, CAR, LAMP_POST, TREE, SIGN, BIN = range(7)
"""Kinds of things in a street, see `street_plan`."""
BAY = 3.2
"""Width and height of one window bay of a facade, m."""
GROUND_FLOOR = 3.6
"""Height of the ground floor, m."""

_WALLS: tuple[tuple[str, Vector], ...] = (
    ("plaster", (0.93, 0.86, 0.70)),
    ("plaster", (0.82, 0.86, 0.88)),
    ("plaster", (0.95, 0.78, 0.64)),
    ("plaster", (0.78, 0.86, 0.74)),
    ("brick", (0.78, 0.46, 0.36)),
    ("brick", (0.66, 0.50, 0.42)),
    ("brick", (0.88, 0.74, 0.56)),
    ("balcony", (0.92, 0.90, 0.84)),
    ("balcony", (0.86, 0.72, 0.58)),
    ("office", (0.78, 0.82, 0.86)),
)
_CHIMNEY, _FLAT_ROOF, _BIN = Material((0.55, 0.38, 0.33)), Material((0.45, 0.45, 0.47)), Material((0.20, 0.36, 0.28))
_SHOPS: tuple[Vector, ...] = ((1.0, 0.96, 0.90), (0.92, 0.86, 0.80), (0.84, 0.88, 0.92))
_ROOFS: tuple[Vector, ...] = ((0.50, 0.36, 0.32), (0.40, 0.40, 0.43))
PAINTS: tuple[Vector, ...] = (
    (0.72, 0.12, 0.12),
    (0.14, 0.28, 0.56),
    (0.86, 0.87, 0.88),
    (0.32, 0.34, 0.37),
    (0.90, 0.68, 0.16),
    (0.16, 0.42, 0.34),
)
GLASS = Material((0.16, 0.20, 0.25))
RUBBER = Material((0.09, 0.09, 0.10))
LAMP = Material((0.96, 0.94, 0.84))
TAIL = Material((0.75, 0.10, 0.08))
STEEL = Material((0.42, 0.45, 0.48))
SHADE = Material((0.20, 0.20, 0.21))
_SIGN, _SIGN_EDGE = Material((0.14, 0.34, 0.70)), Material((0.92, 0.92, 0.92))
_BARK = Material((0.9, 0.9, 0.9), "bark", (1.2, 2.0))
_LEAVES = (
    Material((0.92, 1.0, 0.85), "leaves", (2.0, 2.0)),
    Material((0.80, 0.86, 0.62), "leaves", (2.4, 2.4)),
)


class Placed:
    """A place to build at: turns local coordinates (x along `yaw`, y to the left, z up) from `xy` (2,), m, into S."""

    def __init__(self, xy: FloatArray, yaw: float) -> None:
        self.yaw = float(yaw)
        self._x, self._y = map(float, xy)
        self._cos, self._sin = float(np.cos(yaw)), float(np.sin(yaw))

    def point(self, x: float, y: float, z: float) -> Vector:
        """A local point in S."""
        return self._x + self._cos * x - self._sin * y, self._y + self._sin * x + self._cos * y, z

    def box(self, at: Vector, size: Vector, material: Material, *, solid: bool = True) -> Box:
        """A box aligned with the place; `at` is the centre of its bottom face."""
        # Written out, here and below, rather than by `point`: there are many of these.
        (x, y, z), cos, sin = at, self._cos, self._sin
        center = (self._x + cos * x - sin * y, self._y + sin * x + cos * y, z + 0.5 * size[2])
        return Box(center, size, self.yaw, material, solid)

    def rod(self, start: Vector, end: Vector, radius: float, material: Material, *, solid: bool = True) -> Cylinder:
        """A cylinder from `start` to `end`."""
        (x1, y1, z1), (x2, y2, z2), cos, sin = start, end, self._cos, self._sin
        one = (self._x + cos * x1 - sin * y1, self._y + sin * x1 + cos * y1, z1)
        other = (self._x + cos * x2 - sin * y2, self._y + sin * x2 + cos * y2, z2)
        return Cylinder(one, other, radius, material, solid)


def street_materials(things: FloatArray) -> list[Material]:
    """Materials of the primitives of things in a street, in the order of `street_plan.parts`."""
    materials: list[Material] = []
    for kind, _, _, _, *drawn in things.tolist():
        if kind == HOUSE:
            length, _, _, style, shop, roof = drawn[:6]
            texture, color = _WALLS[int(style)]
            width = 4 * length / max(1, round(length / BAY))
            wall = Material(color, texture, (width, 4 * BAY))
            ledge = Material(color, None, wall.tile)
            shops = Material(_SHOPS[int(shop)], "shop", (width, GROUND_FLOOR))
            materials += [shops, wall, ledge, Material(_ROOFS[int(roof)], "roof", (3.0, 3.0)), _CHIMNEY, _CHIMNEY]
        elif kind == TOWER:
            texture, color = _WALLS[int(drawn[3])]
            materials += [Material(color, texture, (4 * BAY, 4 * BAY)), _FLAT_ROOF]
        elif kind == CAR:
            paint = Material(PAINTS[int(drawn[0])])
            lights = [LAMP, LAMP, TAIL, TAIL]
            materials += [SHADE, paint, GLASS, paint, *[paint] * 6, *[RUBBER] * 4, *[STEEL] * 4, *lights]
        elif kind == LAMP_POST:
            materials += [STEEL, STEEL, STEEL, LAMP]
        elif kind == TREE:
            materials += [_BARK, *[_LEAVES[int(drawn[1])]] * 3]
        elif kind == SIGN:
            materials += [STEEL, _SIGN_EDGE, _SIGN]
        else:
            materials += [_BIN, STEEL]
    return materials


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
    """Length of the boxes of a body along its x axis, m."""
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
        *_panels(0.0, 0.25, body, "left right", paint, "car-side", variant),
        *_panels(0.0, 0.25, body, "front rear", paint, "car-end", variant),
        *_panels(-0.2, 0.87, cabin, "left right", _WHITE, "car-window", variant),
        *_panels(-0.2, 0.87, cabin, "front rear", _WHITE, "car-window", variant),
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
        *_panels(-0.6, 0.35, body, "left right", paint, "livery", variant),
        *_panels(-0.6, 0.35, body, "rear", paint, "cargo-doors", variant),
        *_panels(1.95, 0.35, nose, "front", paint, "car-end", variant),
        *_panels(-0.6, 1.22, (body[0], 1.7, 0.75), "front", _WHITE, "car-window", variant),
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
        *_panels(-1.0, 0.95, cargo, "left right", _WHITE, "livery", variant),
        *_panels(-1.0, 0.95, cargo, "rear", _WHITE, "cargo-doors", variant),
        *_panels(2.75, 0.45, (cab[0], cab[1], 0.8), "front", paint, "car-end", variant),
        *_panels(2.75, 1.35, (cab[0], 2.0, 0.8), "front", _WHITE, "car-window", variant),
        *_panels(2.9, 1.35, (1.0, cab[1], 0.7), "left right", _WHITE, "car-window", variant),
        *_wheels((-2.9, -1.9, 2.7), 0.46, 1.1),
        *_lights(3.6, 0.85, 0.65, rear=-3.7),
    ]


def _panels(
    x: float, z: float, size: Vector, faces: str, paint: Material, picture: str, variant: int
) -> list[Primitive]:
    """Pictures on the left, right, front or rear of a box whose bottom centre is at (x, 0, z)."""
    panels: list[Primitive] = []
    for face in faces.split():
        axis, sign = {"left": (1, 1), "right": (1, -1), "front": (0, 1), "rear": (0, -1)}[face]
        at, shape = [x, 0.0, z], list(size)
        at[axis] += sign * 0.5 * (size[axis] + _DECAL)
        shape[axis] = _DECAL
        look = Material(paint.color, picture, (size[1 - axis], size[2]), variant)
        panels.append(_HERE.box((at[0], at[1], at[2]), (shape[0], shape[1], shape[2]), look, solid=False))
    return panels


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


Make = Callable[[Placed], list[Primitive]]
"""Builds a thing at a place."""


class Layout:
    """Puts things where there is room beside the roads of a network."""

    def __init__(self, network: RoadNetwork) -> None:
        from stereo_slam_env.world import compiled

        self._claim = compiled.claim
        self._network = network
        self.primitives: list[Primitive] = []
        self._footprints = np.zeros((64, compiled.RADIUS + 1))
        """A rectangle on the ground of each thing, with room for more."""
        self._count = 0

    def claim(
        self, xy: FloatArray, yaw: float, size: tuple[float, float], room: float, clearance: float, make: Make
    ) -> bool:
        """Build if the footprint is `clearance` m off every centreline and free; return whether it was."""
        if self._count == len(self._footprints):
            self._footprints = np.concatenate([self._footprints, np.zeros_like(self._footprints)])
        place = (float(xy[0]), float(xy[1]), float(yaw))
        roads = self._network
        free: bool = self._claim(
            roads.points, roads.circles, self._footprints, self._count,
            place, (float(size[0]), float(size[1])), float(room), float(clearance),
        )  # fmt: skip
        if free:
            self._count += 1
            self.primitives += make(Placed(xy, yaw))
        return free


def facing_points(
    shapes: Sequence[Primitive],
    count: int,
    highest: float,
    network: RoadNetwork,
    rng: np.random.Generator,
) -> FloatArray:
    """`count` points (fewer on few shapes) below `highest` m that face the nearest road of a network."""
    from stereo_slam_env.world import compiled

    if not len(shapes):
        return np.zeros((0, 3))
    table = table_of(shapes)
    weights = compiled.sampling_weights(table)
    counts = np.ceil(6 * count * weights / weights.sum()).astype(np.int64)
    candidates = compiled.sample_facing(table, counts, network.points, network.circles, highest, rng)
    chosen_points: FloatArray = candidates[rng.permutation(len(candidates))[:count]]
    return chosen_points
