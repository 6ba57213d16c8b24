"""Measurements of other cameras: an unrectified pair, a depth camera, and a pair of fisheye cameras.

The unrectified pair has intrinsics and a pose for each camera; the depth camera gives (u, v, z); the fisheye cameras
are equidistant, r = f theta, with parallel axes, and see beyond 90 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from filters.contract.validation import finite_array, positive
from filters.geometry.machine_code import compiled
from filters.geometry.vectors import plus, scaled, turned_by
from filters.measurements.measurement_model import MeasurementModel, Numbers

_UNKNOWN = float("nan")


@dataclass(frozen=True)
class UnrectifiedPair(MeasurementModel):
    """The numbers are (u_left, v_left, u_left - u_right) and v_right, px; undistorted.

    Parameters
    ----------
    left, right : (4,) sequence of float, optional
        Intrinsics fx, fy, cx, cy, px; None: those of the `StereoCamera`.
    left_pose, right_pose : (6,) sequence of float, optional
        Position, m, and rotation vector, rad, in the camera frame C whose pose the filter estimates. None: C itself,
        and the baseline to its right, so that without any settings the pair is rectified.
    """

    left: Sequence[float] | None = None
    right: Sequence[float] | None = None
    left_pose: Sequence[float] | None = None
    right_pose: Sequence[float] | None = None
    size: ClassVar[int] = 4

    def __post_init__(self) -> None:
        for name, count in (("left", 4), ("right", 4), ("left_pose", 6), ("right_pose", 6)):
            value = getattr(self, name)
            if value is None or (isinstance(value, tuple) and value == (_UNKNOWN,) * count):
                object.__setattr__(self, name, (_UNKNOWN,) * count)
                continue
            numbers = finite_array(name, value, (count,))
            if count == 4 and not (numbers[:2] > 0.0).all():
                raise ValueError(f"{name} must begin with focal lengths > 0, got {numbers.tolist()}")
            object.__setattr__(self, name, tuple(numbers.tolist()))

    def project(self, camera: Any, h: Numbers, values: Any = None) -> Numbers:
        """Both pixels, each K R^T (direction - scale t)."""
        u, v = _pinhole(_or_usual(self.left, camera), _or_at(self.left_pose, 0.0), h)
        u_right, v_right = _pinhole(_or_usual(self.right, camera), _or_at(self.right_pose, camera.baseline), h)
        return u, v, u - u_right, v_right

    def unproject(self, camera: Any, uvd: Numbers, values: Any = None) -> Numbers:
        """The left ray m from t_left, and the scale at which the right eye sees it in column u_right.

        The point is t_left + m / scale, in the right eye a + scale b, so that x (a_z + scale b_z) = a_x + scale b_x.
        """
        K, left = _or_usual(self.left, camera), _or_at(self.left_pose, 0.0)
        K_right, right = _or_usual(self.right, camera), _or_at(self.right_pose, camera.baseline)
        m = turned_by(left[3:], ((uvd[0] - K[2]) / K[0], (uvd[1] - K[3]) / K[1], 1.0))
        a, b = turned_by(scaled(-1.0, right[3:]), m), turned_by(scaled(-1.0, right[3:]), plus(left, right, -1.0))
        x = (uvd[0] - uvd[2] - K_right[2]) / K_right[0]
        scale = (x * a[2] - a[0]) / (b[0] - x * b[2])
        return m[0] + scale * left[0], m[1] + scale * left[1], m[2] + scale * left[2], scale


@compiled
def _or_usual(own: Numbers, camera: Any) -> Numbers:
    """Intrinsics, those of the rig where there are none."""
    if own[0] == own[0]:
        return own
    return camera.fx, camera.fy, camera.cx, camera.cy


@compiled
def _or_at(pose: Numbers, x: float) -> Numbers:
    """Pose, that of an eye at x without a turn where there is none."""
    if pose[0] == pose[0]:
        return pose
    return x, 0.0, 0.0, 0.0, 0.0, 0.0


@compiled
def _pinhole(K: Numbers, pose: Numbers, h: Numbers) -> Numbers:
    """Pixel of a homogeneous point in an eye at a pose in the camera frame."""
    x, y, z = turned_by(scaled(-1.0, pose[3:]), plus(h, pose, -1.0 * h[3]))
    return K[0] * x / z + K[2], K[1] * y / z + K[3]


@dataclass(frozen=True)
class DepthCamera(MeasurementModel):
    """Columns of `uvd` are (u, v, z), px and m, and so is their R. Of the camera the intrinsics are used."""

    def project(self, camera: Any, h: Numbers, values: Any = None) -> Numbers:
        """The pixel, and z = direction_z / scale."""
        return camera.fx * h[0] / h[2] + camera.cx, camera.fy * h[1] / h[2] + camera.cy, h[2] / h[3]

    def unproject(self, camera: Any, uvd: Numbers, values: Any = None) -> Numbers:
        """The ray at z = 1, and 1 / z as its scale; no depth <= 0 is that of a point: it is not finite."""
        root = np.sqrt(uvd[2])
        return (uvd[0] - camera.cx) / camera.fx, (uvd[1] - camera.cy) / camera.fy, 1.0, 1.0 / (root * root)

    def can_see(self, h: Numbers) -> Any:
        """A finite depth ahead: a point at infinity or beyond has none."""
        return (h[2] > 0.0) & (h[3] > 0.0)


_LEAST = 0.2  # of the disparity ahead: with less, along the baseline and far behind it, no landmark is started
_BESIDE = 1e-16  # square of the tangent of an angle whose cosine is one


@dataclass(frozen=True)
class FisheyePair(MeasurementModel):
    """The numbers are (u_left, v_left, u_left - u_right) and v_right, px.

    Parameters
    ----------
    half_angle : float
        Largest angle to the axis at which a point is seen, rad.
    """

    half_angle: float = 1.8
    size: ClassVar[int] = 4

    def __post_init__(self) -> None:
        positive("half_angle", self.half_angle)

    def project(self, camera: Any, h: Numbers, values: Any = None) -> Numbers:
        """Both pixels; the right camera sees direction - scale (baseline, 0, 0)."""
        u, v = _pixel(camera, h[0], h[1], h[2])
        u_right, v_right = _pixel(camera, h[0] - h[3] * camera.baseline, h[1], h[2])
        return u, v, u - u_right, v_right

    def unproject(self, camera: Any, uvd: Numbers, values: Any = None) -> Numbers:
        """The left ray, and the scale that gives the disparity; NaN where the disparity says too little.

        The left ray is m = (sin a, cos a n), n in the plane x = 0, the right one (sin a', cos a' n), and tan a' =
        (sin a - scale baseline) / cos a. The right column, nearly linear in a', gives a' by six passes of Newton's
        method. Within two baselines and beyond 90 degrees from the axis two points can give the same numbers: one is
        returned.
        """
        x, y = (uvd[0] - camera.cx) / camera.fx, (uvd[1] - camera.cy) / camera.fy
        theta = np.sqrt(x * x + y * y)
        ratio = np.sinc(theta * (1.0 / np.pi))
        m = ratio * x, ratio * y, np.cos(theta)
        across = np.sqrt(m[1] * m[1] + m[2] * m[2])
        n, target = (m[1] / across, m[2] / across), uvd[0] - uvd[2]
        a = np.arctan2(m[0], across)
        turned = a
        column, slope = _column(camera, turned, n)
        for _ in range(6):
            turned = turned - (column - target) / slope
            column, slope = _column(camera, turned, n)
        sine, cosine = np.sin(a), np.cos(a)
        scale = (sine - cosine * np.tan(turned)) / camera.baseline
        astray = (np.abs(column - target) > 1e-6) | (np.cos(turned) <= 0.0)
        if astray | (np.abs(slope) * cosine <= _LEAST * camera.fx):
            scale = scale * np.nan
        return m[0], m[1], m[2], scale

    def can_see(self, h: Numbers) -> Any:
        """Up to `half_angle` from the axis."""
        return np.arctan2(np.hypot(h[0], h[1]), h[2]) < self.half_angle


@compiled
def _angle(x: Any, y: Any, z: Any) -> Any:
    """Distance from the axis, and angle to it; at the axis as if beside it by less than rounding, for derivatives."""
    off_axis = np.sqrt(x * x + y * y + _BESIDE * z * z)
    return off_axis, np.arctan2(off_axis, z)


@compiled
def _pixel(camera: Any, x: Any, y: Any, z: Any) -> Numbers:
    """f theta along the direction in the image."""
    off_axis, theta = _angle(x, y, z)
    ratio = theta / off_axis
    return camera.fx * (x * ratio) + camera.cx, camera.fy * (y * ratio) + camera.cy


@compiled
def _column(camera: Any, a: Any, n: Numbers) -> Numbers:
    """Column of the ray (sin a, cos a n), and its derivative by a."""
    x, cosine = np.sin(a), np.cos(a)
    y, z = cosine * n[0], cosine * n[1]
    r, theta = _angle(x, y, z)
    by_a = (x * cosine - x * (y * n[0] + _BESIDE * z * n[1])) / r
    theta_by_a = (z * by_a + r * (x * n[1])) / (r * r + z * z)
    slope = cosine * theta / r + x * (theta_by_a * r - theta * by_a) / (r * r)
    return camera.fx * (x * (theta / r)) + camera.cx, camera.fx * slope
