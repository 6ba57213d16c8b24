"""Euclidean XYZ: a landmark is its position in W, which is far from Gaussian for distant points.

Derivation: docs/derivations/euclidean.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import rotations
from filters.camera import StereoCamera
from filters.landmarks.parametrisation import InverseDistances, NewLandmarks, Points, ScaledPoints
from filters.validation import BoolArray, FloatArray


@dataclass(frozen=True)
class Euclidean:
    """A landmark is (X, Y, Z), m, in W."""

    anchored: bool = False
    shares_anchors: bool = False

    def can_initialise(self, camera: StereoCamera, R_wc: FloatArray, uvd: FloatArray) -> BoolArray:
        """Only d > 0 has a finite position in front of the camera."""
        possible: BoolArray = uvd[:, 2] > 0
        return possible

    def initialise(self, camera: StereoCamera, position: FloatArray, R_wc: FloatArray, uvd: FloatArray) -> NewLandmarks:
        """X = r + R_wc h^C, with h^C of Eq. 21."""
        h_c = camera.backproject(uvd)
        h_c_by_uvd = np.linalg.inv(camera.project_jacobian(h_c))
        return NewLandmarks(
            position + rotations.turned(R_wc, h_c),
            np.broadcast_to(np.eye(3), h_c_by_uvd.shape),
            -R_wc @ rotations.skew(h_c),
            R_wc @ h_c_by_uvd,
            np.zeros(len(uvd), dtype=bool),
        )

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Direction = X - r, scale = 1 (Eq. 9)."""
        homogeneous = np.ones((len(parameters), 4))
        homogeneous[:, :3] = parameters - position
        return homogeneous

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""
        by_parameters = np.broadcast_to(np.eye(4, 3), (len(parameters), 4, 3))
        return ScaledPoints(self.homogeneous(position, anchors, parameters), -by_parameters, by_parameters)

    def points(self, anchors: FloatArray | None, parameters: FloatArray) -> Points:
        """The parameters themselves."""
        return Points(parameters.copy(), np.broadcast_to(np.eye(3), (len(parameters), 3, 3)))

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
        """turn X + spread correction."""
        return parameters @ turn.T + correction @ spread.T

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """The first ones."""
        return first

    def inverse_distances(
        self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray
    ) -> InverseDistances:
        """1 / |X - r|: the distance is from the camera."""
        offset = parameters - position
        inverse = 1.0 / np.linalg.norm(offset, axis=1)
        by_parameters = -offset * inverse[:, None] ** 3
        return InverseDistances(inverse, -by_parameters, by_parameters)
