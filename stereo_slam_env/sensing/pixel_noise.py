"""Gaussian noise on stereo measurements. Each model knows the R that describes it."""

from __future__ import annotations

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


NOISE_MODELS: dict[str, type[IndependentPixels] | type[IndependentUvd]] = {
    "pixels": IndependentPixels,
    "uvd": IndependentUvd,
}
