"""Zero-mean normalised cross-correlation of patches with an image: its peaks, and their places between the pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.compiled import note_peaks, note_refined
from stereo_slam_env.frontend.patches import PATCH, Image, Patches

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
