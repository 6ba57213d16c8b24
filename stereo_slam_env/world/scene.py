"""What is in a scene: a plain description that any renderer or physics engine can be built from.

Everything is in the scene frame S (z up, see `world.frames`), metres.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    """

    color: Vector
    texture: str | None = None
    tile: tuple[float, float] = (1.0, 1.0)


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
class Scene:
    """A static scene and the landmarks on its surfaces.

    Attributes
    ----------
    ground : Ground
        The plane everything stands on.
    primitives : tuple of Box, Cylinder or Sphere
        Everything that stands.
    ribbons : tuple of Ribbon
        Roads and pavements.
    landmark_ids : (N,) int64
        Ascending.
    landmark_points : (N, 3)
        On visible surfaces, m.
    """

    ground: Ground
    primitives: tuple[Primitive, ...]
    ribbons: tuple[Ribbon, ...]
    landmark_ids: IntArray
    landmark_points: FloatArray

    @property
    def solids(self) -> tuple[Primitive, ...]:
        """The primitives that block rays and cars."""
        return tuple(p for p in self.primitives if p.solid)
