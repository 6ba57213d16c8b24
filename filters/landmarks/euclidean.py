"""Euclidean XYZ: a landmark is its position in W, which is far from Gaussian for distant points.

Derivation: docs/derivations/euclidean.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from filters.geometry.vectors import spread_by, turned_by
from filters.landmarks.landmark_model import LandmarkModel, Numbers


@dataclass(frozen=True)
class Euclidean(LandmarkModel):
    """A landmark is (X, Y, Z), m, in W."""

    submaps: ClassVar[bool] = True
    in_world: ClassVar[bool] = True

    def point_of(self, y: Numbers) -> Numbers:
        """(X, 1) (Eq. 9)."""
        return y[0], y[1], y[2], 1.0

    def start_from(self, h: Numbers) -> Numbers:
        """X = direction / scale (Eq. 21)."""
        return h[0] / h[3], h[1] / h[3], h[2] / h[3]

    def can_start_from(self, h: Numbers) -> Any:
        """Only a scale > 0 has a finite position in front of the camera."""
        return h[3] > 0.0

    def turned_by(self, y: Numbers, theta: Numbers, c: Numbers) -> Numbers:
        """Exp(theta) X + J_l(theta) c: the exponential of the group."""
        a, b = turned_by(theta, y), spread_by(theta, c)
        return a[0] + b[0], a[1] + b[1], a[2] + b[2]
