"""Matching of patches by correlation: inside innovation ellipses (active search), and along rows of a stereo pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.validation import finite_array
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.correlation import note_peaks, note_refined
from stereo_slam_env.frontend.patches import PATCH, Image, Patches, cut_patches

_RADIUS = PATCH // 2
_PIXELS = PATCH * PATCH
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
    image: Image,
    templates: Patches,
    low: FloatArray,
    high: FloatArray,
    ellipse: tuple[FloatArray, FloatArray] | None = None,
) -> Peaks:
    """The best pixel of each template in a box, or in an ellipse inside it.

    `low` and `high` (N, 2) are the first and the last (u, v) of the boxes, whole px. Only pixels x with the whole patch
    inside the image count and, where an `ellipse` is given as c (N, 2) and B (N, 2, 2), only those with |B (x - c)| no
    more than 1.
    """
    n, size = len(templates), np.array([image.shape[1], image.shape[0]])
    centers, whiten = (np.zeros((n, 2)), np.zeros((n, 2, 2))) if ellipse is None else ellipse
    peaks = Peaks(
        np.zeros((n, 2), dtype=np.int64),
        np.full(n, -1.0),
        np.full(n, -1.0),
        np.zeros((n, 2)),
        np.zeros(n, dtype=np.bool_),
    )
    note_peaks(
        np.ascontiguousarray(image),
        np.ascontiguousarray(templates),
        np.maximum(low, _RADIUS).astype(np.int64),
        np.minimum(high, size - 1 - _RADIUS).astype(np.int64),
        centers,
        whiten,
        _RIVAL,
        _NEIGHBOURHOOD,
        peaks.pixel,
        peaks.score,
        peaks.second,
        peaks.offset,
        peaks.rising,
    )
    return peaks


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
    n = len(templates)
    away, score, gradients = np.zeros((n, 2)), np.zeros(n), np.zeros((n, 3))
    stays = np.ones(n, dtype=np.bool_)
    note_refined(
        np.ascontiguousarray(image),
        np.ascontiguousarray(templates),
        pixel,
        np.ascontiguousarray(offset),
        _ITERATIONS,
        _STAYS_WITHIN,
        _LEAST_TEXTURE,
        away,
        score,
        gradients,
        stays,
    )
    texture = gradients.T[[[0, 1], [1, 2]]]
    variance = 2.0 * (1.0 - np.minimum(score, 1.0)) / _PIXELS
    # The noise in g does not help to find the place, but it adds to the noise of g i.
    gain = _inverse(_without_noise(texture, 1.0 - score))
    covariance = (variance * np.einsum("ijn,jkn,kln->iln", gain, texture, gain)).transpose(2, 0, 1)
    return Refined(pixel + away, score, covariance + _SIGMA_FLOOR**2 * np.eye(2), stays)


def _without_noise(texture: FloatArray, noise: FloatArray) -> FloatArray:
    """Gradient matrices (2, 2, N) less what noise of energy `noise` (N,) has added, but at least a fifth of them."""
    half_trace, half_gap = 0.5 * (texture[0, 0] + texture[1, 1]), 0.5 * (texture[0, 0] - texture[1, 1])
    smallest = half_trace - np.sqrt(half_gap**2 + texture[0, 1] ** 2)
    signal = texture.copy()
    signal[[0, 1], [0, 1]] -= np.clip(_NOISE_GAIN * noise, 0.0, 0.8 * np.maximum(smallest, 0.0))
    return signal


def _inverse(G: FloatArray) -> FloatArray:
    """Inverses of symmetric matrices (2, 2, N)."""
    adjugate = np.array([[G[1, 1], -G[0, 1]], [-G[0, 1], G[0, 0]]])
    inverse: FloatArray = adjugate / (G[0, 0] * G[1, 1] - G[0, 1] ** 2)
    return inverse


_ROW_SIGMAS = 3.0
"""Standard deviations of the rows' offset within the tolerance."""
_RETURNS_WITHIN = 1.0
"""How far a match back from the right image may end from where it began, px."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Matches of templates."""

    position: FloatArray  # (N, 2): (u, v), px; NaN where there was no candidate inside the image
    score: FloatArray  # (N,): correlation there; -1 where there was no candidate
    second: FloatArray  # (N,): correlation of the best other peak inside the ellipse; -1 if none is above 1/2
    on_border: BoolArray  # (N,): the correlation is still rising where the ellipse ends: the landmark may be outside it
    covariance: FloatArray  # (N, 2, 2): of the position, px^2; NaN where there was no candidate


