"""Compiled collisions: whether a box at any pose touches the solids of a scene, by GJK.

Two convex shapes touch where their Minkowski difference contains the origin. The algorithm of Gilbert, Johnson and
Keerthi (IEEE J. Robotics and Automation 4(2), 1988) walks towards it by simplices of its farthest points, each time
nearer, until a plane separates them. Everything is in the scene frame S, metres.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.rotations import Nine, Three
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.simulator.rays import KIND, NOTHING, TRIANGLE, Obstacles, traversal
from stereo_slam_env.world.scene import BOX, CYLINDER


def touching(obstacles: Obstacles, half: Three, positions: FloatArray, rotations: FloatArray) -> BoolArray:
    """Whether a box with half sides `half` touches a solid, at each position (N, 3) and rotation (N, 3, 3)."""
    is_touched = np.zeros(len(positions), dtype=np.bool_)
    _touching(obstacles, traversal(), half, positions, rotations.reshape(-1, 9), is_touched)
    return is_touched


_ROUNDS = 48
_TOUCH = 1e-18
"""Squares of lengths below this are zero, m^2."""


@kernel
def _farthest(solid: FloatArray, x: float, y: float, z: float) -> Three:
    """The farthest point of a solid in a direction."""
    cx, cy, cz = solid[0], solid[1], solid[2]
    if solid[KIND] == BOX:
        cos, sin = solid[6], solid[7]
        a = math.copysign(solid[3], cos * x + sin * y)
        b = math.copysign(solid[4], cos * y - sin * x)
        return cx + cos * a - sin * b, cy + sin * a + cos * b, cz + math.copysign(solid[5], z)
    if solid[KIND] == CYLINDER:
        ax, ay, az, radius, half = solid[3], solid[4], solid[5], solid[6], solid[7]
        up = ax * x + ay * y + az * z
        half = math.copysign(half, up)
        x, y, z = x - up * ax, y - up * ay, z - up * az
        length = math.sqrt(x * x + y * y + z * z)
        scale = radius / length if length > 1e-12 else 0.0
        return cx + half * ax + scale * x, cy + half * ay + scale * y, cz + half * az + scale * z
    if solid[KIND] == TRIANGLE:
        first, second = solid[3] * x + solid[4] * y + solid[5] * z, solid[6] * x + solid[7] * y + solid[8] * z
        if first > max(second, 0.0):
            return cx + solid[3], cy + solid[4], cz + solid[5]
        if second > 0.0:
            return cx + solid[6], cy + solid[7], cz + solid[8]
        return cx, cy, cz
    scale = solid[6] / math.sqrt(x * x + y * y + z * z)
    return cx + scale * x, cy + scale * y, cz + scale * z


@kernel
def _difference(solid: FloatArray, R: Nine, at: Three, half: Three, x: float, y: float, z: float) -> Three:
    """The farthest point of the Minkowski difference, solid minus box, in a direction."""
    sx, sy, sz = _farthest(solid, x, y, z)
    a = math.copysign(half[0], -(R[0] * x + R[3] * y + R[6] * z))
    b = math.copysign(half[1], -(R[1] * x + R[4] * y + R[7] * z))
    c = math.copysign(half[2], -(R[2] * x + R[5] * y + R[8] * z))
    return (
        sx - at[0] - (R[0] * a + R[1] * b + R[2] * c),
        sy - at[1] - (R[3] * a + R[4] * b + R[5] * c),
        sz - at[2] - (R[6] * a + R[7] * b + R[8] * c),
    )


@kernel
def _dot(a: Three, b: Three) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _cross(a: Three, b: Three) -> Three:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def _minus(a: Three, b: Three) -> Three:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def _nearest_of_edge(p: FloatArray, a: int, b: int) -> tuple[Three, int]:
    """The point of an edge of the simplex that is nearest to the origin, and the corners it hangs on, as bits."""
    at = (p[a, 0], p[a, 1], p[a, 2])
    along = (p[b, 0] - at[0], p[b, 1] - at[1], p[b, 2] - at[2])
    share, square = -_dot(at, along), _dot(along, along)
    if share <= 0.0:
        return at, 1 << a
    if share >= square:
        return (p[b, 0], p[b, 1], p[b, 2]), 1 << b
    share /= square
    return (at[0] + share * along[0], at[1] + share * along[1], at[2] + share * along[2]), 1 << a | 1 << b


@kernel
def _nearest_of_face(p: FloatArray, a: int, b: int, c: int) -> tuple[Three, int]:
    """The same of a triangle."""
    first, second, third = (p[a, 0], p[a, 1], p[a, 2]), (p[b, 0], p[b, 1], p[b, 2]), (p[c, 0], p[c, 1], p[c, 2])
    normal = _cross(_minus(second, first), _minus(third, first))
    square = _dot(normal, normal)
    # Barycentric coordinates of the foot of the origin, times the square.
    u, v = _dot(_cross(second, third), normal), _dot(_cross(third, first), normal)
    w = _dot(_cross(first, second), normal)
    if square > 0.0 and u > 0.0 and v > 0.0 and w > 0.0:
        share = _dot(first, normal) / square
        return (share * normal[0], share * normal[1], share * normal[2]), 1 << a | 1 << b | 1 << c
    best, bits = _nearest_of_edge(p, a, b)
    for other in (_nearest_of_edge(p, b, c), _nearest_of_edge(p, c, a)):
        if _dot(other[0], other[0]) < _dot(best, best):
            best, bits = other
    return best, bits


@kernel
def _nearest(p: FloatArray, count: int) -> tuple[Three, int]:
    """The same of the whole simplex; all four corners where it holds the origin."""
    if count == 1:
        return (p[0, 0], p[0, 1], p[0, 2]), 1
    if count == 2:
        return _nearest_of_edge(p, 0, 1)
    if count == 3:
        return _nearest_of_face(p, 0, 1, 2)
    best, bits, least = (0.0, 0.0, 0.0), 15, np.inf
    for a, b, c, d in ((0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2), (1, 3, 2, 0)):
        corner, opposite = (p[a, 0], p[a, 1], p[a, 2]), (p[d, 0], p[d, 1], p[d, 2])
        one, other = (p[b, 0], p[b, 1], p[b, 2]), (p[c, 0], p[c, 1], p[c, 2])
        normal = _cross(_minus(one, corner), _minus(other, corner))
        if _dot(corner, normal) * _dot(_minus(corner, opposite), normal) <= 0.0:  # the origin is beyond this face
            near, corners = _nearest_of_face(p, a, b, c)
            if _dot(near, near) < least:
                best, bits, least = near, corners, _dot(near, near)
    return best, bits


@kernel
def touches(solid: FloatArray, R: Nine, at: Three, half: Three) -> bool:
    """Whether a box with half sides `half`, turned by R (row by row), at `at` has a point in common with a solid."""
    simplex, count, least = np.empty((4, 3)), 0, np.inf
    near = _minus((solid[0], solid[1], solid[2]), at)
    if _dot(near, near) < _TOUCH:
        return True
    for _ in range(_ROUNDS):
        new = _difference(solid, R, at, half, -near[0], -near[1], -near[2])
        if _dot(new, near) > 0.0:
            return False  # nothing of the difference is on this side of the origin
        simplex[count, 0], simplex[count, 1], simplex[count, 2] = new
        near, corners = _nearest(simplex, count + 1)
        square = _dot(near, near)
        if corners == 15 or square < _TOUCH:
            return True
        if square >= least:
            return False  # as near as numbers can tell, and not there
        least, kept_count = square, 0
        for k in range(count + 1):
            if corners >> k & 1:
                simplex[kept_count, :] = simplex[k, :]
                kept_count += 1
        count = kept_count
    return False


@kernel
def collides(
    solids: FloatArray,
    bounds: NDArray[np.float32],
    links: IntArray,
    nodes: int,
    waiting: IntArray,
    R: Nine,
    at: Three,
    half: Three,
) -> bool:
    """Whether a box at a pose touches one of the solids, found through their tree of bounding boxes."""
    rx = abs(R[0]) * half[0] + abs(R[1]) * half[1] + abs(R[2]) * half[2]
    ry = abs(R[3]) * half[0] + abs(R[4]) * half[1] + abs(R[5]) * half[2]
    rz = abs(R[6]) * half[0] + abs(R[7]) * half[1] + abs(R[8]) * half[2]
    waiting[0] = 0
    count = min(nodes, 1)
    while count > 0:
        count -= 1
        node = waiting[count]
        low = bounds[node]
        for k in range(8):
            link = links[node, k]
            if link == NOTHING or at[0] + rx < low[0, k] or at[1] + ry < low[1, k] or at[2] + rz < low[2, k]:
                continue
            if at[0] - rx > low[3, k] or at[1] - ry > low[4, k] or at[2] - rz > low[5, k]:
                continue
            if link >= 0:
                waiting[count] = link
                count += 1
            elif touches(solids[-1 - link], R, at, half):
                return True
    return False


@entry
def _touching(
    obstacles: Obstacles,
    waiting: IntArray,
    half: Three,
    positions: FloatArray,
    rotations: FloatArray,
    found: BoolArray,
) -> None:
    solids, bounds, links = obstacles
    for i in range(len(positions)):
        R, at = rotations[i], (positions[i, 0], positions[i, 1], positions[i, 2])
        turned = (R[0], R[1], R[2], R[3], R[4], R[5], R[6], R[7], R[8])
        found[i] = collides(solids, bounds, links, len(bounds), waiting, turned, at, half)
