"""Compiled collisions: whether a box at any pose touches the solids of a scene, by GJK.

Two convex shapes touch where their Minkowski difference contains the origin. The algorithm of Gilbert, Johnson and
Keerthi (IEEE J. Robotics and Automation 4(2), 1988) walks towards it by simplices of its farthest points; here in the
form that only says yes or no. Everything is in the scene frame S, metres.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from filters.geometry.rotations import Nine, Three
from filters.validation import FloatArray, IntArray
from stereo_slam_env.world.rays import BOX, CYLINDER, KERNEL, NOTHING

_ROUNDS = 48
_TOUCH = 1e-9
"""Squares of lengths below this are zero, m^2."""


@njit(**KERNEL)
def _farthest(solid: FloatArray, x: float, y: float, z: float) -> Three:
    """The farthest point of a solid in a direction."""
    cx, cy, cz = solid[0], solid[1], solid[2]
    if solid[8] == BOX:
        cos, sin = solid[6], solid[7]
        a = math.copysign(solid[3], cos * x + sin * y)
        b = math.copysign(solid[4], cos * y - sin * x)
        return cx + cos * a - sin * b, cy + sin * a + cos * b, cz + math.copysign(solid[5], z)
    if solid[8] == CYLINDER:
        ax, ay, az, radius, half = solid[3], solid[4], solid[5], solid[6], solid[7]
        up = ax * x + ay * y + az * z
        half = math.copysign(half, up)
        x, y, z = x - up * ax, y - up * ay, z - up * az
        length = math.sqrt(x * x + y * y + z * z)
        scale = radius / length if length > 1e-12 else 0.0
        return cx + half * ax + scale * x, cy + half * ay + scale * y, cz + half * az + scale * z
    scale = solid[6] / math.sqrt(x * x + y * y + z * z)
    return cx + scale * x, cy + scale * y, cz + scale * z


@njit(**KERNEL)
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


@njit(**KERNEL)
def _dot(a: Three, b: Three) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(**KERNEL)
def _cross(a: Three, b: Three) -> Three:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(**KERNEL)
def _minus(a: Three, b: Three) -> Three:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(**KERNEL)
def touches(solid: FloatArray, R: Nine, at: Three, half: Three) -> bool:
    """Whether a box with half sides `half`, turned by R (row by row), at `at` has a point in common with a solid."""
    direction = _minus((solid[0], solid[1], solid[2]), at)
    if _dot(direction, direction) < _TOUCH:
        return True
    # The simplex is a, b, c, d, the newest first; `count` of them are valid.
    a = b = c = d = _difference(solid, R, at, half, direction[0], direction[1], direction[2])
    count, direction = 1, (-a[0], -a[1], -a[2])
    for _ in range(_ROUNDS):
        if _dot(direction, direction) < _TOUCH * _TOUCH:
            return True
        new = _difference(solid, R, at, half, direction[0], direction[1], direction[2])
        if _dot(new, direction) < 0.0:
            return False
        a, b, c, d, count = new, a, b, c, count + 1
        to_origin = (-a[0], -a[1], -a[2])
        if count == 4:
            # The faces at a: outside one of them the problem is that of a triangle, inside all it is solved.
            ab, ac, ad = _minus(b, a), _minus(c, a), _minus(d, a)
            abc, acd, adb = _cross(ab, ac), _cross(ac, ad), _cross(ad, ab)
            if _dot(abc, ad) > 0.0:
                abc = (-abc[0], -abc[1], -abc[2])
            if _dot(acd, ab) > 0.0:
                acd = (-acd[0], -acd[1], -acd[2])
            if _dot(adb, ac) > 0.0:
                adb = (-adb[0], -adb[1], -adb[2])
            if _dot(abc, to_origin) > 0.0:
                count = 3
            elif _dot(acd, to_origin) > 0.0:
                b, c, count = c, d, 3
            elif _dot(adb, to_origin) > 0.0:
                b, c, count = d, b, 3
            else:
                return True
        if count == 3:
            ab, ac = _minus(b, a), _minus(c, a)
            normal = _cross(ab, ac)
            if _dot(_cross(normal, ac), to_origin) > 0.0:
                if _dot(ac, to_origin) > 0.0:
                    b, count = c, 2
                else:
                    count = 2
            elif _dot(_cross(ab, normal), to_origin) > 0.0:
                count = 2
            else:
                direction = normal
                if _dot(normal, to_origin) < 0.0:
                    direction = (-normal[0], -normal[1], -normal[2])
                continue
        ab = _minus(b, a)
        if _dot(ab, to_origin) > 0.0:
            direction = _cross(_cross(ab, to_origin), ab)
        else:
            count, direction = 1, to_origin
    return True  # the origin is as near to the surface as numbers can tell


@njit(**KERNEL)
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
