"""Layout of things off the roads and clear of each other, and landmarks on their surfaces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from filters.rotations import skew
from filters.validation import FloatArray
from stereo_slam_env.world.props import Placed
from stereo_slam_env.world.road import RoadNetwork
from stereo_slam_env.world.scene import Box, Cylinder, Primitive, Vector

Make = Callable[[Placed], list[Primitive]]
"""Builds a thing at a place."""


class Layout:
    """Puts things where there is room beside the roads of a network."""

    def __init__(self, network: RoadNetwork) -> None:
        self._network = network
        self.primitives: list[Primitive] = []
        self._footprints: list[Footprint] = []
        self._circles = np.zeros((64, 3))
        """Centre and radius of each footprint, with room for more."""

    def claim(
        self, xy: FloatArray, yaw: float, size: tuple[float, float], room: float, clearance: float, make: Make
    ) -> bool:
        """Build if the footprint is `clearance` m off every centreline and free; return whether it was."""
        wanted = Footprint(xy, yaw, size)
        cover = wanted.grid()
        if not self._network.clear(cover, clearance):
            return False
        for other in self._nearby(wanted, room):
            if other.contains(cover, room) or wanted.contains(other.xy[None], room):
                return False
        self._add(wanted)
        self.primitives += make(Placed(xy, yaw))
        return True

    def _add(self, footprint: Footprint) -> None:
        count = len(self._footprints)
        if count == len(self._circles):
            self._circles = np.concatenate([self._circles, np.zeros_like(self._circles)])
        self._circles[count] = (*footprint.xy, footprint.radius)
        self._footprints.append(footprint)

    def _nearby(self, wanted: Footprint, room: float) -> list[Footprint]:
        """The footprints whose circles come within `room` of the circle of the wanted one."""
        circles = self._circles[: len(self._footprints)]
        away = np.hypot(circles[:, 0] - wanted.xy[0], circles[:, 1] - wanted.xy[1])
        return [self._footprints[i] for i in np.flatnonzero(away < circles[:, 2] + wanted.radius + 2 * room)]


@dataclass(frozen=True, eq=False)
class Footprint:
    """A rectangle on the ground: centre (2,), yaw, size (length, width)."""

    xy: FloatArray
    yaw: float
    size: tuple[float, float]

    @cached_property
    def radius(self) -> float:
        """Radius of the circle around it, m."""
        return 0.5 * float(np.hypot(*self.size))

    @cached_property
    def _axes(self) -> FloatArray:
        cos, sin = np.cos(self.yaw), np.sin(self.yaw)
        return np.array([[cos, sin], [-sin, cos]])

    def grid(self) -> FloatArray:
        """Points that cover the rectangle, about 1.5 m apart; (N, 2)."""
        covering: FloatArray = _grid(self.size) @ self._axes + self.xy
        return covering

    def contains(self, points: FloatArray, room: float) -> bool:
        """Whether any point lies in the rectangle grown by `room` m."""
        x, y = self._axes @ (points - self.xy).T
        length, width = self.size
        return bool(((np.abs(x) < 0.5 * length + room) & (np.abs(y) < 0.5 * width + room)).any())


@lru_cache(64)
def _grid(size: tuple[float, float]) -> FloatArray:
    """Points about 1.5 m apart that cover a rectangle around the origin; (N, 2), read-only."""
    x, y = (s * np.linspace(-0.5, 0.5, max(3, int(s / 1.5))) for s in size)
    grid = np.stack([np.repeat(x, len(y)), np.tile(y, len(x))], axis=1)
    grid.flags.writeable = False
    return grid


def sample_surface(shape: Primitive, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Points uniform on the side (of balls: the whole) surface, m in S, and unit outward normals; (count, 3) each."""
    if isinstance(shape, Box):
        return _sample_box(shape, count, rng)
    if isinstance(shape, Cylinder):
        return _sample_cylinder(shape, count, rng)
    return _sample_sphere(shape.radius, shape.center, count, rng)


def facing_points(
    shapes: Sequence[Primitive],
    count: int,
    highest: float,
    nearest: Callable[[FloatArray], FloatArray],
    rng: np.random.Generator,
) -> FloatArray:
    """`count` points (fewer on few shapes) below `highest` m that face the road; `nearest` gives its nearest points."""
    if not shapes:
        return np.zeros((0, 3))
    weights = np.array([sampling_weight(shape) for shape in shapes])
    counts = np.ceil(6 * count * weights / weights.sum()).astype(int)
    samples = [sample_surface(shape, n, rng) for shape, n in zip(shapes, counts, strict=True)]
    points, normals = (np.concatenate(column) for column in zip(*samples, strict=True))
    toward = nearest(points[:, :2]) - points[:, :2]
    facing = (normals[:, :2] * toward).sum(axis=1) > 0.2 * np.linalg.norm(toward, axis=1)
    facing &= (points[:, 2] > 0.15) & (points[:, 2] < highest)
    candidates = points[facing]
    chosen: FloatArray = candidates[rng.permutation(len(candidates))[:count]]
    return chosen


def sampling_weight(shape: Primitive) -> float:
    """Share of the points for a shape, relative to others: the root of its side area, so that poles count too."""
    if isinstance(shape, Box):
        return float(np.sqrt(max(shape.size[:2]) * min(shape.size[2], 9.0)))
    if isinstance(shape, Cylinder):
        length = float(np.linalg.norm(np.subtract(shape.end, shape.start)))
        return float(np.sqrt(2 * shape.radius * length))
    return 2 * shape.radius


def _sample_box(shape: Box, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    length, width, _ = shape.size
    normal_axis = (rng.random(count) >= width / (length + width)).astype(int)
    sign = 2.0 * rng.integers(2, size=count) - 1.0
    local = rng.uniform(-0.5, 0.5, (count, 3))
    local[np.arange(count), normal_axis] = 0.5 * sign
    cos, sin = np.cos(shape.yaw), np.sin(shape.yaw)
    axes = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return local * shape.size @ axes + shape.center, sign[:, None] * axes[normal_axis]


def _sample_cylinder(shape: Cylinder, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    start, axis = np.array(shape.start), np.array(shape.end) - np.array(shape.start)
    unit = axis / np.linalg.norm(axis)
    across = skew(unit)
    side = across @ ([0.0, 0.0, 1.0] if abs(unit[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle = rng.uniform(0.0, 2 * np.pi, count)[:, None]
    normals = np.cos(angle) * side + np.sin(angle) * (across @ side)
    return start + rng.random((count, 1)) * axis + shape.radius * normals, normals


def _sample_sphere(
    radius: float, center: Vector, count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    normals = rng.standard_normal((count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return radius * normals + center, normals
