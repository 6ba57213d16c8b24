"""Compiled correlation of patches with an image: the best pixel among candidates, and its place between the pixels.

One landmark after the other, all that belongs to it stays in the processor's cache. `matching` says what is
calculated; Numba compiles it when it is first used and keeps the result on disk.
"""

from __future__ import annotations

import math

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.kernels.compilation import entry, kernel
from stereo_slam_env.frontend.patches import FLAT, PATCH, Image, Patches, cut

_RADIUS = PATCH // 2
_PIXELS = PATCH * PATCH
_MIDDLE = np.float32(128.0)
"""Taken from all grey values: the template has no mean, so this changes nothing but the rounding."""


@entry
def correlation_map(window: Image, template: Patches) -> Patches:
    """Zero-mean normalised cross-correlation of a template (11, 11) at every position inside a window (H, W).

    Returns (H - 10, W - 10) in -1..1; [y, x] compares the patch whose first pixel is window[y, x].
    """
    height, width = window.shape[0] - PATCH + 1, window.shape[1] - PATCH + 1
    mean = 0.0
    for i in range(PATCH):
        for j in range(PATCH):
            mean += template[i, j]
    mean /= _PIXELS
    t, own = np.empty((PATCH, PATCH), dtype=np.float32), 0.0
    for i in range(PATCH):
        for j in range(PATCH):
            t[i, j] = template[i, j] - mean
            own += t[i, j] * t[i, j]
    flat = _PIXELS * FLAT**2
    own = max(own, flat)
    values = np.empty(window.shape, dtype=np.float32)
    for y in range(window.shape[0]):
        for x in range(window.shape[1]):
            values[y, x] = np.float32(window[y, x]) - _MIDDLE
    # Sums of the columns of the patches in a row, and of their squares; exact.
    sums, squares = np.zeros(window.shape[1], dtype=np.int64), np.zeros(window.shape[1], dtype=np.int64)
    for y in range(PATCH - 1):
        _add_row(window[y], 1, sums, squares)
    scores, product = np.empty((height, width), dtype=np.float32), np.empty(width, dtype=np.float32)
    for y in range(height):
        _add_row(window[y + PATCH - 1], 1, sums, squares)
        for x in range(width):
            product[x] = 0.0
        for i in range(PATCH):
            row, factors = values[y + i], t[i]
            for x in range(width):
                along = np.float32(0.0)
                for j in range(PATCH):
                    along += factors[j] * row[x + j]
                product[x] += along
        patch_sum, patch_square = np.int64(0), np.int64(0)
        for x in range(PATCH - 1):
            patch_sum += sums[x]
            patch_square += squares[x]
        for x in range(width):
            patch_sum += sums[x + PATCH - 1]
            patch_square += squares[x + PATCH - 1]
            energy = (_PIXELS * patch_square - patch_sum * patch_sum) / _PIXELS
            scores[y, x] = product[x] / math.sqrt(max(energy, flat) * own)
            patch_sum -= sums[x]
            patch_square -= squares[x]
        _add_row(window[y], -1, sums, squares)
    return scores


@kernel
def _add_row(row: Image, sign: int, sums: IntArray, squares: IntArray) -> None:
    """Let a row enter the sums of the columns, or leave them."""
    for x in range(len(row)):
        value = np.int64(row[x])
        sums[x] += sign * value
        squares[x] += sign * value * value


@entry
def note_peaks(
    image: Image,
    templates: Patches,
    first: IntArray,
    last: IntArray,
    centers: FloatArray,
    whiten: FloatArray,
    rival: float,
    neighbourhood: int,
    pixel: IntArray,
    score: FloatArray,
    second: FloatArray,
    offset: FloatArray,
    rising: BoolArray,
) -> None:
    """Write the peaks of each template: see `matching.best_peaks`; candidates x have |whiten (x - center)| <= 1."""
    height, width = image.shape
    for k in range(len(templates)):
        u_first, v_first, u_last, v_last = first[k, 0], first[k, 1], last[k, 0], last[k, 1]
        if u_last < u_first or v_last < v_first:
            continue
        # The map has a ring of one around the candidates, but for what would be beyond the image.
        u0, v0 = max(u_first - 1, _RADIUS), max(v_first - 1, _RADIUS)
        u1, v1 = min(u_last + 1, width - 1 - _RADIUS), min(v_last + 1, height - 1 - _RADIUS)
        scores = correlation_map(image[v0 - _RADIUS : v1 + _RADIUS + 1, u0 - _RADIUS : u1 + _RADIUS + 1], templates[k])
        allowed = np.empty((v_last - v_first + 1, u_last - u_first + 1), dtype=np.bool_)
        best, best_y, best_x = -np.inf, -1, -1
        for y in range(v_first - v0, v_last - v0 + 1):
            dv = y + v0 - centers[k, 1]
            for x in range(u_first - u0, u_last - u0 + 1):
                du = x + u0 - centers[k, 0]
                a = whiten[k, 0, 0] * du + whiten[k, 0, 1] * dv
                b = whiten[k, 1, 0] * du + whiten[k, 1, 1] * dv
                inside = a * a + b * b <= 1.0
                allowed[y + v0 - v_first, x + u0 - u_first] = inside
                if inside and scores[y, x] > best:
                    best, best_y, best_x = scores[y, x], y, x
        if best_y < 0:
            continue
        pixel[k, 0], pixel[k, 1] = best_x + u0, best_y + v0
        score[k], offset[k, 0], offset[k, 1] = _parabola_top(scores, best_y, best_x)
        rising[k] = best < _highest_around(scores, best_y, best_x)
        for y in range(v_first - v0, v_last - v0 + 1):
            for x in range(u_first - u0, u_last - u0 + 1):
                if scores[y, x] <= rival or not allowed[y + v0 - v_first, x + u0 - u_first]:
                    continue
                if max(abs(y - best_y), abs(x - best_x)) <= neighbourhood:
                    continue
                if scores[y, x] >= _highest_around(scores, y, x):
                    second[k] = max(second[k], _parabola_top(scores, y, x)[0])


