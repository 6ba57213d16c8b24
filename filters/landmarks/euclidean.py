"""Euclidean XYZ: a landmark is its position in W, which is far from Gaussian for distant points.

Derivation: docs/derivations/euclidean.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.landmarks.landmark_model import LandmarkKernels, LandmarkModel, ScaledPoints, StartedLandmarks


def _point(settings: FloatArray, values: FloatArray, points: FloatArray, J: FloatArray) -> None:
    for i in range(len(values)):
        points[i, 3] = 1.0
        for a in range(3):
            points[i, a] = values[i, a]
            J[i, a, a] = 1.0


def _start(settings: FloatArray, points: FloatArray, values: FloatArray, J: FloatArray, possible: BoolArray) -> None:
    for i in range(len(values)):
        scale = points[i, 3]
        possible[i] = scale > 0.0
        for a in range(3):
            values[i, a] = points[i, a] / scale
            J[i, a, a], J[i, a, 3] = 1.0 / scale, -points[i, a] / (scale * scale)


@dataclass(frozen=True)
class Euclidean(LandmarkModel):
    """A landmark is (X, Y, Z), m, in W."""

    submaps: ClassVar[bool] = True
    kernels: ClassVar[LandmarkKernels | None] = LandmarkKernels(_point, _start)

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """Only a scale > 0 has a finite position in front of the camera."""
        possible: BoolArray = scale > 0.0
        return possible

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """X = r + h_w / scale (Eq. 21)."""
        X: FloatArray = position + h_w / scale[:, None]
        return X

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """`parameters_of` with its Jacobians."""
        every = np.broadcast_to(np.eye(3), (len(scale), 3, 3))
        by_scale = -h_w / scale[:, None] ** 2
        X, free = self.parameters_of(position, h_w, scale), np.zeros(len(scale), dtype=bool)
        return StartedLandmarks(X, every, every / scale[:, None, None], by_scale, free)

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Direction = X - r, scale = 1 (Eq. 9)."""
        homogeneous = np.ones((len(parameters), 4))
        homogeneous[:, :3] = parameters - position
        return homogeneous

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""
        by_parameters = np.broadcast_to(np.eye(4, 3), (len(parameters), 4, 3))
        return ScaledPoints(self.homogeneous(position, anchors, parameters), -by_parameters, by_parameters)

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """R X."""
        return parameters @ R.T

    def shifted(self, parameters: FloatArray, shift: FloatArray) -> FloatArray:
        """X + shift."""
        return parameters + shift

    def world_translation(self, parameters: FloatArray) -> FloatArray:
        """The identity."""
        return np.broadcast_to(np.eye(3), (len(parameters), 3, 3))

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Jacobian -[X]x of the positions by a rotation of W."""
        return -rotations.skew(parameters)

    def turned(
        self,
        anchors: FloatArray | None,
        parameters: FloatArray,
        turn: FloatArray,
        spread: FloatArray,
        correction: FloatArray,
    ) -> FloatArray:
        """turn X + spread correction: the exponential of the group."""
        return parameters @ turn.T + correction @ spread.T

    def turned_jacobians(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """J_l(theta), and -[Exp(theta) X]x J_l(theta) + d (J_l(theta) correction) / d theta."""
        spread = rotations.right_jacobian(-theta)
        by_theta = -rotations.skew(parameters @ rotations.exp(theta).T) @ spread
        by_theta += rotations.left_jacobian_derivative(theta, correction)
        return np.broadcast_to(spread, by_theta.shape), by_theta
