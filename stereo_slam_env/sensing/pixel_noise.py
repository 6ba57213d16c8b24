"""Noise on stereo measurements. Each model knows its covariance R, which says everything where it is Gaussian."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from filters.noise import StereoNoise
from filters.validation import FloatArray, positive


class PixelNoise(Protocol):
    """A noise model."""

    @property
    def stereo_noise(self) -> StereoNoise:
        """Covariance of the (u, v, d) that `corrupt` returns."""

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray | None]:
        """Add noise to true measurements.

        Parameters
        ----------
        uvd : (M, 3)
            True left pixel and disparity, px.
        rng : numpy.random.Generator
            Source of the noise.

        Returns
        -------
        uvd : (M, 3) ndarray
            Measured.
        v_right : (M,) ndarray or None
            Row measured in the right image, where the model has one of its own.
        """


class IndependentPixels:
    """u_l, v_l, u_r and v_r independent, `sigma` px each; d = u_l - u_r, v = v_l."""

    def __init__(self, sigma: float) -> None:
        self.sigma = positive("sigma", sigma)
        self.stereo_noise = StereoNoise.independent_pixels(sigma)

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """See `PixelNoise.corrupt`; `v_right` is measured."""
        u_left, v_left, u_right, v_right = self.sigma * rng.standard_normal((4, len(uvd)))
        return uvd + np.stack([u_left, v_left, u_left - u_right], axis=1), uvd[:, 1] + v_right


class IndependentUvd:
    """u, v and d independent, `sigma` px each: the paper's assumption."""

    def __init__(self, sigma: float) -> None:
        self.sigma = positive("sigma", sigma)
        self.stereo_noise = StereoNoise.diagonal(sigma, sigma, sigma)

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, None]:
        """See `PixelNoise.corrupt`; there is no `v_right`."""
        return uvd + self.sigma * rng.standard_normal((len(uvd), 3)), None


class HeavyTailedUvd:
    """u, v and d independent, each with the error of a correlation matcher: sharp, with rare gross mismatches.

    The shape is the mixture of two Gaussians and a uniform distribution that was fitted to the disparity errors of
    corners matched in rendered images of 1344x391 pixels (OpenGL, normalised correlation refined by one Lucas-Kanade
    step). It is scaled so that its standard deviation is `sigma`, as that of the other models, and R with it: at 1 px,
    60 % of the errors have 0.03 px, 36 % 0.18 px, and 4 % are anywhere up to 8.2 px. The size as it was measured is
    `sigma = HeavyTailedUvd.MEASURED_SIGMA`, 2.4 px.
    """

    WEIGHTS = (0.596, 0.360, 0.044)
    SIGMAS = (0.07, 0.45)
    """Of the Gaussians, px."""
    REACH = 20.0
    """Of the uniform distribution, to both sides, px."""
    MEASURED_SIGMA = float(np.sqrt(np.dot(WEIGHTS, (SIGMAS[0] ** 2, SIGMAS[1] ** 2, REACH**2 / 3.0))))

    def __init__(self, sigma: float) -> None:
        self.sigma = positive("sigma", sigma)
        self.stereo_noise = StereoNoise.diagonal(sigma, sigma, sigma)

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, None]:
        """See `PixelNoise.corrupt`; there is no `v_right`."""
        part, normal, uniform = rng.random(uvd.shape), rng.standard_normal(uvd.shape), rng.uniform(-1, 1, uvd.shape)
        sharp, blunt = self.WEIGHTS[0], self.WEIGHTS[0] + self.WEIGHTS[1]
        errors = np.where(part < sharp, self.SIGMAS[0], self.SIGMAS[1]) * normal
        errors = np.where(part < blunt, errors, self.REACH * uniform)
        return uvd + self.sigma / self.MEASURED_SIGMA * errors, None


class QuantisedPixels:
    """As `IndependentPixels`, and then all four coordinates are rounded to whole pixels, so that d is whole, too.

    Rounding adds 1/12 px^2 to each, independent of the rest as long as landmarks fall anywhere between pixels.
    """

    def __init__(self, sigma: float) -> None:
        self.sigma = positive("sigma", sigma)
        self.stereo_noise = StereoNoise.independent_pixels(float(np.sqrt(self.sigma**2 + 1.0 / 12.0)))
        self._before = IndependentPixels(sigma)

    def corrupt(self, uvd: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """See `PixelNoise.corrupt`; `v_right` is measured."""
        measured, v_right = self._before.corrupt(uvd, rng)
        u_left, v_left, u_right = np.rint([measured[:, 0], measured[:, 1], measured[:, 0] - measured[:, 2]])
        return np.stack([u_left, v_left, u_left - u_right], axis=1), np.rint(v_right)


NOISE_MODELS: dict[str, Callable[[float], PixelNoise]] = {
    "pixels": IndependentPixels,
    "uvd": IndependentUvd,
    "heavy-tailed": HeavyTailedUvd,
    "quantised": QuantisedPixels,
}
