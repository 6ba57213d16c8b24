"""An unrectified pair: two pinhole cameras, each with intrinsics and a pose of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.validation import finite_array
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel, Values


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
