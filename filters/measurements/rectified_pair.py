"""The rectified pair: (u, v, d) of Eq. 7-10, and four ways to use a frame of it.

The noise of all is derived from the R of (u, v, d): left T_l R T_l^T, right T_r R T_r^T with u_right = u - d. Where the
right row is not measured on its own it is the left one, and carries no information: it is not counted twice, unless a
`copied_row_variance` asks for it, as a filter does that takes v_right = v for a measurement (the paper's rival).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.observation import StereoObservation
from filters.geometry.camera import StereoCamera
from filters.measurements.model import MeasurementModel, SensorJacobians, Stage, Values
from filters.validation import FloatArray, positive

LEFT = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
RIGHT = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_ALL = np.eye(3)


class RectifiedPair(MeasurementModel):
    """Base of the models of a rectified pair: they differ in the stages of an update."""

    def predict(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> FloatArray:
        """(u, v, d) of Eq. 10."""
        return camera.project_scaled(points_c[..., :3], points_c[..., 3])

    def jacobians(self, camera: StereoCamera, points_c: FloatArray, values: Values) -> SensorJacobians:
        """Of Eq. 10."""
        return SensorJacobians(camera.project_scaled_jacobian(points_c[..., :3], points_c[..., 3]), {})

    def backproject(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> FloatArray:
        """The ray at z = 1, and d / (f b) as its scale (Eq. 21)."""
        return np.column_stack([camera.ray(uvd), uvd[:, 2] / camera.disparity_constant])

    def backprojection_jacobians(self, camera: StereoCamera, uvd: FloatArray, values: Values) -> SensorJacobians:
        """Constant: the ray is linear in the pixel, the scale in d."""
        J = np.zeros((4, 3))
        J[0, 0], J[1, 1], J[3, 2] = 1.0 / camera.fx, 1.0 / camera.fy, 1.0 / camera.disparity_constant
        return SensorJacobians(np.broadcast_to(J, (len(uvd), 4, 3)), {})


@dataclass(frozen=True)
class RangeBearing(RectifiedPair):
    """The paper's: one joint update with (u, v, d). A separately measured right row is not used."""

    kernel: ClassVar[str | None] = "joint"

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """One."""
        return (Stage(observation.uvd, _ALL, R),)


@dataclass(frozen=True)
class _BothCameras(RectifiedPair):
    """Measurement models that use the right camera's row.

    Parameters
    ----------
    copied_row_variance : float or None
        Where v_right is not measured on its own, take the left v for it with this many times its variance: 1 counts
        one measurement twice, infinity not at all. None: leave the row out.
    """

    copied_row_variance: float | None = None

    def __post_init__(self) -> None:
        if self.copied_row_variance is not None:
            positive("copied_row_variance", self.copied_row_variance)


@dataclass(frozen=True)
class LeftThenRight(_BothCameras):
    """Two updates in sequence, left then right, the second linearised at the result of the first."""

    kernel: ClassVar[str | None] = "sequential"

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """Two."""
        return (left_stage(observation, R), right_stage(observation, R, self.copied_row_variance))


@dataclass(frozen=True)
class Stacked(_BothCameras):
    """One update with the pixels of both cameras, with the correlation of u and u_right that R implies.

    The error of v_right is taken as independent of the other three.
    """

    kernel: ClassVar[str | None] = "stacked"

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """One."""
        right = right_stage(observation, R, self.copied_row_variance)
        T = np.vstack([LEFT, right.T])
        joint = T @ R @ T.T
        if len(right.T) == 2:
            joint[:, 3, :3] = joint[:, :3, 3] = 0.0
            joint[:, 3, 3] = right.R[:, 1, 1]
        return (Stage(np.hstack([observation.uvd[:, :2], right.z]), T, joint),)


@dataclass(frozen=True)
class LeftOnly(RectifiedPair):
    """Monocular updates: the left pixel. The disparity serves for initialisation only."""

    kernel: ClassVar[str | None] = "left"

    def stages(self, observation: StereoObservation, R: FloatArray) -> tuple[Stage, ...]:
        """One."""
        return (left_stage(observation, R),)


def left_stage(observation: StereoObservation, R: FloatArray) -> Stage:
    """(u, v) of the left camera."""
    return Stage(observation.uvd[:, :2], LEFT, LEFT @ R @ LEFT.T)


def right_stage(observation: StereoObservation, R: FloatArray, copied_row_variance: float | None = None) -> Stage:
    """(u_right, v_right) of the right camera; u_right alone where v_right is not measured and not to be copied."""
    copied = observation.v_right is None
    T = RIGHT[:1] if copied and copied_row_variance is None else RIGHT
    z = observation.uvd @ T.T
    if observation.v_right is not None:
        z[:, 1] = observation.v_right
    noise = T @ R @ T.T
    if copied and copied_row_variance is not None:
        noise[:, 1, 1] *= copied_row_variance
        noise[:, 0, 1] = noise[:, 1, 0] = 0.0
    return Stage(z, T, noise)
