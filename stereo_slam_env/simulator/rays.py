"""Compiled occlusion: rays against the solids of a scene, through a tree of bounding boxes.

The shapes are those that the physics engine has. Everything is in the scene frame S (z up), metres, in plain arrays, so
that kernels of many scenes can use it without Python's lock.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.rotations import Three
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.world.instructions import entered_boxes, lowest_bit
from stereo_slam_env.world.scene import BOX, CYLINDER, Primitive, ShapeTable, TriangleMesh, table_of

SURFACE_GAP = 0.05
"""A ray to a point on a surface stops this short of it, m, so that the surface itself does not hide it."""
TRIANGLE = 3.0
"""Kind of a row beside `BOX`, `CYLINDER` and `BALL`."""
_SKIN_OF_BALLS, _SKIN_OF_CYLINDERS = 5e-4, 2e-4
"""m by which curved shapes are larger: Bullet finds a hit by iteration, of some of what passes within a millimetre."""
_MARGIN = 2e-3
"""m by which the boxes of the tree are larger: skins, and numbers of single precision."""
_FAR_AWAY = 1e30
COLUMNS = 10
KIND = 9
"""Columns of a solid, and which of them is its kind."""
_DEEPEST = 16
NOTHING = 2**31
"""Link of a branch that leads nowhere."""


class Obstacles(NamedTuple):
    """Solids of a scene and the tree of bounding boxes over them."""

    solids: FloatArray
    """(N, 10): centre; of boxes half extents, cos and sin of the yaw; of cylinders the unit axis, radius, half length;
    of balls the radius in column 6; of triangles a corner and the edges to the others; and the kind, in column 9."""
    bounds: NDArray[np.float32]
    """Low corners (x, y, z), then high ones, of the up to eight branches of each node; (M, 6, 8)."""
    links: IntArray
    """What a branch leads to: a node, or solid i as -1 - i; `NOTHING`; (M, 8)."""


def obstacles(solids: Iterable[Primitive]) -> Obstacles:
    """Solids as arrays."""
    rows = solid_rows(solids)
    return Obstacles(rows, *tree(rows))


def solid_rows(solids: Iterable[Primitive]) -> FloatArray:
    """A row of `Obstacles.solids` for each solid, or for each triangle of a mesh; (N, 10)."""
    if isinstance(solids, ShapeTable):
        return np.asarray(_converted(solids.table))
    runs = [np.zeros((0, COLUMNS))]
    for solid, run in groupby(solids, lambda solid: solid if isinstance(solid, TriangleMesh) else None):
        if isinstance(solid, TriangleMesh):
            runs.append(np.pad(solid.corners_and_edges, ((0, 0), (0, 1)), constant_values=TRIANGLE))
        else:
            runs.append(_converted(table_of(list(run))))
    return np.concatenate(runs)


def visible(obstacles: Obstacles, cameras: FloatArray, points: FloatArray) -> BoolArray:
    """Mask of points (N, 3) on surfaces that are seen from one camera or two (C, 3); as `PhysicsWorld.visible`."""
    return np.asarray(_visible(obstacles, traversal(), cameras[[0, -1]], points), dtype=np.bool_)


def traversal() -> IntArray:
    """Room for a walk through a tree, which each thread needs for itself."""
    return np.zeros(8 * _DEEPEST, dtype=np.int64)


@entry
def _converted(table: FloatArray) -> FloatArray:
    """Rows of `Obstacles.solids` from those of `scene.table_of`."""
    rows = np.zeros((len(table), COLUMNS))
    for shape, row in zip(table, rows):  # noqa: B905 (Numba knows no `strict`)
        row[KIND] = shape[0]
        row[:3] = shape[1:4]
        if shape[0] == BOX:
            row[3:6] = 0.5 * shape[4:7]
            row[6], row[7] = math.cos(shape[7]), math.sin(shape[7])
        elif shape[0] == CYLINDER:
            axis = shape[4:7] - shape[1:4]
            length = math.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
            row[:3] = 0.5 * (shape[1:4] + shape[4:7])
            row[3:6] = axis / length
            row[6], row[7] = shape[7], 0.5 * length
        else:
            row[6] = shape[4]
    return rows


@entry
def tree(solids: FloatArray) -> tuple[NDArray[np.float32], IntArray]:
    """`bounds` and `links` of the solids: each node is three times divided, across its longest side."""
    count = len(solids)
    own_boxes = np.empty((count, 6))
    for i in range(count):
        _bound(solids[i], own_boxes[i])
    bounds = np.zeros((max(count, 1), 6, 8), dtype=np.float32)
    links = np.full((max(count, 1), 8), NOTHING)
    order = np.arange(count)
    ranges = np.zeros((max(count, 1), 2), dtype=np.int64)  # of `order`, for each node
    ranges[0, 1] = count
    nodes = 1 if count else 0
    parts = np.empty((8, 2), dtype=np.int64)
    node = 0
    while node < nodes:
        parts[0] = ranges[node]
        solids_below = 1  # solids below a full branch
        while 8 * solids_below < parts[0, 1] - parts[0, 0]:
            solids_below *= 8
        number = 1
        for _ in range(3):
            for k in range(number):
                first, last = parts[k]
                middle = _halved(own_boxes, order, first, last, solids_below)
                parts[k, 1], parts[number + k, 0], parts[number + k, 1] = middle, middle, last
            number *= 2
        for k in range(8):
            first, last = parts[k]
            for axis in range(3):
                low, high = np.inf, -np.inf
                for i in order[first:last]:
                    low, high = min(low, own_boxes[i, axis]), max(high, own_boxes[i, 3 + axis])
                if last == first:  # no branch: a box that no ray comes to
                    low, high = _FAR_AWAY, _FAR_AWAY
                bounds[node, axis, k], bounds[node, 3 + axis, k] = low, high
            if last - first == 1:
                links[node, k] = -1 - order[first]
            elif last > first:
                links[node, k], ranges[nodes, 0], ranges[nodes, 1] = nodes, first, last
                nodes += 1
        node += 1
    return bounds[:nodes].copy(), links[:nodes].copy()


@kernel
def _halved(own: FloatArray, order: IntArray, first: int, last: int, whole: int) -> int:
    """Sort a range by the middles along its longest side; the place between its halves, which are full branches."""
    branches = -(-(last - first) // whole)
    if branches < 2:
        return last
    longest, axis = -1.0, 0
    for k in range(3):
        low, high = np.inf, -np.inf
        for i in order[first:last]:
            low, high = min(low, own[i, k]), max(high, own[i, 3 + k])
        if high - low > longest:
            longest, axis = high - low, k
    _sort(own, order[first:last], axis)
    return first + whole * ((branches + 1) // 2)


@kernel
def _sort(own: FloatArray, order: IntArray, axis: int) -> None:
    """Sort by the middles along an axis: a heap sort, because `np.argsort` takes four seconds to compile."""
    start, end = len(order) // 2, len(order)
    while end > 1:
        if start > 0:
            start -= 1
        else:
            end -= 1
            order[0], order[end] = order[end], order[0]
        parent = start
        while 2 * parent + 1 < end:
            child = 2 * parent + 1
            a, b = order[child], order[min(child + 1, end - 1)]
            if own[b, axis] + own[b, 3 + axis] > own[a, axis] + own[a, 3 + axis]:
                child, a = child + 1, b
            p = order[parent]
            if own[p, axis] + own[p, 3 + axis] >= own[a, axis] + own[a, 3 + axis]:
                break
            order[parent], order[child] = a, p
            parent = child


@entry
def _bound(solid: FloatArray, bound: FloatArray) -> None:
    """Low and high corner of the box around a solid."""
    for k in range(3):
        if solid[KIND] == TRIANGLE:
            ends = min(0.0, solid[3 + k], solid[6 + k]), max(0.0, solid[3 + k], solid[6 + k])
            bound[k], bound[3 + k] = solid[k] + ends[0] - _MARGIN, solid[k] + ends[1] + _MARGIN
            continue
        if solid[KIND] == BOX:
            reach = solid[5]
            if k == 0:
                reach = abs(solid[6]) * solid[3] + abs(solid[7]) * solid[4]
            elif k == 1:
                reach = abs(solid[7]) * solid[3] + abs(solid[6]) * solid[4]
        elif solid[KIND] == CYLINDER:
            axis = solid[3 + k]
            reach = abs(axis) * solid[7] + solid[6] * math.sqrt(max(0.0, 1.0 - axis * axis))
        else:
            reach = solid[6]
        bound[k], bound[3 + k] = solid[k] - reach - _MARGIN, solid[k] + reach + _MARGIN


@entry
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


@entry
def _hits_ball(solid: FloatArray, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> bool:
    x, y, z, radius = x - solid[0], y - solid[1], z - solid[2], solid[6] + _SKIN_OF_BALLS
    outside = x * x + y * y + z * z - radius * radius
    if outside <= 0.0:
        return False
    square, toward = dx * dx + dy * dy + dz * dz, x * dx + y * dy + z * dz
    root = toward * toward - square * outside
    return toward < 0.0 and root >= 0.0 and -toward - math.sqrt(root) <= square


@entry
def _hits_cylinder(solid: FloatArray, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> bool:
    x, y, z = x - solid[0], y - solid[1], z - solid[2]
    ax, ay, az = solid[3], solid[4], solid[5]
    radius, half = solid[6] + _SKIN_OF_CYLINDERS, solid[7]
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


@entry
def _hits_triangle(solid: FloatArray, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> bool:
    """Intersect by Moeller and Trumbore, from either side."""
    ax, ay, az, bx, by, bz = solid[3], solid[4], solid[5], solid[6], solid[7], solid[8]
    px, py, pz = dy * bz - dz * by, dz * bx - dx * bz, dx * by - dy * bx
    volume = ax * px + ay * py + az * pz
    if volume == 0.0:
        return False
    x, y, z = x - solid[0], y - solid[1], z - solid[2]
    first = (x * px + y * py + z * pz) / volume
    qx, qy, qz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    second, along = (dx * qx + dy * qy + dz * qz) / volume, (bx * qx + by * qy + bz * qz) / volume
    return first >= 0.0 and second >= 0.0 and first + second <= 1.0 and 0.0 < along <= 1.0


@kernel
def _inverse(x: float) -> np.float32:
    return np.float32(1.0 / x) if abs(x) > 1e-12 else np.float32(1e12)


@kernel
def hits(solid: FloatArray, at: Three, way: Three) -> bool:
    """Whether a ray hits a solid."""
    if solid[KIND] == BOX:
        return _hits_box(solid, at[0], at[1], at[2], way[0], way[1], way[2])
    if solid[KIND] == CYLINDER:
        return _hits_cylinder(solid, at[0], at[1], at[2], way[0], way[1], way[2])
    if solid[KIND] == TRIANGLE:
        return _hits_triangle(solid, at[0], at[1], at[2], way[0], way[1], way[2])
    return _hits_ball(solid, at[0], at[1], at[2], way[0], way[1], way[2])


@kernel
def way_to(at: Three, to: Three) -> Three:
    """Ray from a camera to just before a point."""
    dx, dy, dz = to[0] - at[0], to[1] - at[1], to[2] - at[2]
    share = 1.0 - SURFACE_GAP / math.sqrt(dx * dx + dy * dy + dz * dz)
    return share * dx, share * dy, share * dz


@kernel
def is_seen(
    solids: FloatArray,
    bounds: NDArray[np.float32],
    links: IntArray,
    nodes: int,
    waiting: IntArray,
    left: Three,
    right: Three,
    to: Three,
) -> bool:
    """Whether nothing, the ground included, is between two cameras and a point on a surface; `waiting` is room."""
    ways = way_to(left, to), way_to(right, to)
    for k in range(2):
        z = (left, right)[k][2]
        if z + ways[k][2] <= 0.0 < z:
            return False
    starts = (
        *(np.float32(left[0]), np.float32(left[1]), np.float32(left[2])),
        *(np.float32(right[0]), np.float32(right[1]), np.float32(right[2])),
    )
    a, b = ways
    inverses = (_inverse(a[0]), _inverse(a[1]), _inverse(a[2]), _inverse(b[0]), _inverse(b[1]), _inverse(b[2]))
    waiting[0] = 0
    count = min(nodes, 1)
    while count > 0:
        count -= 1
        node = waiting[count]
        both = entered_boxes(bounds, node, starts, inverses)
        bits = (both | both >> 8) & 255
        while bits != 0:
            branch = lowest_bit(bits)
            link = links[node, branch]
            bits &= bits - 1
            if link >= 0:
                waiting[count] = link
                count += 1
            else:
                solid = solids[-1 - link]
                if (both >> branch) & 1 and hits(solid, left, a):
                    return False
                if (both >> (8 + branch)) & 1 and hits(solid, right, b):
                    return False
    return True


@entry
def _visible(obstacles: Obstacles, waiting: IntArray, cameras: FloatArray, points: FloatArray) -> BoolArray:
    solids, bounds, links = obstacles
    is_visible_point = np.ones(len(points), dtype=np.bool_)
    left, right = (cameras[0, 0], cameras[0, 1], cameras[0, 2]), (cameras[1, 0], cameras[1, 1], cameras[1, 2])
    for i in range(len(points)):
        to = (points[i, 0], points[i, 1], points[i, 2])
        is_visible_point[i] = is_seen(solids, bounds, links, len(bounds), waiting, left, right, to)
    return is_visible_point
