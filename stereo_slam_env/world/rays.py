"""Compiled occlusion: rays against the boxes, cylinders and balls of a scene, through a tree of bounding boxes.

The shapes are those that the physics engine has. Everything is in the scene frame S (z up), metres, in plain arrays, so
that kernels of many scenes can use it without Python's lock.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numba import njit

from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.world.scene import Box, Cylinder, Primitive

OPTIONS = {"error_model": "numpy", "nogil": True, "cache": True}
"""Of the compilation of all kernels of the simulation: IEEE arithmetic, in the order written."""
SURFACE_GAP = 0.05
"""A ray to a point on a surface stops this short of it, m, so that the surface itself does not hide it."""
_BOX, _CYLINDER, _BALL = 0.0, 1.0, 2.0
_SKIN = 5e-4
"""m by which curved shapes are larger: Bullet's iteration hits what passes so close."""
_COLUMNS = 9
_DEEPEST = 64


class Obstacles(NamedTuple):
    """Solids of a scene and the tree of bounding boxes over them."""

    solids: FloatArray
    """(N, 9): centre; of boxes half extents, cos and sin of the yaw; of cylinders the unit axis, radius and half length;
    of balls the radius in column 6; and the kind."""
    bounds: FloatArray
    """Low and high corners of the nodes, parents before children; (2 N - 1, 6)."""
    links: IntArray
    """The node to go on with where a ray misses, and the solid of a leaf, else -1; (2 N - 1, 2)."""


def obstacles(solids: Iterable[Primitive]) -> Obstacles:
    """Solids as arrays."""
    rows = np.array([_row(solid) for solid in solids]).reshape(-1, _COLUMNS)
    return Obstacles(rows, *tree(rows))


def visible(obstacles: Obstacles, cameras: FloatArray, points: FloatArray) -> BoolArray:
    """Which points (N, 3) on surfaces are seen from all `cameras` (C, 3); as `PhysicsWorld.visible`."""
    return np.asarray(_visible(*obstacles, cameras, points), dtype=np.bool_)


def _row(solid: Primitive) -> list[float]:
    if isinstance(solid, Box):
        half = [0.5 * side for side in solid.size]
        return [*solid.center, *half, math.cos(solid.yaw), math.sin(solid.yaw), _BOX]
    if isinstance(solid, Cylinder):
        axis = [b - a for a, b in zip(solid.start, solid.end, strict=True)]
        length = math.sqrt(sum(x * x for x in axis))
        middle = [0.5 * (a + b) for a, b in zip(solid.start, solid.end, strict=True)]
        return [*middle, *(x / length for x in axis), solid.radius, 0.5 * length, _CYLINDER]
    return [*solid.center, 0.0, 0.0, 0.0, solid.radius, 0.0, _BALL]


@njit(**OPTIONS)
def tree(solids: FloatArray) -> tuple[FloatArray, IntArray]:
    """`bounds` and `links` of the solids: halves by the middle of the longest side."""
    count = len(solids)
    own = np.empty((count, 6))
    for i in range(count):
        _bound(solids[i], own[i])
    nodes = max(2 * count - 1, 0)
    bounds, links = np.empty((nodes, 6)), np.empty((nodes, 2), dtype=np.int64)
    order = np.arange(count)
    firsts, lasts = np.empty(_DEEPEST, dtype=np.int64), np.empty(_DEEPEST, dtype=np.int64)
    firsts[0], lasts[0] = 0, count
    waiting, node = min(count, 1), 0
    while waiting > 0:
        waiting -= 1
        first, last = firsts[waiting], lasts[waiting]
        for k in range(3):
            low, high = np.inf, -np.inf
            for i in order[first:last]:
                low, high = min(low, own[i, k]), max(high, own[i, 3 + k])
            bounds[node, k], bounds[node, 3 + k] = low, high
        size = last - first
        links[node, 0], links[node, 1] = node + 2 * size - 1, order[first] if size == 1 else -1
        if size > 1:
            k = 0
            for other in range(1, 3):
                if bounds[node, 3 + other] - bounds[node, other] > bounds[node, 3 + k] - bounds[node, k]:
                    k = other
            part = order[first:last].copy()
            order[first:last] = part[np.argsort(solids[part, k])]
            middle = first + size // 2
            firsts[waiting], lasts[waiting] = middle, last
            firsts[waiting + 1], lasts[waiting + 1] = first, middle
            waiting += 2
        node += 1
    return bounds, links


@njit(**OPTIONS)
def _bound(solid: FloatArray, bound: FloatArray) -> None:
    """Low and high corner of the box around a solid."""
    for k in range(3):
        if solid[8] == _BOX:
            reach = solid[5]
            if k == 0:
                reach = abs(solid[6]) * solid[3] + abs(solid[7]) * solid[4]
            elif k == 1:
                reach = abs(solid[7]) * solid[3] + abs(solid[6]) * solid[4]
        elif solid[8] == _CYLINDER:
            axis = solid[3 + k]
            reach = abs(axis) * solid[7] + solid[6] * math.sqrt(max(0.0, 1.0 - axis * axis))
        else:
            reach = solid[6]
        bound[k], bound[3 + k] = solid[k] - reach - 2 * _SKIN, solid[k] + reach + 2 * _SKIN