def search(
    image: Image,
    templates: Patches,
    centers: ArrayLike,
    S: ArrayLike,
    *,
    gate: float = 3.0,
    max_radius: float = 40.0,
) -> SearchResult:
    """Find templates (N, 11, 11) inside their innovation ellipses: `centers` (N, 2) px, `S` (N, 2, 2) px^2.

    Candidates x have (x - c)^T S^-1 (x - c) <= gate^2, with half a pixel's diagonal added, so that there is always one,
    and are no further away than `max_radius` in u or v, px. A `ValueError` where an argument is not finite, of another
    shape, or S not positive semi-definite.
    """
    c = finite_array("centers", centers, (len(templates), 2))
    covariance = finite_array("S", S, (len(templates), 2, 2))
    reach = covariance + (np.sqrt(0.5) / gate) ** 2 * np.eye(2)
    try:  # d^T S^-1 d <= gate^2 as |B d| <= 1, with B upper triangular
        whiten = np.linalg.inv(gate * np.linalg.cholesky(reach[:, ::-1, ::-1])[:, ::-1, ::-1]).astype(np.float64)
    except np.linalg.LinAlgError as error:
        raise ValueError("S must be positive semi-definite: a landmark has an impossible ellipse") from error
    extent = np.minimum(gate * np.sqrt(np.diagonal(reach, axis1=1, axis2=2)), max_radius)

    peaks = best_peaks(image, templates, np.ceil(c - extent), np.floor(c + extent), (c, whiten))
    has_peak = peaks.score > -1.0
    position, score = np.full(c.shape, np.nan), np.full(len(c), -1.0)
    spread = np.full((len(c), 2, 2), np.nan)
    refined = refine(image, templates[has_peak], peaks.pixel[has_peak], peaks.offset[has_peak])
    position[has_peak], score[has_peak], spread[has_peak] = refined.position, refined.score, refined.covariance
    away = position - c
    with np.errstate(invalid="ignore"):
        outside = (np.einsum("nij,nj->ni", whiten, away) ** 2).sum(axis=1) > 1.0
    outside[has_peak] |= peaks.rising[has_peak] & ~refined.converged
    return SearchResult(position, score, peaks.second, outside, spread)


@dataclass(frozen=True, eq=False)
class RowMatch:
    """Matches along the rows."""

    disparity: FloatArray  # (N,): u_left - u_right, px; NaN where there was nothing to compare with
    score: FloatArray  # (N,): correlation; -1 where there was nothing to compare with
    accepted: BoolArray  # (N,): good enough, unique, inside the range, and found again from the right
    variance: FloatArray  # (N,): of the disparity, px^2; NaN where there was nothing to compare with
    v_right: FloatArray  # (N,): row in the right image, px; NaN where there was nothing to compare with


def match_rows(
    left: Image,
    right: Image,
    uv: ArrayLike,
    disparity_low: ArrayLike,
    disparity_high: ArrayLike,
    *,
    rows: int = 1,
    min_score: float = 0.8,
    ratio: float = 0.9,
    left_right_check: bool = True,
) -> RowMatch:
    """Find the surroundings of left pixels `uv` (N, 2) in the right image, at disparities from low to high (N,), px.

    The right image's rows may be off by `rows` px: searched on either side, and taken for three standard deviations. A
    match is accepted with a correlation of at least `min_score`, where the second best peak stays below the share
    `ratio` of the best and, with `left_right_check`, where matching back over the same range returns to within 1 px.
    """
    if left.shape != right.shape:
        raise ValueError(f"right must have the size of left: {right.shape} and {left.shape}")
    at = finite_array("uv", uv, ("N", 2))
    n = len(at)
    low = finite_array("disparity_low", disparity_low, (n,))
    high = finite_array("disparity_high", disparity_high, (n,))
    templates = cut_patches(left, at, PATCH)
    nearest = np.rint(at[:, 1])
    first = np.stack([np.rint(at[:, 0] - high), nearest - rows], axis=1)
    last = np.stack([np.rint(at[:, 0] - low), nearest + rows], axis=1)
    peaks = best_peaks(right, templates, first, last)

    position, score, variance = np.full((n, 2), np.nan), np.full(n, -1.0), np.full(n, np.nan)
    has_peak = peaks.score > -1.0
    refined = refine(right, templates[has_peak], peaks.pixel[has_peak], peaks.offset[has_peak])
    # On a slanted edge the row decides on the disparity: the expected one is a measurement of it.
    P = refined.covariance
    gain = P[:, :, 1] / (P[:, 1, 1] + (rows / _ROW_SIGMAS) ** 2)[:, None]
    position[has_peak] = refined.position + gain * (at[has_peak, 1] - refined.position[:, 1])[:, None]
    variance[has_peak] = P[:, 0, 0] - gain[:, 0] * P[:, 0, 1]
    score[has_peak] = refined.score
    disparity = at[:, 0] - position[:, 0]
    with np.errstate(invalid="ignore"):
        accepted = (score >= min_score) & (peaks.second < ratio * peaks.score)
        accepted &= (disparity >= low - 0.5) & (disparity <= high + 0.5)
    accepted[has_peak] &= refined.converged | ~peaks.rising[has_peak]
    if left_right_check and accepted.any():
        accepted[accepted] = _returns(
            left, right, at[accepted], position[accepted], low[accepted], high[accepted], rows
        )
    return RowMatch(disparity, score, accepted, variance, position[:, 1])


def _returns(
    left: Image, right: Image, uv: FloatArray, in_right: FloatArray, low: FloatArray, high: FloatArray, rows: int
) -> BoolArray:
    """Whether the patches around `in_right` are found in the left image where they came from, (N,)."""
    nearest = np.rint(in_right[:, 1])
    first = np.stack([np.rint(in_right[:, 0] + low), nearest - rows], axis=1)
    last = np.stack([np.rint(in_right[:, 0] + high), nearest + rows], axis=1)
    back = best_peaks(left, cut_patches(right, in_right, PATCH), first, last)
    returned: BoolArray = np.abs(back.pixel[:, 0] + back.offset[:, 0] - uv[:, 0]) <= _RETURNS_WITHIN
    return returned & (back.score > -1.0)
