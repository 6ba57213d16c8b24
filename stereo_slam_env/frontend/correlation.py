"""Zero-mean normalised cross-correlation of patches with an image: its peaks, and their places between the pixels.

`best_peaks` correlates every template with a window of its own, windows of similar size together, by the fast Fourier
transform.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import fft

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.patches import FLAT, PATCH, Image, Patches, cut_stack, windows_at

Candidates = Callable[[IntArray, IntArray, IntArray], BoolArray]
"""(index (n,), u (n, w), v (n, h)) -> (n, h, w): which pixels the landmarks `index` may be found at."""

_RADIUS = PATCH // 2
_PIXELS = PATCH * PATCH
_BLOCK = 1 << 17
"""Pixels in the windows of one block: they stay in the processor's cache."""
_SIMILAR = 2.5
"""Windows in a block differ by no more than this in their number of pixels."""
_RIVAL = 0.5
"""A second peak lower than this is not looked at."""
_NEIGHBOURHOOD = 2
"""A second peak nearer than this belongs to the first, px."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """The best candidate pixel of each template."""

    pixel: IntArray  # (N, 2): (u, v); meaningless where `score` is -1
    # (N,): correlation there, raised to the top of the parabolas through its neighbours; -1 without a candidate
    score: FloatArray
    # (N,): the same of the best other local maximum among the candidates; -1 where there is none above 1/2
    second: FloatArray
    offset: FloatArray  # (N, 2): from the pixel to the top of the parabolas, px, within 0.5
    rising: BoolArray  # (N,): the correlation is larger right beside the pixel, where there are no candidates


def best_peaks(
    image: Image, templates: Patches, low: FloatArray, high: FloatArray, candidates: Candidates | None = None
) -> Peaks:
    """The best pixel of each template in a box, or in a part of it.

    `low` and `high` (N, 2) are the first and the last (u, v) of the boxes, whole px. Only pixels with the whole patch
    inside the image count and, where `candidates` is given, only those it allows, none of them outside the box.
    """
    n, size = len(templates), np.array([image.shape[1], image.shape[0]])
    first = np.maximum(low, _RADIUS).astype(np.int64)
    last = np.minimum(high, size - 1 - _RADIUS).astype(np.int64)
    peaks = Peaks(
        np.zeros((n, 2), dtype=np.int64),
        np.full(n, -1.0),
        np.full(n, -1.0),
        np.zeros((n, 2)),
        np.zeros(n, dtype=np.bool_),
    )
    needed = np.minimum(last - first + PATCH + 2, size)  # candidates, a ring of one around them, and their patches
    for index in _blocks(needed, np.flatnonzero((last >= first).all(axis=1))):
        largest = needed[index].max(axis=0).tolist()
        width, height = np.minimum([fft.next_fast_len(length, real=True) for length in largest], size).tolist()
        origin = np.clip(first[index] - _RADIUS - 1, 0, size - (width, height))
        scores = correlation_maps(windows_at(image, origin, height, width), templates[index])
        u = origin[:, :1] + _RADIUS + np.arange(scores.shape[2])
        v = origin[:, 1:] + _RADIUS + np.arange(scores.shape[1])
        if candidates is None:
            in_columns = (u >= first[index, :1]) & (u <= last[index, :1])
            in_rows = (v >= first[index, 1:]) & (v <= last[index, 1:])
            allowed = in_columns[:, None, :] & in_rows[:, :, None]
        else:
            allowed = candidates(index, u, v)
        _note_peaks(peaks, index, scores, allowed, origin + _RADIUS)
    return peaks


def _blocks(sizes: IntArray, members: IntArray) -> Iterator[IntArray]:
    """Split `members` into groups with windows of similar `sizes` (N, 2): small ones do not pay for large ones."""
    areas = sizes[members].prod(axis=1)
    order = np.argsort(areas, kind="stable")
    members, areas = members[order], areas[order]
    begin = 0
    while begin < len(members):
        similar = int(np.searchsorted(areas, _SIMILAR * areas[begin], side="right"))
        end = min(similar, begin + max(1, _BLOCK // int(areas[begin])))
        yield members[begin:end]
        begin = end


def correlation_maps(windows: Image, templates: Patches) -> Patches:
    """Zero-mean normalised cross-correlation of each template with its window (n, H, W), at every position inside.

    Returns (n, H - 10, W - 10) in -1..1; [i, y, x] compares the patch whose first pixel is window[y, x].
    """
    n, height, width = windows.shape
    template = templates - templates.mean(axis=(1, 2), keepdims=True)
    values = windows - np.float32(128.0)  # the template has no mean: this changes nothing but the rounding
    spectrum = fft.rfft2(values)
    spectrum *= fft.fft(
        fft.rfft(template[:, ::-1, ::-1], width, axis=2), height, axis=1
    )  # rfft2, but for the empty rows
    product = fft.irfft2(spectrum, (height, width))
    stacked = values.reshape(n * height, width)  # a box that ends at a pixel stays inside the window of that pixel
    box, last = (PATCH, PATCH), (PATCH - 1, PATCH - 1)
    sums = np.asarray(cv2.boxFilter(stacked, cv2.CV_32F, box, anchor=last, normalize=False), dtype=np.float32)
    energy = np.asarray(cv2.sqrBoxFilter(stacked, cv2.CV_32F, box, anchor=last, normalize=False), dtype=np.float32)
    np.multiply(sums, sums, out=sums)
    sums *= np.float32(1.0 / _PIXELS)
    energy -= sums
    flat = np.float32(_PIXELS * FLAT**2)
    own = np.maximum(np.einsum("nij,nij->n", template, template), flat)
    root = np.maximum(energy, flat, out=energy).reshape(product.shape)
    root *= own[:, None, None]
    product /= np.sqrt(root, out=root)
    scores: Patches = product[:, PATCH - 1 :, PATCH - 1 :]
    return scores


def _note_peaks(peaks: Peaks, index: IntArray, scores: Patches, allowed: BoolArray, origin: IntArray) -> None:
    """Write the peaks of one group of score maps (n, h, w) into the rows `index`."""
    n, h, w = scores.shape
    padded = np.full((n, h + 2, w + 2), -1.0, dtype=np.float32)
    padded[:, 1:-1, 1:-1] = scores
    around = cv2.dilate(padded.reshape(-1, w + 2), np.ones((3, 3), dtype=np.uint8)).reshape(padded.shape)
    each = np.arange(n)
    eligible = np.where(allowed, scores, -np.inf).reshape(n, -1)
    best = eligible.argmax(axis=1)
    y, x = np.divmod(best, w)
    found = eligible[each, best] > -np.inf
    tops = np.flatnonzero((eligible > _RIVAL).reshape(scores.shape) & (scores == around[:, 1:-1, 1:-1]))
    which, others_y, others_x = np.unravel_index(tops, scores.shape)
    apart = np.maximum(np.abs(others_y - y[which]), np.abs(others_x - x[which])) > _NEIGHBOURHOOD
    rivals = which[apart]
    top, offset = _parabola_top(
        padded, np.append(each, rivals), np.append(y, others_y[apart]), np.append(x, others_x[apart])
    )
    second = np.full(n, -1.0)
    np.maximum.at(second, rivals, top[n:])
    peaks.pixel[index] = np.stack([x, y], axis=1) + origin
    peaks.score[index] = np.where(found, top[:n], -1.0)
    peaks.second[index] = second
    peaks.offset[index] = offset[:n]
    peaks.rising[index] = found & (padded[each, y + 1, x + 1] < around[each, y + 1, x + 1])


def _parabola_top(padded: Patches, which: IntArray, y: IntArray, x: IntArray) -> tuple[FloatArray, FloatArray]:
    """Height (K,) and place (K, 2) of the tops of the parabolas along u and v through pixels (y, x) of maps `which`.

    The maps (n, h + 2, w + 2) have a border of one.
    """
    size = padded.shape[2]
    at = (which * padded.shape[1] + y + 1) * size + x + 1
    middle, left, right, above, below = padded.ravel()[at + np.array([[0], [-1], [1], [-size], [size]])].astype(float)
    before, after = np.stack([left, above], axis=1), np.stack([right, below], axis=1)
    bend = 2.0 * middle[:, None] - before - after
    slope = 0.5 * (after - before)
    peaked = (bend > 1e-6) & (np.abs(slope) <= 0.5 * bend)
    offset = np.where(peaked, slope / np.where(peaked, bend, 1.0), 0.0)
    return np.minimum(middle + 0.5 * (slope * offset).sum(axis=1), 1.0), offset


_ITERATIONS = 2
_LEAST_TEXTURE = 1e-5
"""Share of the gradients that is taken to lie along a perfect edge: more than rounding, less than noise."""
_STAYS_WITHIN = 1.5
"""Further from the best pixel than this the steps have gone astray, px."""
_NOISE_GAIN = (0.5 * (PATCH - 2) + 2.0 * 2) / PATCH
"""Energy of the differences of white noise, over its own: 1/2 for central ones, 2 for those at both ends of a row."""
_SIGMA_FLOOR = 0.03
"""What interpolation and warping leave even without noise, px."""


@dataclass(frozen=True, eq=False)
class Refined:
    """Positions between the pixels."""

    position: FloatArray  # (N, 2): (u, v), px
    score: FloatArray  # (N,): correlation there
    covariance: FloatArray  # (N, 2, 2): of the position, px^2
    # (N,): the correlation has its maximum near the pixel; where not, the position is the top of the parabolas
    converged: BoolArray


def refine(image: Image, templates: Patches, pixel: IntArray, offset: FloatArray) -> Refined:
    """Maximise the correlation over positions between the pixels (Lucas-Kanade, inverse compositional).

    A template t and a patch i(p), both brought to zero mean and unit length, have correlation t . i(p). With g the
    derivative of t by a shift, orthogonal to t, a patch taken a little off the best position is t + g (p - p_best), up
    to gain: Gauss-Newton steps are -(g g^T)^-1 g i / (t . i). The noise of t is not correlated with its own central
    differences, so the steps end without bias. Equal white noise in both patches makes 2 (1 - t . i) / 121 the
    variance of a difference, hence 2 (1 - t . i) / 121 (g g^T)^-1 the covariance of p while noise has little part in g.
    Where the steps lead away from the pixel, the top of the parabolas is kept; both are from `best_peaks`.
    """
    stack = np.ascontiguousarray(templates.transpose(1, 2, 0))
    t, length = _normalised(stack)
    gradients: list[Patches] = list(np.gradient(stack, axis=(1, 0)))
    g_u, g_v = (_derivative(gradient, t, length) for gradient in gradients)
    texture = np.array([[_dot(g_u, g_u), _dot(g_u, g_v)], [_dot(g_v, g_u), _dot(g_v, g_v)]])
    texture[[0, 1], [0, 1]] += _LEAST_TEXTURE * (texture[0, 0] + texture[1, 1] + _LEAST_TEXTURE)
    away, stays = offset.copy(), np.ones(len(pixel), dtype=np.bool_)
    inverse = _inverse(texture)
    for _ in range(_ITERATIONS):
        i, _ = _normalised(cut_stack(image, pixel + away, PATCH))
        slope = np.array([_dot(g_u, i), _dot(g_v, i)]) / np.maximum(_dot(t, i), 0.1)
        away = away - np.einsum("ijn,jn->ni", inverse, slope)
        stays &= (np.abs(away) <= _STAYS_WITHIN).all(axis=1)
        away[~stays] = offset[~stays]
    i, _ = _normalised(cut_stack(image, pixel + away, PATCH))
    score = _dot(t, i)
    variance = 2.0 * (1.0 - np.minimum(score, 1.0)) / _PIXELS
    # The noise in g does not help to find the place, but it adds to the noise of g i.
    gain = _inverse(_without_noise(texture, 1.0 - score))
    covariance = (variance * np.einsum("ijn,jkn,kln->iln", gain, texture, gain)).transpose(2, 0, 1)
    return Refined(pixel + away, score, covariance + _SIGMA_FLOOR**2 * np.eye(2), stays)


def _normalised(stack: Patches) -> tuple[Patches, Patches]:
    """Patches (11, 11, N) as columns (121, N) with zero mean and unit length, and the length they had (N,)."""
    columns = stack.reshape(_PIXELS, -1)
    columns = columns - columns.sum(axis=0) * np.float32(1.0 / _PIXELS)
    length: Patches = np.maximum(np.sqrt((columns * columns).sum(axis=0)), np.float32(FLAT * PATCH))
    return columns / length, length


def _derivative(gradient: Patches, t: Patches, length: Patches) -> Patches:
    """Derivative of the normalised patches `t` (121, N), from that of the patches (11, 11, N)."""
    g = gradient.reshape(_PIXELS, -1) / length
    g -= g.sum(axis=0) * np.float32(1.0 / _PIXELS)
    g -= (g * t).sum(axis=0) * t
    return g


def _without_noise(texture: FloatArray, noise: FloatArray) -> FloatArray:
    """Gradient matrices (2, 2, N) less what noise of energy `noise` (N,) has added, but at least a fifth of them."""
    half_trace, half_gap = 0.5 * (texture[0, 0] + texture[1, 1]), 0.5 * (texture[0, 0] - texture[1, 1])
    smallest = half_trace - np.sqrt(half_gap**2 + texture[0, 1] ** 2)
    signal = texture.copy()
    signal[[0, 1], [0, 1]] -= np.clip(_NOISE_GAIN * noise, 0.0, 0.8 * np.maximum(smallest, 0.0))
    return signal


def _dot(a: Patches, b: Patches) -> FloatArray:
    product: FloatArray = (a * b).sum(axis=0).astype(np.float64)
    return product


def _inverse(G: FloatArray) -> FloatArray:
    """Inverses of symmetric matrices (2, 2, N)."""
    adjugate = np.array([[G[1, 1], -G[0, 1]], [-G[0, 1], G[0, 0]]])
    inverse: FloatArray = adjugate / (G[0, 0] * G[1, 1] - G[0, 1] ** 2)
    return inverse
