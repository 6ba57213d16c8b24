"""Positions between the pixels, where the correlation with a template is largest, and how well they are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.patches import FLAT, PATCH, Image, Patches, cut_stack

_PIXELS = PATCH * PATCH
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
    """Positions between the pixels.

    Attributes
    ----------
    position : (N, 2)
        (u, v), px.
    score : (N,)
        Correlation there.
    covariance : (N, 2, 2)
        Of the position, px^2.
    converged : (N,) bool
        The correlation has its maximum near the pixel; where not, the position is the top of the parabolas.
    """

    position: FloatArray
    score: FloatArray
    covariance: FloatArray
    converged: BoolArray


def refine(image: Image, templates: Patches, pixel: IntArray, offset: FloatArray) -> Refined:
    """Maximise the correlation over positions between the pixels (Lucas-Kanade, inverse compositional).

    A template t and a patch i(p), both brought to zero mean and unit length, have correlation t . i(p). With g the
    derivative of t by a shift, orthogonal to t, a patch taken a little off the best position is t + g (p - p_best), up
    to gain: Gauss-Newton steps are -(g g^T)^-1 g i / (t . i). The noise of t is not correlated with its own central
    differences, so the steps end without bias. Equal white noise in both patches makes 2 (1 - t . i) / 121 the
    variance of a difference, hence 2 (1 - t . i) / 121 (g g^T)^-1 the covariance of p while noise has little part in g.
    Where the steps lead away from the pixel, the top of the parabolas is kept.

    Parameters
    ----------
    image : (H, W) uint8
        Grey image.
    templates : (N, 11, 11) float32
        What was found.
    pixel, offset : (N, 2)
        Best pixel and where the parabolas have their top, from `best_peaks`.

    Returns
    -------
    Refined
    """
    stack = np.ascontiguousarray(templates.transpose(1, 2, 0))
    t, length = _normalised(stack)
    g_u, g_v = (_derivative(gradient, t, length) for gradient in _gradients(stack))
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


def _gradients(stack: Patches) -> tuple[Patches, Patches]:
    """Differences of (11, 11, N) along u and v: central ones, and at both ends those of neighbours."""
    along_u, along_v = np.empty_like(stack), np.empty_like(stack)
    for image, out in ((stack.swapaxes(0, 1), along_u.swapaxes(0, 1)), (stack, along_v)):
        np.subtract(image[2:], image[:-2], out=out[1:-1])
        out[1:-1] *= np.float32(0.5)
        np.subtract(image[1], image[0], out=out[0])
        np.subtract(image[-1], image[-2], out=out[-1])
    return along_u, along_v


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