@njit(**OPTIONS)
def _hits_box(solid: FloatArray, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> bool:
    x, y, z = x - solid[0], y - solid[1], z - solid[2]
    cos, sin = solid[6], solid[7]
    x, y, dx, dy = cos * x + sin * y, cos * y - sin * x, cos * dx + sin * dy, cos * dy - sin * dx
    enters, leaves = -np.inf, 1.0
    for at, along, half in ((x, dx, solid[3]), (y, dy, solid[4]), (z, dz, solid[5])):
        if along == 0.0:
            if abs(at) > half:
                return False
            continue
        first, last = (-half - at) / along, (half - at) / along
        enters, leaves = max(enters, min(first, last)), min(leaves, max(first, last))
    return 0.0 < enters <= leaves


@njit(**OPTIONS)
def _hits_ball(solid: FloatArray, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> bool:
    x, y, z, radius = x - solid[0], y - solid[1], z - solid[2], solid[6] + _SKIN
    outside = x * x + y * y + z * z - radius * radius
    if outside <= 0.0:
        return False
    square, toward = dx * dx + dy * dy + dz * dz, x * dx + y * dy + z * dz
    root = toward * toward - square * outside
    return toward < 0.0 and root >= 0.0 and -toward - math.sqrt(root) <= square


@njit(**OPTIONS)
def _hits_cylinder(solid: FloatArray, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> bool:
    x, y, z = x - solid[0], y - solid[1], z - solid[2]
    ax, ay, az = solid[3], solid[4], solid[5]
    radius, half = solid[6] + _SKIN, solid[7]
    up, rise = ax * x + ay * y + az * z, ax * dx + ay * dy + az * dz
    px, py, pz = x - up * ax, y - up * ay, z - up * az
    qx, qy, qz = dx - rise * ax, dy - rise * ay, dz - rise * az
    square, toward = qx * qx + qy * qy + qz * qz, px * qx + py * qy + pz * qz
    outside = px * px + py * py + pz * pz - radius * radius
    enters, leaves = 0.0, 1.0
    if outside <= 0.0 and abs(up) <= half:
        return False
    if square > 0.0:
        root = toward * toward - square * outside
        if root < 0.0:
            return False
        root = math.sqrt(root)
        enters, leaves = max(enters, (-toward - root) / square), min(leaves, (root - toward) / square)
    elif outside > 0.0:
        return False
    if rise == 0.0:
        if abs(up) > half:
            return False
    else:
        first, last = (-half - up) / rise, (half - up) / rise
        enters, leaves = max(enters, min(first, last)), min(leaves, max(first, last))
    return enters <= leaves


@njit(**OPTIONS)
def is_blocked(
    solids: FloatArray,
    bounds: FloatArray,
    links: IntArray,
    nodes: int,
    x: float,
    y: float,
    z: float,
    dx: float,
    dy: float,
    dz: float,
) -> bool:
    """Whether the way from (x, y, z) by (dx, dy, dz) is through a solid or the ground; none hides what it contains."""
    if z + dz <= 0.0 < z:
        return True
    ix = 1.0 / dx if dx != 0.0 else 1e300
    iy = 1.0 / dy if dy != 0.0 else 1e300
    iz = 1.0 / dz if dz != 0.0 else 1e300
    node = 0
    while node < nodes:
        box = bounds[node]
        ax, bx = (box[0] - x) * ix, (box[3] - x) * ix
        ay, by = (box[1] - y) * iy, (box[4] - y) * iy
        az, bz = (box[2] - z) * iz, (box[5] - z) * iz
        enters = max(max(min(ax, bx), min(ay, by)), max(min(az, bz), 0.0))
        leaves = min(min(max(ax, bx), max(ay, by)), min(max(az, bz), 1.0))
        if enters > leaves:
            node = links[node, 0]
            continue
        if links[node, 1] >= 0:
            solid = solids[links[node, 1]]
            if solid[8] == _BOX:
                if _hits_box(solid, x, y, z, dx, dy, dz):
                    return True
            elif solid[8] == _CYLINDER:
                if _hits_cylinder(solid, x, y, z, dx, dy, dz):
                    return True
            elif _hits_ball(solid, x, y, z, dx, dy, dz):
                return True
        node += 1
    return False


@njit(**OPTIONS)
def is_seen(
    solids: FloatArray, bounds: FloatArray, links: IntArray, nodes: int, camera: FloatArray, point: FloatArray
) -> bool:
    """Whether nothing is between a camera and a point on a surface, (3,) each."""
    dx, dy, dz = point[0] - camera[0], point[1] - camera[1], point[2] - camera[2]
    share = 1.0 - SURFACE_GAP / math.sqrt(dx * dx + dy * dy + dz * dz)
    return not is_blocked(
        solids, bounds, links, nodes, camera[0], camera[1], camera[2], share * dx, share * dy, share * dz
    )


@njit(**OPTIONS)
def _visible(
    solids: FloatArray, bounds: FloatArray, links: IntArray, cameras: FloatArray, points: FloatArray
) -> BoolArray:
    seen = np.ones(len(points), dtype=np.bool_)
    for i in range(len(points)):
        for camera in cameras:
            seen[i] = seen[i] and is_seen(solids, bounds, links, len(bounds), camera, points[i])
    return seen
