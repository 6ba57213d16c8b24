"""Inverse depth with measurement errors of the landmark's own that last: a Gauss-Markov process in (u, v, d).

Derivation: docs/derivations/inverse_depth.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.validation import covariance_matrix, positive
from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import compiled
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.landmark_model import Numbers

_point_of, _start_from = compiled(InverseDepth.point_of), compiled(InverseDepth.start_from)
_turned_by = compiled(InverseDepth.turned_by)


@dataclass(frozen=True)
class LastingErrors(InverseDepth):
    """(theta, phi, rho) from a shared anchor, and the errors of its u, v and d that last, px: six numbers each.

    No single measurement tells such an error from the place; it starts with its covariance, is forgotten, and shows
    when the camera has moved. To be measured by a `PairWithLastingErrors`.

    Parameters
    ----------
    covariance : (3, 3) array_like
        Of the errors, px^2, whenever they are looked at.
    time : float
        Time constant of a Gauss-Markov process of first order, s: their correlation after t is exp(-t / time).

    Raises
    ------
    ValueError
        The matrix is not symmetric and positive semidefinite, or the time is not a number > 0.
    """

    covariance: ArrayLike = ((0.5, 0.0, 0.5), (0.0, 0.5, 0.0), (0.5, 0.0, 1.0))
    time: float = 2.0
    shares_anchors: ClassVar[bool] = True
    submaps: ClassVar[bool] = False
    size: ClassVar[int] = 6
    value_size: ClassVar[int] = 6
    seen_size: ClassVar[int] = 7
    follows: ClassVar[tuple[int, ...]] = (2, 3, 4, 5)

    def __post_init__(self) -> None:
        matrix = covariance_matrix("covariance of lasting errors", self.covariance, 3)
        object.__setattr__(self, "covariance", tuple(map(tuple, matrix.tolist())))
        positive("time of lasting errors", self.time)

    @property
    def prior(self) -> FloatArray:  # type: ignore[override]
        """Prior covariance of the errors."""
        return np.array(self.covariance)

    @property
    def memory(self) -> float:  # type: ignore[override]
        """Time constant of the errors, s."""
        return self.time

    def point_of(self, y: Numbers) -> Numbers:
        """Ray and rho, then the errors."""
        h = _point_of(self, y)
        return h[0], h[1], h[2], h[3], y[3], y[4], y[5]

    def start_from(self, h: Numbers) -> Numbers:
        """Start of inverse depth, with the errors."""
        y = _start_from(self, h)
        return y[0], y[1], y[2], h[4], h[5], h[6]

    def turned_by(self, y: Numbers, theta: Numbers, c: Numbers) -> Numbers:
        """Turn the ray as inverse depth does, and add the errors."""
        ray = _turned_by(self, y, theta, c)
        return ray[0], ray[1], ray[2], y[3] + c[3], y[4] + c[4], y[5] + c[5]
