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
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.measurements.measurement_model import MeasurementModel, Numbers, SensorJacobians, Values


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
            if getattr(self, name) is not None:
                numbers = finite_array(name, getattr(self, name), (count,))
                if count == 4 and not (numbers[:2] > 0.0).all():
                    raise ValueError(f"{name} must begin with focal lengths > 0, got {numbers.tolist()}")
                object.__setattr__(self, name, tuple(numbers.tolist()))

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """Both pixels, each K (R^T (direction - scale t))."""
        pixels = []
        for intrinsics, t, R in self._eyes(camera):
            seen = (points_c[..., :3] - points_c[..., 3:] * t) @ R
            with np.errstate(divide="ignore", invalid="ignore"):
                pixels.append(intrinsics[:2] * seen[..., :2] / seen[..., 2:] + intrinsics[2:])
        left, right = pixels
        return np.concatenate([left, left[..., :1] - right[..., :1], right[..., 1:]], axis=-1)

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The left ray m from t_left, and the scale at which the right eye sees it in column u_right.

        The point is t_left + m / scale, in the right eye a + scale b, so that x (a_z + scale b_z) = a_x + scale b_x.
        """
        (left, t_left, R_left), (right, t_right, R_right) = self._eyes(camera)
        m = np.column_stack([(uvd[:, :2] - left[2:]) / left[:2], np.ones(len(uvd))]) @ R_left.T
        a, b = m @ R_right, (t_left - t_right) @ R_right
        x = (uvd[:, 0] - uvd[:, 2] - right[2]) / right[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = (x * a[:, 2] - a[:, 0]) / (b[0] - x * b[2])
        return np.column_stack([m + scale[:, None] * t_left, scale])

    def _eyes(self, camera: StereoCamera) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Intrinsics, position and rotation of the left and of the right camera."""
        usual = (camera.fx, camera.fy, camera.cx, camera.cy)
        beside = (camera.baseline, 0.0, 0.0, 0.0, 0.0, 0.0)
        eyes = ((self.left, self.left_pose or (0.0,) * 6), (self.right, self.right_pose or beside))
        return [(np.array(own or usual), np.array(pose[:3]), rotations.exp(pose[3:])) for own, pose in eyes]


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

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """Both pixels; the right camera sees direction - scale (baseline, 0, 0)."""
        left = _pixels(camera, points_c[..., :3])
        right = _pixels(camera, points_c[..., :3] - points_c[..., 3:] * [camera.baseline, 0.0, 0.0])
        return np.concatenate([left, left[..., :1] - right[..., :1], right[..., 1:]], axis=-1)

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The left ray, and the scale that gives the disparity; NaN where the disparity says too little.

        Within two baselines and beyond 90 degrees from the axis two points can give the same numbers: one is returned.
        """
        return np.column_stack(_point(camera, uvd, _LEAST))

    def backprojection_jacobians(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> SensorJacobians:
        """By differences, which nothing refuses."""
        return SensorJacobians(derivatives.jacobian(lambda e: np.column_stack(_point(camera, uvd + e)), 3), {})

    def in_front(self, points_c: FloatArray) -> BoolArray:
        """Up to `half_angle` from the axis."""
        angle = np.arctan2(np.hypot(points_c[:, 0], points_c[:, 1]), points_c[:, 2])
        return np.asarray(angle < self.half_angle, dtype=np.bool_)


def _pixels(camera: StereoCamera, directions: FloatArray) -> FloatArray:
    """f theta along the direction in the image; (..., 3) -> (..., 2)."""
    off_axis = np.maximum(np.hypot(directions[..., 0], directions[..., 1]), 1e-300)
    ratio = np.arctan2(off_axis, directions[..., 2]) / off_axis
    return directions[..., :2] * ratio[..., None] * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def _point(camera: StereoCamera, uvd: FloatArray, least: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """The left ray (sin a, cos a n), n in the plane x = 0, and the scale: tan a' = (sin a - scale baseline) / cos a.

    The right ray is (sin a', cos a' n). Its column, nearly linear in a', gives a' by six passes of Newton's method.
    """
    flat = (uvd[:, :2] - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    theta = np.linalg.norm(flat, axis=1, keepdims=True)
    m = np.hstack([np.sinc(theta / np.pi) * flat, np.cos(theta)])

    def column(angle: FloatArray) -> FloatArray:
        return _pixels(camera, np.column_stack([np.sin(angle), np.cos(angle)[:, None] * n]))[:, 0]

    with np.errstate(divide="ignore", invalid="ignore"):
        n = m[:, 1:] / np.linalg.norm(m[:, 1:], axis=1, keepdims=True)
        turned = a = np.arcsin(np.clip(m[:, 0], -1.0, 1.0))
        for _ in range(6):
            slope = derivatives.jacobian(lambda e, at=turned: column(at + e), 1)[:, 0]  # type: ignore[misc]
            turned = turned - (column(turned) - (uvd[:, 0] - uvd[:, 2])) / slope
        scale = (np.sin(a) - np.cos(a) * np.tan(turned)) / camera.baseline
        found = (np.abs(column(turned) - (uvd[:, 0] - uvd[:, 2])) < 1e-6) & (np.cos(turned) > 0.0)  # else astray
    return m, np.where(found & (np.abs(slope) * np.cos(a) > least * camera.fx), scale, np.nan)
