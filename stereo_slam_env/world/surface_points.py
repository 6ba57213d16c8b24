"""Points sampled on the surfaces of primitives: where landmarks come from."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from filters.rotations import skew
from filters.validation import FloatArray
from stereo_slam_env.world.scene import Box, Cylinder, Primitive, Vector


def sample_surface(shape: Primitive, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Points uniform on the side (and, for balls, the whole) surface, and the outward normals there.

    Returns
    -------
    points, normals : (count, 3) ndarray
        m in S; unit.
    """
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
    """How many points a shape deserves, relative to others: the root of its side area, so that poles count too."""
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
