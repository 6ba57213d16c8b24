"""Bearing with log-distance: a landmark is moved by the group SOT(3) of rotations and scalings about its anchor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from filters.landmarks.model import ScaledPoints, StartedLandmarks
from filters.landmarks.spherical import Spherical

_SPHERICAL = Spherical()


@dataclass(frozen=True)
class Polar(Spherical):
    """A landmark is a unit vector in W from its anchor, and the logarithm of its distance in metres.

    References
    ----------
    van Goor and Mahony, "EqVIO: An equivariant filter for visual-inertial odometry", IEEE TRO 39(5), 2023 (SOT(3)).
    """

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """Only a scale > 0 has a distance."""
        possible: BoolArray = scale > 0.0
        return possible

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """The unit vector of the direction, and log(length / scale)."""
        distance = np.linalg.norm(h_w, axis=1) / scale
        return np.column_stack([_SPHERICAL.parameters_of(position, h_w, scale)[:, :3], np.log(distance)])

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """With the error of rho = exp(-log-distance) times -1 / rho: regular at the smallest scale."""
        new, parameters = _SPHERICAL.started(position, h_w, scale), self.parameters_of(position, h_w, scale)
        slope = -1.0 / new.parameters[:, 3]
        new.by_direction[:, 2] *= slope[:, None]
        new.by_scale[:, 2] *= slope
        return replace(new, parameters=parameters)

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """As `Spherical` at rho = exp(-log-distance)."""
        return _SPHERICAL.homogeneous(position, anchors, self._with_rho(parameters))

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """As `Spherical`, with d rho / d log-distance = -rho."""
        spherical = self._with_rho(parameters)
        seen = _SPHERICAL.relative_to(position, anchors, spherical)
        seen.by_map[:, :, 5] *= -spherical[:, 3:]
        return seen

    @staticmethod
    def _with_rho(parameters: FloatArray) -> FloatArray:
        return np.hstack([parameters[:, :3], np.exp(-parameters[:, 3:])])
