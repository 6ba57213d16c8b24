"""Bearings on the sphere: with inverse distance (`Spherical`), or with log-distance (`Polar`).

Inverse distance is inverse depth without a singular direction, S^2 x R. With log-distance a landmark is moved by the
group SOT(3) of rotations and scalings about its anchor.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.geometry.machine_code import compiled
from filters.geometry.vectors import cross, spread_by, turned_by
from filters.landmarks.landmark_model import LandmarkModel, Numbers

_TURNED_OVER = 0.9
"""Below minus this z of a bearing its tangent basis is the other one; both are smooth there."""
_NOTHING = 1e-300
"""Added to a sine that may be zero; it changes no other number."""


@compiled
def tangent_basis(m: Numbers) -> tuple[Numbers, Numbers]:
    """Two unit vectors perpendicular to a bearing, smooth outside a circle far behind the start.

    The rotation by the shortest way from (0, 0, 1), or from (0, 0, -1), to m, applied to x and y (Duff et al.,
    "Building an orthonormal basis, revisited", JCGT 6(1), 2017).
    """
    x, y, z = m
    side = np.copysign(1.0, z + _TURNED_OVER)
    a = -1.0 / (side + z)
    return (1.0 + side * x * x * a, side * x * y * a, -side * x), (x * y * a, side + y * y * a, -y)


@compiled
def _axis(m: Numbers, c: Numbers) -> Numbers:
    """Rotation vector perpendicular to a bearing, from its two numbers in the tangent basis."""
    first, second = tangent_basis(m)
    return first[0] * c[0] + second[0] * c[1], first[1] * c[0] + second[1] * c[1], first[2] * c[0] + second[2] * c[1]


@compiled
def _unit(m: Numbers) -> Numbers:
    length = np.sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2])
    return m[0] / length, m[1] / length, m[2] / length


@dataclass(frozen=True)
class Spherical(LandmarkModel):
    """A landmark is a unit vector in W from its anchor, and rho: four numbers.

    Its error is a rotation perpendicular to the bearing, two numbers in `tangent_basis`, and that of rho.
    """

    anchored: ClassVar[bool] = True
    shares_anchors: ClassVar[bool] = True
    value_size: ClassVar[int] = 4
    follows: ClassVar[tuple[int, ...]] = (3,)

    def point_of(self, y: Numbers) -> Numbers:
        """(m, rho)."""
        return y

    def start_from(self, h: Numbers) -> Numbers:
        """Unit vector of the direction, and scale / length."""
        length = np.sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2])
        return h[0] / length, h[1] / length, h[2] / length, h[3] / length

    def retract_by(self, y: Numbers, c: Numbers) -> Numbers:
        """Exp(B a) m = cos|a| m + sin|a| / |a| (B a) x m, and the last number plus its correction."""
        m = y[0], y[1], y[2]
        angle = np.hypot(c[0], c[1])
        turn, cosine, ratio = cross(_axis(m, c), m), np.cos(angle), np.sinc(angle * (1.0 / np.pi))
        m = _unit((cosine * m[0] + ratio * turn[0], cosine * m[1] + ratio * turn[1], cosine * m[2] + ratio * turn[2]))
        return m[0], m[1], m[2], y[3] + c[2]

    def local_by(self, y: Numbers, other: Numbers) -> Numbers:
        """The rotation vector by the shortest way from bearing to bearing, in the basis of the first."""
        m, n = (y[0], y[1], y[2]), (other[0], other[1], other[2])
        first, second = tangent_basis(m)
        a = cross(m, n)
        sine = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) + _NOTHING
        ratio = np.arctan2(sine, m[0] * n[0] + m[1] * n[1] + m[2] * n[2]) / sine
        along = first[0] * a[0] + first[1] * a[1] + first[2] * a[2]
        across = second[0] * a[0] + second[1] * a[1] + second[2] * a[2]
        return ratio * along, ratio * across, other[3] - y[3]

    def turned_by(self, y: Numbers, theta: Numbers, c: Numbers) -> Numbers:
        """The bearing as a point of the group, as `InverseDepth` has it."""
        m = y[0], y[1], y[2]
        a, b = turned_by(theta, m), spread_by(theta, cross(_axis(m, c), m))
        m = _unit((a[0] + b[0], a[1] + b[1], a[2] + b[2]))
        return m[0], m[1], m[2], y[3] + c[2]


@dataclass(frozen=True)
class Polar(Spherical):
    """A landmark is a unit vector in W from its anchor, and the logarithm of its distance in metres.

    References
    ----------
    van Goor and Mahony, "EqVIO: An equivariant filter for visual-inertial odometry", IEEE TRO 39(5), 2023 (SOT(3)).
    """

    def point_of(self, y: Numbers) -> Numbers:
        """(m, rho) with rho = exp(-log-distance)."""
        return y[0], y[1], y[2], np.exp(-y[3])

    def start_from(self, h: Numbers) -> Numbers:
        """Unit vector of the direction, and log(length / scale)."""
        length = np.sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2])
        return h[0] / length, h[1] / length, h[2] / length, np.log(length / h[3])

    def can_start_from(self, h: Numbers) -> Any:
        """Only a scale > 0 has a distance."""
        return h[3] > 0.0
