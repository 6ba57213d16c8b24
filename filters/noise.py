"""Covariance of one stereo measurement (u, v, d).

Derivation: docs/derivations/camera.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters.validation import FloatArray, covariance_matrix, positive


@dataclass(frozen=True, eq=False)
class StereoNoise:
    """Covariance R of (u, v, d), px^2.

    Parameters
    ----------
    R : (3, 3) array_like
        Symmetric positive definite.

    Raises
    ------
    ValueError
        R is not a finite symmetric positive definite 3x3 matrix.
    """

    R: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "R", covariance_matrix("R", self.R, 3, definite=True))

    @classmethod
    def diagonal(cls, sigma_u: float, sigma_v: float, sigma_d: float) -> StereoNoise:
        """The paper's R: u, v and d independent (page of Eq. 25); standard deviations in px."""
        sigmas = [
            positive(n, s) for n, s in zip(("sigma_u", "sigma_v", "sigma_d"), (sigma_u, sigma_v, sigma_d), strict=True)
        ]
        return cls(np.diag(np.square(sigmas)))

    @classmethod
    def independent_pixels(cls, sigma: float) -> StereoNoise:
        """R of independent errors `sigma` px in u_left, v and u_right.

        d = u_left - u_right shares the error of u_left: R = sigma^2 [[1, 0, 1], [0, 1, 0], [1, 0, 2]].
        """
        return cls(positive("sigma", sigma) ** 2 * np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 2.0]]))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, StereoNoise) and bool(np.array_equal(self.R, other.R))

    def __hash__(self) -> int:
        return hash(self.R.tobytes())
