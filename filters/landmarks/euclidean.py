"""Euclidean XYZ: a landmark is its position in W, which is far from Gaussian for distant points.

Derivation: docs/derivations/euclidean.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.geometry import rotations
from filters.landmarks.model import LandmarkModel, ScaledPoints, StartedLandmarks
from filters.validation import BoolArray, FloatArray


@dataclass(frozen=True)
class Euclidean(LandmarkModel):
    """A landmark is (X, Y, Z), m, in W."""

    submaps: ClassVar[bool] = True
    kernel: ClassVar[str | None] = "euclidean"

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

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """-[X]x."""
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
