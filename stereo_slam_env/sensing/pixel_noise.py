"""Noise models of stereo measurements, each with its covariance R."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal, Protocol

import numpy as np

from filters import StereoNoise
from filters.contract.validation import positive
from filters.geometry.arrays import FloatArray


class PixelNoise(Protocol):
    """A noise model."""

    @property
    def stereo_noise(self) -> StereoNoise:
        """Covariance of the (u, v, d) that `corrupt` returns."""

    @property
    def largest_error(self) -> float:
        """No error of u, v or d is ever that large, px."""

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray | None]:
        """Add noise to true measurements (M, 3), px: left pixel and disparity.

        Returns the measured ones, and the rows (M,) measured in the right image where the model has such, else None.
        """


class IndependentPixels:
    """u_l, v_l, u_r and v_r independent, `sigma` px each; d = u_l - u_r, v = v_l."""

    def __init__(self, sigma: float) -> None:
        self.sigma = positive("sigma", sigma)
        self.stereo_noise = StereoNoise.independent_pixels(sigma)
        self.largest_error = 10.0 * self.sigma

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """See `PixelNoise.corrupt`; `v_right` is measured."""
        u_left, v_left, u_right, v_right = self._errors(rng, (4, len(uvd)))
        return uvd + np.stack([u_left, v_left, u_left - u_right], axis=1), uvd[:, 1] + v_right

    def _errors(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        return self.sigma * rng.standard_normal(shape)


class IndependentUvd:
    """u, v and d independent, `sigma` px each: the paper's assumption."""

    def __init__(self, sigma: float) -> None:
        self.sigma = positive("sigma", sigma)
        self.stereo_noise = StereoNoise.diagonal(sigma, sigma, sigma)
        self.largest_error = 10.0 * self.sigma

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, None]:
        """See `PixelNoise.corrupt`; there is no `v_right`."""
        return uvd + self.sigma * rng.standard_normal((len(uvd), 3)), None


class HeavyTailedPixels(IndependentPixels):
    """As `IndependentPixels`, but each coordinate has the error of a correlation matcher: sharp, with rare mismatches.

    The shape is that of `matching_errors`, scaled so that its standard deviation is `sigma`; R is then that of
    `IndependentPixels`, so that only the shape differs: at 1 px, 60 % of the errors have 0.03 px, 36 % 0.19 px, and 4 %
    are anywhere up to 8.6 px. The size as it was measured is `sigma = MATCHING_SIGMA`, 2.3 px.
    """

    def __init__(self, sigma: float) -> None:
        super().__init__(sigma)
        self.largest_error = 20.0 * self.sigma

    def _errors(self, rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
        return self.sigma / MATCHING_SIGMA * matching_errors(rng, shape)


_WEIGHTS, _SIGMAS, _REACH = (0.60, 0.36, 0.04), (0.07, 0.45), 20.0

MATCHING_SIGMA = math.sqrt(sum(w * s**2 for w, s in zip(_WEIGHTS, (*_SIGMAS, _REACH / math.sqrt(3.0)), strict=True)))
"""Standard deviation of `matching_errors`, px; 99 % of the variance is that of the mismatches."""


def matching_errors(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Errors of corners matched in rendered images, px.

    A mixture fitted to the disparities that normalised correlation and one Lucas-Kanade step found in OpenGL images of
    1344x391 pixels: 60 % have sigma 0.07 px, 36 % 0.45 px, and 4 % are uniform over +-20 px.
    """
    part = rng.choice(3, shape, p=_WEIGHTS)
    gaussian = rng.standard_normal(shape) * np.array([*_SIGMAS, 0.0])[part]
    return np.where(part == 2, rng.uniform(-_REACH, _REACH, shape), gaussian)


class QuantisedPixels(IndependentPixels):
    """As `IndependentPixels`, and then all four coordinates are rounded to whole pixels, so that d is whole, too.

    Rounding adds 1/12 px^2 to each, independent of the rest as long as landmarks fall anywhere between pixels.
    """

    def __init__(self, sigma: float) -> None:
        super().__init__(sigma)
        self.stereo_noise = StereoNoise.independent_pixels(float(np.sqrt(self.sigma**2 + 1.0 / 12.0)))
        self.largest_error += 1.0

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """See `PixelNoise.corrupt`; `v_right` is measured."""
        measured, v_right = super().corrupt(uvd, rng)
        u_left, v_left, u_right = np.rint([measured[:, 0], measured[:, 1], measured[:, 0] - measured[:, 2]])
        return np.stack([u_left, v_left, u_left - u_right], axis=1), np.rint(v_right)


NoiseName = Literal["pixels", "uvd", "heavy-tailed", "quantised"]
NOISE_MODELS: Mapping[str, Callable[[float], PixelNoise]] = {
    "pixels": IndependentPixels,
    "uvd": IndependentUvd,
    "heavy-tailed": HeavyTailedPixels,
    "quantised": QuantisedPixels,
}
