"""A pair of equidistant fisheye cameras, r = f theta, with parallel axes; they see beyond 90 degrees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.validation import positive
from filters.geometry import differences
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel, SensorJacobians, Values

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
        return SensorJacobians(differences.jacobian(lambda e: np.column_stack(_point(camera, uvd + e)), 3), {})

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
            slope = differences.jacobian(lambda e, at=turned: column(at + e), 1)[:, 0]  # type: ignore[misc]
            turned = turned - (column(turned) - (uvd[:, 0] - uvd[:, 2])) / slope
        scale = (np.sin(a) - np.cos(a) * np.tan(turned)) / camera.baseline
        found = (np.abs(column(turned) - (uvd[:, 0] - uvd[:, 2])) < 1e-6) & (np.cos(turned) > 0.0)  # else astray
    return m, np.where(found & (np.abs(slope) * np.cos(a) > least * camera.fx), scale, np.nan)
