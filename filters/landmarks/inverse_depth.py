"""Inverse depth: y = (x, y, z, theta, phi, rho) of Eq. 3, with own or shared anchors; hybrid: XYZ once it is linear.

rho is inverse *distance* along the ray (Eq. 22). It may be zero or negative: a measurement with d <= 0 is kept as
the forward ray with rho <= 0, which has the same projection as the literal Eq. 21-24 (a point behind the camera).

Landmarks that enter the map in one frame would all copy the same camera position, so their anchor rows of P are equal
and stay equal under every Kalman update: with one shared anchor the estimate is that of six-dimensional inverse depth,
in 3 n + 3 k instead of 6 n numbers.

Derivation: docs/derivations/inverse_depth.md.

Civera's linearity index tells (Civera, Davison and Montiel 2008). At first sight by a stereo pair it is 4 sigma_d / d.

Derivation: docs/derivations/euclidean.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.contract.validation import positive
from filters.geometry.machine_code import compiled
from filters.geometry.vectors import spread_by, turned_by
from filters.landmarks.landmark_model import LandmarkModel, Numbers

# Square of the tangent of the angle to the vertical below which azimuth is undefined in double precision.
_VERTICAL = 1e-12


@compiled
def ray_of(theta: Any, phi: Any) -> Numbers:
    """Unit vector m(theta, phi) of Eq. 5, in W."""
    across = np.cos(phi)
    return across * np.sin(theta), -np.sin(phi), across * np.cos(theta)


@compiled
def angles_of(m: Numbers) -> Numbers:
    """Azimuth and elevation of a direction (Eq. 24)."""
    return np.arctan2(m[0], m[2]), np.arctan2(-m[1], np.hypot(m[0], m[2]))


@dataclass(frozen=True)
class InverseDepth(LandmarkModel):
    """Inverse depth with one anchor a landmark: six numbers each."""

    anchored: ClassVar[bool] = True
    submaps: ClassVar[bool] = True
    follows: ClassVar[tuple[int, ...]] = (2,)

    def point_of(self, y: Numbers) -> Numbers:
        """(m, rho): Eq. 8 multiplied by rho, so regular at rho = 0."""
        m = ray_of(y[0], y[1])
        return m[0], m[1], m[2], y[2]

    def start_from(self, h: Numbers) -> Numbers:
        """theta, phi and rho (Eq. 22-24); the anchor is the camera position (Eq. 20)."""
        theta, phi = angles_of(h)
        return theta, phi, h[3] / np.sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2])

    def can_start_from(self, h: Numbers) -> Any:
        """All but rays along the vertical of W, where the azimuth is undefined."""
        return h[0] * h[0] + h[2] * h[2] > _VERTICAL * (h[1] * h[1])

    def turned_by(self, y: Numbers, theta: Numbers, c: Numbers) -> Numbers:
        """The ray as a point of the group, Exp(theta) m + J_l(theta) b, b what the correction moves it by; rho adds.

        A correction that only takes back what the turn does leaves the ray where it is, however far the turn is.
        """
        st, ct, sp, cp = np.sin(y[0]), np.cos(y[0]), np.sin(y[1]), np.cos(y[1])
        moved = cp * ct * c[0] - sp * st * c[1], -cp * c[1], -cp * st * c[0] - sp * ct * c[1]
        a, b = turned_by(theta, (cp * st, -sp, cp * ct)), spread_by(theta, moved)
        azimuth, elevation = angles_of((a[0] + b[0], a[1] + b[1], a[2] + b[2]))
        return azimuth, elevation, y[2] + c[2]


@dataclass(frozen=True)
class SharedAnchorInverseDepth(InverseDepth):
    """`InverseDepth` whose anchors are shared by the landmarks of one frame."""

    shares_anchors: ClassVar[bool] = True


@dataclass(frozen=True)
class Hybrid(InverseDepth):
    """Inverse depth with shared anchors, or XYZ without an anchor.

    Parameters
    ----------
    linearity_limit : float or None
        A landmark becomes XYZ as soon as its linearity index is below this; None: never. The default keeps the pose
        consistent on the reference drive, Civera's 0.1 does not (docs/verification.md).
    """

    linearity_limit: float | None = 0.03
    shares_anchors: ClassVar[bool] = True
    submaps: ClassVar[bool] = False
    steady: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.linearity_limit is not None:
            positive("linearity_limit", self.linearity_limit)

    def becomes_point(self, to_anchor: Numbers, y: Numbers, variances: Numbers) -> Any:
        """Whether Civera's linearity index L_d = 4 sigma_depth |cos alpha| / d_1 is below the limit.

        sigma_depth = sigma_rho / rho^2 is along the first ray, d_1 the distance from here, alpha the angle between the
        two rays (the parallax). Never where rho <= 0.
        """
        m, rho = ray_of(y[0], y[1]), y[2]
        x, y_, z = rho * to_anchor[0] + m[0], rho * to_anchor[1] + m[1], rho * to_anchor[2] + m[2]
        across, squared = np.abs(x * m[0] + y_ * m[1] + z * m[2]), x * x + y_ * y_ + z * z
        sigma = np.sqrt(np.maximum(variances[2], 0.0))
        limit = 0.0 if self.linearity_limit is None else self.linearity_limit
        return (rho > 0.0) & (4.0 * sigma * across < limit * rho * squared)
