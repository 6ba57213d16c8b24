"""Compiled geometry of scenes: distance to roads, room for things beside them, points on surfaces.

Numba compiles it when it is first used and keeps the result on disk. Import it where a scene is built: Numba takes
half a second to load.
"""

from __future__ import annotations

import math

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.world.instructions import fma
from stereo_slam_env.world.scene import BOX, CYLINDER

X, Y, COS, SIN, LENGTH, WIDTH, RADIUS = range(7)
"""Columns of a table of rectangles on the ground: centre, direction, size, radius of the circle around it."""
_RUN = 16
_LOWEST = 0.15
"""m above the ground; what is lower is no landmark."""
_TOLERANCE = 1e-6


@entry
def circles_around(items: FloatArray) -> FloatArray:
    """Centre and radius of a circle around each run of 16 points along roads, or of 16 such circles.

    With these, most of what is inside needs no closer look.
    """
    circles = np.empty((math.ceil(len(items) / _RUN), 3))
    for k in range(len(circles)):
        run = items[k * _RUN : (k + 1) * _RUN]
        middle = run[len(run) // 2]
        circles[k, X], circles[k, Y], circles[k, 2] = middle[X], middle[Y], 0.0
        for item in run:
            reach = math.hypot(item[X] - circles[k, X], item[Y] - circles[k, Y])
            circles[k, 2] = max(circles[k, 2], reach + (item[2] if len(item) == 3 else 0.0))
    return circles


@entry
def nearest(points: FloatArray, circles: FloatArray, xy: FloatArray) -> IntArray:
    """Index of the point of a road, with circles around these, that is nearest to each of `xy` (N, 2)."""
    nearest_point, outer, at = np.empty(len(xy), dtype=np.int64), circles_around(circles), 0
    for k in range(len(xy)):
        nearest_point[k] = at = _nearest(points, circles, outer, xy[k, X], xy[k, Y], at)
    return nearest_point


@kernel
def _nearest(points: FloatArray, circles: FloatArray, outer: FloatArray, x: float, y: float, at: int) -> int:
    """Index of the nearest point; the last answer `at` is a good guess, as points come thing by thing."""
    guess = at // _RUN
    at, least = _nearest_of_run(points, guess, x, y, at, np.inf)
    for o in range(len(outer)):
        if _square(outer, o, x, y) < (least + outer[o, 2]) ** 2:
            for c in range(o * _RUN, min((o + 1) * _RUN, len(circles))):
                if _square(circles, c, x, y) < (least + circles[c, 2]) ** 2 and c != guess:
                    at, least = _nearest_of_run(points, c, x, y, at, least)
    return at


@kernel
def _nearest_of_run(points: FloatArray, run: int, x: float, y: float, at: int, least: float) -> tuple[int, float]:
    """Index and distance of the nearest point of a run, unless the one `at` a distance of `least` is nearer."""
    square = least**2
    for i in range(run * _RUN, min((run + 1) * _RUN, len(points))):
        away = _square(points, i, x, y)
        if away < square:
            at, square = i, away
    return at, math.sqrt(square)


@kernel
def _square(points: FloatArray, i: int, x: float, y: float) -> float:
    """Square of the distance to a point."""
    return (points[i, X] - x) ** 2 + (points[i, Y] - y) ** 2


@entry
def claim(
    points: FloatArray,
    circles: FloatArray,
    taken: FloatArray,
    count: int,
    place: tuple[float, float, float],
    size: tuple[float, float],
    room: float,
    clearance: float,
) -> bool:
    """Whether a rectangle has room off the roads and between the first `count` in `taken`; it becomes the next row.

    `place` is x, y, yaw; points and circles of the roads are those of `RoadNetwork`. What counts is a grid of points,
    some 1.5 m apart, that covers the rectangle: none less than `clearance` from a road, none within `room` of another
    rectangle; and no centre of another within `room` of this one.
    """
    claimed_cell = taken[count]
    claimed_cell[X], claimed_cell[Y] = place[0], place[1]
    claimed_cell[COS], claimed_cell[SIN] = math.cos(place[2]), math.sin(place[2])
    claimed_cell[LENGTH], claimed_cell[WIDTH] = size
    claimed_cell[RADIUS] = 0.5 * math.hypot(size[0], size[1])
    cover = _cover(claimed_cell)
    if not _off_roads(points, circles, claimed_cell, cover, clearance):
        return False
    for other in taken[:count]:
        x, y, reach = (
            other[X] - claimed_cell[X],
            other[Y] - claimed_cell[Y],
            other[RADIUS] + claimed_cell[RADIUS] + 2 * room,
        )
        if x * x + y * y < 1.001 * reach**2 and math.hypot(x, y) < reach:  # a square takes a tenth of the time
            if _contains(claimed_cell, other[X], other[Y], room):
                return False
            for x, y in cover:
                if _contains(other, x, y, room):
                    return False
    return True


@kernel
def _off_roads(
    points: FloatArray, circles: FloatArray, wanted: FloatArray, cover: FloatArray, clearance: float
) -> bool:
    reach = wanted[RADIUS] + clearance
    for c in range(len(circles)):
        if _square(circles, c, wanted[X], wanted[Y]) < (circles[c, 2] + reach) ** 2:
            for x, y in points[c * _RUN : (c + 1) * _RUN]:
                # Few points are so near to the rectangle that its grid has to be looked at.
                if _contains(wanted, x, y, clearance + _TOLERANCE):
                    for k in range(len(cover)):
                        if math.sqrt(_square(cover, k, x, y)) < clearance:
                            return False
    return True


@kernel
def _contains(rectangle: FloatArray, x: float, y: float, room: float) -> bool:
    """Whether the rectangle grown by `room` contains the point."""
    x, y = x - rectangle[X], y - rectangle[Y]
    along = fma(rectangle[SIN], y, rectangle[COS] * x)
    across = fma(rectangle[COS], y, -rectangle[SIN] * x)
    return abs(along) < 0.5 * rectangle[LENGTH] + room and abs(across) < 0.5 * rectangle[WIDTH] + room


@kernel
def _cover(rectangle: FloatArray) -> FloatArray:
    """Points about 1.5 m apart that cover the rectangle; (N, 2)."""
    length, width = rectangle[LENGTH], rectangle[WIDTH]
    columns, rows = max(3, int(length / 1.5)), max(3, int(width / 1.5))
    cover = np.empty((columns * rows, 2))
    for i in range(columns):
        x = length * _share(i, columns)
        for j in range(rows):
            y = width * _share(j, rows)
            cover[i * rows + j, X] = fma(y, -rectangle[SIN], x * rectangle[COS]) + rectangle[X]
            cover[i * rows + j, Y] = fma(y, rectangle[COS], x * rectangle[SIN]) + rectangle[Y]
    return cover


@kernel
def _share(i: int, count: int) -> float:
    """Number i of `count` from -0.5 to 0.5."""
    return 0.5 if i == count - 1 else i * (1.0 / (count - 1)) - 0.5


@entry
def sampling_weights(shapes: FloatArray) -> FloatArray:
    """Share of the points for each shape, relative to others: the root of its side area, so that poles count too."""
    weights = np.empty(len(shapes))
    for i, shape in enumerate(shapes):
        if shape[0] == BOX:
            weights[i] = math.sqrt(max(shape[4], shape[5]) * min(shape[6], 9.0))
        elif shape[0] == CYLINDER:
            weights[i] = math.sqrt(2 * shape[7] * _norm(shape[4:7] - shape[1:4]))
        else:
            weights[i] = 2 * shape[4]
    return weights


@entry
def sample(shapes: FloatArray, counts: IntArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Points uniform on the side (of balls: the whole) surfaces of the shapes and unit outward normals; (N, 3) each.

    `shapes` are those of `scene.table_of`.
    """
    total = counts.sum()
    points, normals = np.empty((total, 3)), np.empty((total, 3))
    first = 0
    for shape, count in zip(shapes, counts):  # noqa: B905 (Numba knows no `strict`)
        _sample(shape, rng, points[first : first + count], normals[first : first + count])
        first += count
    return points, normals


@entry
def sample_facing(
    shapes: FloatArray,
    counts: IntArray,
    points: FloatArray,
    circles: FloatArray,
    highest: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Points of `sample` that are below `highest` and turned to the nearest point of a road; (M, 3)."""
    outer, turned, number, at = circles_around(circles), np.empty((counts.sum(), 3)), 0, 0
    samples, normals = np.empty((counts.max(), 3)), np.empty((counts.max(), 3))
    for shape, count in zip(shapes, counts):  # noqa: B905 (Numba knows no `strict`)
        _sample(shape, rng, samples[:count], normals[:count])
        for i in range(count):
            if _LOWEST < samples[i, 2] < highest:
                x, y = samples[i, X], samples[i, Y]
                at = _nearest(points, circles, outer, x, y, at)
                x, y = points[at, X] - x, points[at, Y] - y
                if normals[i, X] * x + normals[i, Y] * y > 0.2 * math.sqrt(x * x + y * y):
                    turned[number] = samples[i]
                    number += 1
    return turned[:number].copy()


@kernel
def _sample(shape: FloatArray, rng: np.random.Generator, points: FloatArray, normals: FloatArray) -> None:
    if shape[0] == BOX:
        _sample_box(shape, rng, points, normals)
    elif shape[0] == CYLINDER:
        _sample_cylinder(shape, rng, points, normals)
    else:
        _sample_ball(shape, rng, points, normals)


@kernel
def _sample_box(shape: FloatArray, rng: np.random.Generator, points: FloatArray, normals: FloatArray) -> None:
    length, width, height = shape[4:7]
    cos, sin = math.cos(shape[7]), math.sin(shape[7])
    normals[:] = 0.0
    ends_share = width / (length + width)
    axes = np.array([rng.random() >= ends_share for _ in range(len(points))])
    signs = np.array([2.0 * rng.integers(0, 2) - 1.0 for _ in range(len(points))])
    for i in range(len(points)):
        x, y, z = rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5)
        if axes[i]:
            y = 0.5 * signs[i]
            normals[i, X], normals[i, Y] = signs[i] * -sin, signs[i] * cos
        else:
            x = 0.5 * signs[i]
            normals[i, X], normals[i, Y] = signs[i] * cos, signs[i] * sin
        x, y, z = x * length, y * width, z * height
        points[i, X] = fma(y, -sin, x * cos) + shape[1]
        points[i, Y] = fma(y, cos, x * sin) + shape[2]
        points[i, 2] = z + shape[3]


@kernel
def _sample_cylinder(shape: FloatArray, rng: np.random.Generator, points: FloatArray, normals: FloatArray) -> None:
    start, axis, radius = shape[1:4], shape[4:7] - shape[1:4], shape[7]
    x, y, z = axis / _norm(axis)
    side = np.array([y, -x, 0.0]) if abs(z) < 0.9 else np.array([0.0, z, -y])  # across the axis
    side /= _norm(side)
    other = np.array(
        [fma(y, side[2], -z * side[1]), z * side[0] - x * side[2], fma(-y, side[0], x * side[1])]
    )  # across both
    angles = np.array([rng.uniform(0.0, 2 * math.pi) for _ in range(len(points))])
    for i in range(len(points)):
        cos, sin, along = math.cos(angles[i]), math.sin(angles[i]), rng.random()
        for j in range(3):
            normals[i, j] = cos * side[j] + sin * other[j]
            points[i, j] = start[j] + along * axis[j] + radius * normals[i, j]


@kernel
def _sample_ball(shape: FloatArray, rng: np.random.Generator, points: FloatArray, normals: FloatArray) -> None:
    for i in range(len(points)):
        x, y, z = rng.standard_normal(), rng.standard_normal(), rng.standard_normal()
        norm = math.sqrt(x * x + y * y + z * z)
        normals[i, 0], normals[i, 1], normals[i, 2] = x / norm, y / norm, z / norm
        for j in range(3):
            points[i, j] = shape[4] * normals[i, j] + shape[1 + j]


@kernel
def _norm(vector: FloatArray) -> float:
    x, y, z = vector
    return math.sqrt(fma(z, z, fma(y, y, x * x)))
