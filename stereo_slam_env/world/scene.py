"""Description of a scene, plain data from which any renderer or physics engine is built.

Everything is in the scene frame S (z up, see `world.frames`), metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import compress
from typing import Any, TypeVar, overload

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """The look of a surface."""

    color: Vector
    """RGB in 0..1; tints the texture."""
    texture: str | None = None
    """Name in `world.textures.TEXTURES`; None for a plain colour."""
    tile: tuple[float, float] = (1.0, 1.0)
    """Size of one repeat of the texture, m (along, up)."""
    variant: int = 0
    """Which version of the texture, from 0 to `world.textures.VARIANTS` - 1."""


@dataclass(frozen=True)
class Box:
    """An upright box: centre, size along its own axes (length, width, height), yaw about z in rad.

    A solid blocks rays and cars; the rest is decoration that is only drawn.
    """

    center: Vector
    size: Vector
    yaw: float
    material: Material
    solid: bool = True


@dataclass(frozen=True)
class Cylinder:
    """A cylinder between the centres of its two end faces."""

    start: Vector
    end: Vector
    radius: float
    material: Material
    solid: bool = True


@dataclass(frozen=True)
class Sphere:
    """A ball."""

    center: Vector
    radius: float
    material: Material
    solid: bool = True


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """Triangles (T, 3) of vertices (V, 3), m, counter-clockwise from outside; its surface blocks, not what it holds."""

    vertices: FloatArray
    triangles: IntArray
    material: Material
    solid: bool = True

    @property
    def corners_and_edges(self) -> FloatArray:
        """Triangles, each as a corner and the edges to the others, (T, 9)."""
        corners = self.vertices[self.triangles]
        return np.concatenate([corners[:, 0], (corners[:, 1:] - corners[:, :1]).reshape(-1, 6)], axis=1)


Primitive = Box | Cylinder | Sphere | TriangleMesh
_Shape = TypeVar("_Shape", bound=Primitive)
BOX, CYLINDER, BALL = 0.0, 1.0, 2.0
"""Kinds of primitives: the first column of their table, see `table_of`."""
TABLE_COLUMNS = 8


class ShapeTable(Sequence[Primitive]):
    """Primitives by their numbers; each is made when somebody looks at it.

    Parameters
    ----------
    table : (N, 8)
        See `table_of`.
    solid : (N,)
        Which are solid.
    materials : callable
        Their materials, in order.
    """

    def __init__(self, table: FloatArray, solid: BoolArray, materials: Callable[[], Sequence[Material]]) -> None:
        self.table, self.solid, self._materials = table, solid, materials

    def __len__(self) -> int:
        return len(self.table)

    @overload
    def __getitem__(self, index: int) -> Primitive: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Primitive, ...]: ...
    def __getitem__(self, index: int | slice) -> Primitive | tuple[Primitive, ...]:
        return self._made[index]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and tuple(self) == tuple(other)

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def solids(self) -> ShapeTable:
        """Solid bodies."""
        return self.where(self.solid)

    def where(self, mask: BoolArray) -> ShapeTable:
        """Some of them; `mask` is (N,)."""
        return ShapeTable(self.table[mask], self.solid[mask], partial(_some, self._materials, mask))

    @cached_property
    def _made(self) -> tuple[Primitive, ...]:
        rows = zip(self.table.tolist(), self._materials(), self.solid.tolist(), strict=True)
        return tuple(_primitive(*row) for row in rows)


def table_of(shapes: Sequence[Primitive]) -> FloatArray:
    """A row for each shape, which is no mesh; (N, 8).

    It is the kind and: centre, size, yaw of a box; start, end, radius of a cylinder; centre, radius of a ball.
    """
    if isinstance(shapes, ShapeTable):
        return shapes.table
    rows: list[tuple[float, ...]] = []
    for shape in shapes:
        if isinstance(shape, Box):
            rows.append((BOX, *shape.center, *shape.size, shape.yaw))
        elif isinstance(shape, Cylinder):
            rows.append((CYLINDER, *shape.start, *shape.end, shape.radius))
        elif isinstance(shape, TriangleMesh):
            raise ValueError("landmarks are not drawn on a TriangleMesh: give the scene landmark_points on it yourself")
        else:
            rows.append((BALL, *shape.center, shape.radius, 0.0, 0.0, 0.0))
    return np.array(rows, dtype=np.float64).reshape(-1, TABLE_COLUMNS)


def _some(materials: Callable[[], Sequence[Material]], mask: BoolArray) -> list[Material]:
    return list(compress(materials(), mask))


def _primitive(row: Sequence[float], material: Material, solid: bool) -> Primitive:
    kind, x, y, z, a, b, c, d = row
    if kind == BOX:
        return Box((x, y, z), (a, b, c), d, material, solid)
    if kind == CYLINDER:
        return Cylinder((x, y, z), (a, b, c), d, material, solid)
    return Sphere((x, y, z), a, material, solid)


@dataclass(frozen=True, eq=False)
class Ribbon:
    """A flat strip along a road, only drawn: left and right edge (K, 3); the texture spans the width once."""

    left: FloatArray
    right: FloatArray
    material: Material


class Ribbons(Sequence[Ribbon]):
    """Strips that are made when somebody looks at them, by `make`."""

    def __init__(self, make: Callable[[], Sequence[Ribbon]]) -> None:
        self._make = make

    def __len__(self) -> int:
        return len(self._made)

    @overload
    def __getitem__(self, index: int) -> Ribbon: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Ribbon]: ...
    def __getitem__(self, index: int | slice) -> Ribbon | Sequence[Ribbon]:
        return self._made[index]

    @cached_property
    def _made(self) -> Sequence[Ribbon]:
        return self._make()


@dataclass(frozen=True)
class Ground:
    """The plane z = 0, drawn between the corners (x, y) `low` and `high`."""

    low: tuple[float, float]
    high: tuple[float, float]
    material: Material


@dataclass(frozen=True, eq=False)
class MovingBody:
    """A rigid thing ("car", "pedestrian", "bus") that moves on the ground.

    Its parts are in its own frame (x forward, y left, z up, origin on the ground), which at `times` (K,), s,
    increasing, is at `positions` (K, 3) of S, m, and turned by `yaws` (K,) about z, rad, without jumps.
    """

    kind: str
    parts: tuple[Primitive, ...]
    times: FloatArray
    positions: FloatArray
    yaws: FloatArray

    def pose_at(self, time: float) -> tuple[FloatArray, float]:
        """Position (3,) in S and yaw at `time` s: linear in between, at rest before and after."""
        position = np.array([np.interp(time, self.times, self.positions[:, i]) for i in range(3)])
        return position, float(np.interp(time, self.times, self.yaws))


@dataclass(frozen=True)
class Look:
    """Light and air, the same for every renderer.

    `sun` is the direction towards it in S; brightness is `ambient` + `diffuse` * max(0, normal . sun). The sky has the
    colours `horizon`, also that of the haze, and `zenith`, RGB in 0..255. After `haze_range`, m, 1/e of the contrast is
    left.
    """

    sun: Vector = (0.35, 0.55, 0.9)
    ambient: float = 0.72
    diffuse: float = 0.45
    horizon: Vector = (219.0, 228.0, 236.0)
    zenith: Vector = (112.0, 160.0, 212.0)
    haze_range: float = 260.0


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene and the landmarks on its surfaces."""

    ground: Ground
    """The plane everything stands on."""
    primitives: Sequence[Primitive]
    """Everything that stands."""
    ribbons: Sequence[Ribbon]
    """Roads and pavements."""
    landmark_points: FloatArray
    """(N, 3), on visible surfaces, m; the id of a landmark is its row."""
    moving: tuple[MovingBody, ...] = ()
    """Bodies that move, which `landmark_points` are not on."""
    look: Look = Look()
    """Light and air."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Scene:
        return self  # nobody changes it

    @property
    def solids(self) -> Sequence[Primitive]:
        """The standing primitives that block rays and cars."""
        if isinstance(self.primitives, ShapeTable):
            return self.primitives.solids
        return tuple(p for p in self.primitives if p.solid)

    def repainted(self, paint: Callable[[Material], Material]) -> Scene:
        """The scene with other materials; shapes, landmarks, light and air stay.

        Parameters
        ----------
        paint : callable
            The new material for an old one; called once for each, in the same order every time.
        """
        painted: dict[Material, Material] = {}

        def other(material: Material) -> Material:
            if material not in painted:
                painted[material] = paint(material)
            return painted[material]

        def part(shape: _Shape) -> _Shape:
            return replace(shape, material=other(shape.material))

        return replace(
            self,
            ground=replace(self.ground, material=other(self.ground.material)),
            ribbons=tuple(replace(ribbon, material=other(ribbon.material)) for ribbon in self.ribbons),
            primitives=tuple(part(p) for p in self.primitives),
            moving=tuple(replace(body, parts=tuple(part(p) for p in body.parts)) for body in self.moving),
        )
