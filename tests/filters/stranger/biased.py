"""A stranger's landmark of four error numbers: inverse depth, and a bias of the disparity that is the landmark's own.

Stereo matching errs by the same amount on the same patch for many frames. No single measurement tells the bias from the
depth; it starts at zero with a prior, and shows when the camera has moved.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import InverseDepth, RangeBearing


@dataclass(frozen=True)
class Biased(InverseDepth):
    """(theta, phi, rho) from a shared anchor, and the bias, px.

    Parameters
    ----------
    sigma : float
        Standard deviation of the biases, px.
    """

    sigma: float = 2.0
    shares_anchors = True
    size = value_size = 4
    seen_size = 5
    follows = (2, 3)

    def __post_init__(self):
        if not (isinstance(self.sigma, int | float) and 0.0 <= self.sigma < np.inf):
            raise ValueError(f"sigma must be a number of px >= 0, got {self.sigma!r}")

    @property
    def prior(self):
        """Of the bias."""
        return np.array([[float(self.sigma) ** 2]])

    def point_of(self, y):
        """Direction, scale, bias."""
        return *_point_of(self, y), y[3]

    def start_from(self, h):
        """As inverse depth, and the bias."""
        return *_start_from(self, h), h[4]

    def turned_by(self, y, theta, c):
        """As inverse depth; the bias is added."""
        return *_turned_by(self, y, theta, c), y[3] + c[3]


_point_of, _start_from, _turned_by = InverseDepth.point_of, InverseDepth.start_from, InverseDepth.turned_by


@dataclass(frozen=True)
class BiasedPair(RangeBearing):
    """(u, v, d) of a rectified pair, d with the bias of the landmark."""

    seen_size = 5

    def project(self, camera, h):
        """Eq. 10, and the bias."""
        u, v, d = _project(self, camera, h)
        return u, v, d + h[4]

    def unproject(self, camera, uvd):
        """The point as if there were no bias."""
        return *_unproject(self, camera, uvd), 0.0


_project, _unproject = RangeBearing.project, RangeBearing.unproject
