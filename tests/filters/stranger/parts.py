"""What a stranger writes against the public face alone: a landmark on S^3 and a double-sphere camera.

None of it is known to the engine; `test_stranger.py` checks, drives and times it, with the inertial motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import LandmarkModel, MeasurementModel


def _number(name: str, value: object, low: float, high: float) -> None:
    if not isinstance(value, int | float) or not low <= value <= high or not np.isfinite(value):
        raise ValueError(f"{name} must be a finite number from {low} to {high}, got {value!r}")


def _columns(q):
    """q i, q j, q k of the quaternion q: a basis of the tangent space, smooth everywhere."""
    x, y, z, w = q
    return (w, z, -y, -x), (-z, w, x, -y), (y, -x, w, -z)


def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@dataclass(frozen=True)
class OnS3(LandmarkModel):
    """A homogeneous point on the unit sphere S^3 in W, without an anchor: regular at infinity."""

    value_size = 4

    def point_of(self, y):
        """(x, w)."""
        return y

    def start_from(self, h):
        """Normalised."""
        length = np.sqrt(_dot(h, h))
        return h[0] / length, h[1] / length, h[2] / length, h[3] / length

    def retract_by(self, y, c):
        """Along the great circle of the basis."""
        i, j, k = _columns(y)
        angle = np.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
        cosine, ratio = np.cos(angle), np.sinc(angle / np.pi)
        return (
            cosine * y[0] + ratio * (c[0] * i[0] + c[1] * j[0] + c[2] * k[0]),
            cosine * y[1] + ratio * (c[0] * i[1] + c[1] * j[1] + c[2] * k[1]),
            cosine * y[2] + ratio * (c[0] * i[2] + c[1] * j[2] + c[2] * k[2]),
            cosine * y[3] + ratio * (c[0] * i[3] + c[1] * j[3] + c[2] * k[3]),
        )

    def local_by(self, y, other):
        """The way back, in the basis."""
        i, j, k = _columns(y)
        a, b, c = _dot(i, other), _dot(j, other), _dot(k, other)
        sine = np.sqrt(a * a + b * b + c * c) + 1e-300
        longer = np.arctan2(sine, _dot(y, other)) / sine
        return longer * a, longer * b, longer * c


@dataclass(frozen=True)
class AnchoredOnS3(OnS3):
    """The same with the place of the first sight as its origin."""

    anchored = True


def _pixel(xi, alpha, x, y, z):
    d1 = np.sqrt(x * x + y * y + z * z)
    z1 = xi * d1 + z
    below = alpha * np.sqrt(x * x + y * y + z1 * z1) + (1.0 - alpha) * z1
    return x / below, y / below


@dataclass(frozen=True)
class DoubleSphere(MeasurementModel):
    """A pair of double-sphere cameras (Usenko et al. 2018) with parallel axes; numbers (u, v, u - u_right), v_right."""

    xi: float = -0.2
    alpha: float = 0.55
    size = 4

    def __post_init__(self) -> None:
        _number("xi", self.xi, -1.0, 1.0)
        _number("alpha", self.alpha, 0.0, 1.0)

    def project(self, camera, h):
        """Both pixels; the right camera sees direction - scale (baseline, 0, 0)."""
        x, y = _pixel(self.xi, self.alpha, h[0], h[1], h[2])
        x_right, y_right = _pixel(self.xi, self.alpha, h[0] - h[3] * camera.baseline, h[1], h[2])
        d = camera.fx * (x - x_right)
        return camera.fx * x + camera.cx, camera.fy * y + camera.cy, d, camera.fy * y_right + camera.cy

    def unproject(self, camera, uvd):
        """The left ray by the inverse of the model, the scale by Newton's method on the right column."""
        x, y, a, b = (uvd[0] - camera.cx) / camera.fx, (uvd[1] - camera.cy) / camera.fy, self.alpha, camera.baseline
        r2 = x * x + y * y
        mz = (1.0 - a * a * r2) / (a * np.sqrt(1.0 - (2.0 * a - 1.0) * r2) + 1.0 - a)
        k = (mz * self.xi + np.sqrt(mz * mz + (1.0 - self.xi * self.xi) * r2)) / (mz * mz + r2)
        x, y, z, wanted = k * x, k * y, k * mz - self.xi, x - uvd[2] / camera.fx
        scale = uvd[2] / (camera.fx * b)
        for _ in range(8):
            here, _y = _pixel(self.xi, a, x - scale * b, y, z)
            ahead, _y = _pixel(self.xi, a, x - (scale + 1e-6) * b, y, z)
            behind, _y = _pixel(self.xi, a, x - (scale - 1e-6) * b, y, z)
            scale = scale - (here - wanted) * 2e-6 / (ahead - behind)
        return x, y, z, scale

    def can_see(self, h):
        """Where the projection is one-to-one, with some room."""
        return h[2] > 0.1 * np.sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2])