@kernel
def _at(scores: Patches, y: int, x: int) -> float:
    """A value of the map; -1 beyond it."""
    if y < 0 or x < 0 or y >= scores.shape[0] or x >= scores.shape[1]:
        return -1.0
    return float(scores[y, x])


@kernel
def _highest_around(scores: Patches, y: int, x: int) -> float:
    highest = -1.0
    for i in range(-1, 2):
        for j in range(-1, 2):
            highest = max(highest, _at(scores, y + i, x + j))
    return highest


@kernel
def _parabola_top(scores: Patches, y: int, x: int) -> tuple[float, float, float]:
    """Height and place (u, v) of the tops of the parabolas along u and v through a pixel of a map."""
    middle = _at(scores, y, x)
    u, along_u = _top(_at(scores, y, x - 1), middle, _at(scores, y, x + 1))
    v, along_v = _top(_at(scores, y - 1, x), middle, _at(scores, y + 1, x))
    return min(middle + 0.5 * (along_u + along_v), 1.0), u, v


@kernel
def _top(before: float, middle: float, after: float) -> tuple[float, float]:
    """Place of the top of a parabola, within 0.5, and slope times place; zeros where there is none."""
    bend, slope = 2.0 * middle - before - after, 0.5 * (after - before)
    if bend > 1e-6 and abs(slope) <= 0.5 * bend:
        return slope / bend, slope * slope / bend
    return 0.0, 0.0


@entry
def note_refined(
    image: Image,
    templates: Patches,
    pixel: IntArray,
    offset: FloatArray,
    iterations: int,
    stays_within: float,
    least_texture: float,
    away: FloatArray,
    score: FloatArray,
    texture: FloatArray,
    stays: BoolArray,
) -> None:
    """Write the steps of `matching.refine` for each template: the way from the pixel, and what it ends at.

    `away` (N, 2) px, `score` (N,), `texture` (N, 3) are the entries uu, uv, vv of the matrix of gradients.
    """
    t, g_u, g_v, square = np.empty(_PIXELS), np.empty(_PIXELS), np.empty(_PIXELS), np.empty((PATCH, PATCH))
    patch = square.reshape(_PIXELS)
    for k in range(len(templates)):
        for y in range(PATCH):
            for x in range(PATCH):
                # Central differences, and those to the neighbour at both ends.
                left, right, above, below = max(x - 1, 0), min(x + 1, PATCH - 1), max(y - 1, 0), min(y + 1, PATCH - 1)
                t[y * PATCH + x] = templates[k, y, x]
                g_u[y * PATCH + x] = (templates[k, y, right] - templates[k, y, left]) / (right - left)
                g_v[y * PATCH + x] = (templates[k, below, x] - templates[k, above, x]) / (below - above)
        length = _normalise(t)
        for g in (g_u, g_v):
            _derive(g, t, length)
        uu, uv, vv = _dot(g_u, g_u), _dot(g_u, g_v), _dot(g_v, g_v)
        some = least_texture * (uu + vv + least_texture)
        uu, vv = uu + some, vv + some
        texture[k, 0], texture[k, 1], texture[k, 2] = uu, uv, vv
        determinant = uu * vv - uv * uv
        u, v = offset[k, 0], offset[k, 1]
        for _ in range(iterations):
            cut(image, pixel[k, 0] + u, pixel[k, 1] + v, square)
            _normalise(patch)
            alike = max(_dot(t, patch), 0.1)
            slope_u, slope_v = _dot(g_u, patch) / alike, _dot(g_v, patch) / alike
            u -= (vv * slope_u - uv * slope_v) / determinant
            v -= (uu * slope_v - uv * slope_u) / determinant
            if not (abs(u) <= stays_within and abs(v) <= stays_within):
                u, v, stays[k] = offset[k, 0], offset[k, 1], False
                break
        cut(image, pixel[k, 0] + u, pixel[k, 1] + v, square)
        _normalise(patch)
        away[k, 0], away[k, 1], score[k] = u, v, _dot(t, patch)


@kernel
def _normalise(values: FloatArray) -> float:
    """Bring a patch to zero mean and unit length, and return the length it had."""
    mean, square = _mean(values), 0.0
    for n in range(_PIXELS):
        values[n] -= mean
        square += values[n] * values[n]
    length = max(math.sqrt(square), FLAT * PATCH)
    for n in range(_PIXELS):
        values[n] /= length
    return length


@kernel
def _derive(g: FloatArray, t: FloatArray, length: float) -> None:
    """Turn the derivative of a patch into that of the normalised patch `t`."""
    for n in range(_PIXELS):
        g[n] /= length
    mean, along = _mean(g), 0.0
    for n in range(_PIXELS):
        g[n] -= mean
        along += g[n] * t[n]
    for n in range(_PIXELS):
        g[n] -= along * t[n]


@kernel
def _mean(values: FloatArray) -> float:
    total = 0.0
    for n in range(_PIXELS):
        total += values[n]
    return total / _PIXELS


@kernel
def _dot(a: FloatArray, b: FloatArray) -> float:
    product = 0.0
    for n in range(_PIXELS):
        product += a[n] * b[n]
    return product
