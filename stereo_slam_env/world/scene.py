"""Description of a scene, plain data from which any renderer or physics engine is built.

Everything is in the scene frame S (z up, see `world.frames`), metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from filters.validation import FloatArray, IntArray

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Material:
    """The look of a surface.

    Attributes
    ----------
    color : (3,) tuple
        RGB in 0..1; tints the texture.
    texture : str, optional
        Name in `world.textures.TEXTURES`; None for a plain colour.
    tile : (2,) tuple
        Size of one repeat of the texture, m (along, up).
    variant : int
        Which version of the texture, from 0 to `world.textures.VARIANTS` - 1.
    """

    color: Vector
    texture: str | None = None
    tile: tuple[float, float] = (1.0, 1.0)
    variant: int = 0


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


Primitive = Box | Cylinder | Sphere
_Shape = TypeVar("_Shape", bound=Primitive)


@dataclass(frozen=True, eq=False)
class Ribbon:
    """A flat strip along a road, only drawn: left and right edge (K, 3); the texture spans the width once."""

    left: FloatArray
    right: FloatArray
    material: Material


@dataclass(frozen=True)
class Ground:
    """The plane z = 0, drawn between the corners (x, y) `low` and `high`."""

    low: tuple[float, float]
    high: tuple[float, float]
    material: Material


@dataclass(frozen=True, eq=False)
class MovingBody:
    """A rigid thing ("car", "pedestrian") that moves on the ground.

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
    """A scene and the landmarks on its surfaces.

    Attributes
    ----------
    ground : Ground
        The plane everything stands on.
    primitives : tuple of Box, Cylinder or Sphere
        Everything that stands.
    ribbons : tuple of Ribbon
        Roads and pavements.
    landmark_points : (N, 3)
        On visible surfaces, m; the id of a landmark is its row.
    moving : tuple of MovingBody
        What moves; it carries no landmarks.
    look : Look
        Light and air.
    """

    ground: Ground
    primitives: tuple[Primitive, ...]
    ribbons: tuple[Ribbon, ...]
    landmark_points: FloatArray
    moving: tuple[MovingBody, ...] = ()
    look: Look = Look()

    @property
    def landmark_ids(self) -> IntArray:
        """Ids of the landmarks, ascending from 0; (N,) int64."""
        return np.arange(len(self.landmark_points), dtype=np.int64)

    @property
    def solids(self) -> tuple[Primitive, ...]:
        """The standing primitives that block rays and cars."""
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
