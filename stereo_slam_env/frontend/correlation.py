"""Finding patches in an image by zero-mean normalised cross-correlation.

`best_peaks` correlates every template with a window of its own, windows of similar size together, by the fast Fourier
transform. `search` is active search: the candidates of a landmark are the pixels of its innovation ellipse.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy import fft

from filters.validation import BoolArray, FloatArray, IntArray, finite_array
from stereo_slam_env.frontend.patches import FLAT, PATCH, Image, Patches, windows_at
from stereo_slam_env.frontend.refinement import refine

Candidates = Callable[[IntArray, IntArray, IntArray], BoolArray]
"""(index (n,), u (n, w), v (n, h)) -> (n, h, w): which pixels the landmarks `index` may be found at."""

_RADIUS = PATCH // 2
_PIXELS = PATCH * PATCH
_BLOCK = 1 << 17
"""Pixels in the windows of one block: they stay in the processor's cache."""
_SIMILAR = 2.5
"""Windows in a block differ by no more than this in their number of pixels."""
_FAR = 1e9
"""Outside of any ellipse, px."""
_RIVAL = 0.5
"""A second peak lower than this is not looked at."""
_NEIGHBOURHOOD = 2
"""A second peak nearer than this belongs to the first, px."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """The best candidate pixel of each template.

    Attributes
    ----------
    pixel : (N, 2) int64
        (u, v); meaningless where `score` is -1.
    score : (N,)
        Correlation there, raised to the top of the parabolas through its neighbours; -1 where there was no candidate.
    second : (N,)
        The same of the best other local maximum among the candidates; -1 where there is none above 1/2.
    offset : (N, 2)
        From the pixel to the top of the parabolas, px, within 0.5.
    rising : (N,) bool
        The correlation is larger right beside the pixel, where there are no candidates.
    """

    pixel: IntArray
    score: FloatArray
    second: FloatArray
    offset: FloatArray
    rising: BoolArray


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Where templates were found.

    Attributes
    ----------
    position : (N, 2)
        (u, v), px; NaN where there was no candidate inside the image.
    score : (N,)
        Correlation there; -1 where there was no candidate.
    second : (N,)
        Best correlation of another peak inside the ellipse, near `score` if the match is not unique; -1 if none is
        above 1/2.
    on_border : (N,) bool
        The correlation is still rising where the ellipse ends: the landmark may be outside it.
    covariance : (N, 2, 2)
        Of the position, px^2; NaN where there was no candidate.
    """

    position: FloatArray
    score: FloatArray
    second: FloatArray
    on_border: BoolArray
    covariance: FloatArray


def search(
    image: Image,
    templates: Patches,
    centers: ArrayLike,
    S: ArrayLike,
    *,
    gate: float = 3.0,
    max_radius: float = 40.0,
) -> SearchResult:
    """Find templates inside their innovation ellipses.

    Parameters
    ----------
    image : (H, W) uint8
        Grey image.
    templates : (N, 11, 11) float32
        How the surroundings of the landmarks should look.
    centers : (N, 2) array_like
        Expected (u, v), px.
    S : (N, 2, 2) array_like
        Innovation covariance, px^2.
    gate : float
        Radius of the ellipse in standard deviations: candidates x have (x - c)^T S^-1 (x - c) <= gate^2, with half a
        pixel's diagonal added, so that there is always one.
    max_radius : float
        No candidate is further away than this in u or v, px.

    Returns
    -------
    SearchResult

    Raises
    ------
    ValueError
        Wrong shapes, NaN or infinity, an S that is not positive semi-definite.
    """
    c = finite_array("centers", centers, (len(templates), 2))
    covariance = finite_array("S", S, (len(templates), 2, 2))
    reach = covariance + (np.sqrt(0.5) / gate) ** 2 * np.eye(2)
    try:  # d^T S^-1 d <= gate^2 as |B d| <= 1, with B upper triangular
        whiten = np.linalg.inv(gate * np.linalg.cholesky(reach[:, ::-1, ::-1])[:, ::-1, ::-1])
    except np.linalg.LinAlgError as error:
        raise ValueError("S must be positive semi-definite: a landmark has an impossible ellipse") from error
    extent = np.minimum(gate * np.sqrt(np.diagonal(reach, axis1=1, axis2=2)), max_radius)

    def within(difference: FloatArray, limit: FloatArray) -> Patches:
        return np.where(np.abs(difference) <= limit, difference, _FAR).astype(np.float32)

    def inside(index: IntArray, u: IntArray, v: IntArray) -> BoolArray:
        (a, b), (_, d) = whiten[index].transpose(1, 2, 0).astype(np.float32)[..., None]
        du, dv = (within(u - c[index, :1], extent[index, :1]), within(v - c[index, 1:], extent[index, 1:]))
        squared = (b * dv)[:, :, None] + (a * du)[:, None, :]
        squared *= squared
        squared += ((d * dv) ** 2)[:, :, None]
        allowed: BoolArray = squared <= 1.0
        return allowed

    peaks = best_peaks(image, templates, np.ceil(c - extent), np.floor(c + extent), inside)
    found = peaks.score > -1.0
    position, score = np.full(c.shape, np.nan), np.full(len(c), -1.0)
    spread = np.full((len(c), 2, 2), np.nan)
    refined = refine(image, templates[found], peaks.pixel[found], peaks.offset[found])
    position[found], score[found], spread[found] = refined.position, refined.score, refined.covariance
    away = position - c
    with np.errstate(invalid="ignore"):
        outside = (np.einsum("nij,nj->ni", whiten, away) ** 2).sum(axis=1) > 1.0
    outside[found] |= peaks.rising[found] & ~refined.converged
    return SearchResult(position, score, peaks.second, outside, spread)


def best_peaks(
    image: Image, templates: Patches, low: FloatArray, high: FloatArray, candidates: Candidates | None = None
) -> Peaks:
    """The best pixel of each template in a box, or in a part of it.

    Parameters
    ----------
    image : (H, W) uint8
        Grey image. Only pixels with the whole patch inside are candidates.
    templates : (N, 11, 11) float32
        What to look for.
    low, high : (N, 2)
        First and last (u, v) of the box, whole px.
    candidates : callable, optional
        Which pixels count, none of them outside the box; None: all in the box.

    Returns
    -------
    Peaks
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
    """Zero-mean normalised cross-correlation of each template with its window, at every position inside.

    Parameters
    ----------
    windows : (n, H, W) uint8
        H and W at least 11.
    templates : (n, 11, 11) float32

    Returns
    -------
    (n, H - 10, W - 10) float32
        In -1..1; [i, y, x] compares the patch whose first pixel is window[y, x].
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
