"""Six-dimensional inverse depth: y = (x, y, z, theta, phi, rho) of Eq. 3, each landmark with an anchor of its own.

rho is inverse *distance* along the ray (Eq. 22). It may be zero or negative: a measurement with d <= 0 is kept as
the forward ray with rho <= 0, which has the same projection as the literal Eq. 21-24 (a point behind the camera).

Derivation: docs/derivations/inverse_depth.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.geometry import rotations
from filters.landmarks.model import LandmarkModel, ScaledPoints, StartedLandmarks
from filters.validation import BoolArray, FloatArray

# Tangent of the angle to the vertical below which azimuth is undefined in double precision.
_VERTICAL = 1e-6


def ray_direction(angles: FloatArray) -> FloatArray:
    """m(theta, phi) of Eq. 5; (M, 2) rad -> (M, 3), unit, in W."""
    theta, phi = angles[:, 0], angles[:, 1]
    across = np.cos(phi)
    m = np.empty((len(angles), 3))
    m[:, 0], m[:, 1], m[:, 2] = across * np.sin(theta), -np.sin(phi), across * np.cos(theta)
    return m


def ray_direction_jacobian(angles: FloatArray) -> FloatArray:
    """d m / d (theta, phi); (M, 2) -> (M, 3, 2)."""
    theta, phi = angles[:, 0], angles[:, 1]
    sin_theta, cos_theta, sin_phi, cos_phi = np.sin(theta), np.cos(theta), np.sin(phi), np.cos(phi)
    jacobian = np.zeros((len(angles), 3, 2))
    jacobian[:, 0, 0] = cos_phi * cos_theta
    jacobian[:, 2, 0] = -cos_phi * sin_theta
    jacobian[:, 0, 1] = -sin_phi * sin_theta
    jacobian[:, 1, 1] = -cos_phi
    jacobian[:, 2, 1] = -sin_phi * cos_theta
    return jacobian


def angles_of(h_w: FloatArray) -> FloatArray:
    """(theta, phi) of directions (Eq. 24); (M, 3) -> (M, 2) rad."""
    x, y, z = h_w.T
    angles = np.empty((len(h_w), 2))
    angles[:, 0], angles[:, 1] = np.arctan2(x, z), np.arctan2(-y, np.hypot(x, z))
    return angles


def angles_jacobian(h_w: FloatArray) -> FloatArray:
    """d (theta, phi) / d direction; (M, 3) of any length, not vertical -> (M, 2, 3)."""
    x, y, z = h_w.T
    across_squared = x**2 + z**2
    across = np.sqrt(across_squared)
    length_squared = across_squared + y**2
    jacobian = np.zeros((len(h_w), 2, 3))
    jacobian[:, 0, 0] = z / across_squared
    jacobian[:, 0, 2] = -x / across_squared
    jacobian[:, 1, 0] = x * y / (length_squared * across)
    jacobian[:, 1, 1] = -across / length_squared
    jacobian[:, 1, 2] = z * y / (length_squared * across)
    return jacobian


@dataclass(frozen=True)
class InverseDepth(LandmarkModel):
    """Inverse depth with one anchor a landmark: six numbers each."""

    anchored: ClassVar[bool] = True
    submaps: ClassVar[bool] = True
    kernel: ClassVar[str | None] = "inverse-depth"

    def can_start(self, h_w: FloatArray, scale: FloatArray) -> BoolArray:
        """All but rays along the vertical of W, where the azimuth (Eq. 24) is undefined."""
        squares = h_w * h_w
        possible: BoolArray = squares[:, 0] + squares[:, 2] > _VERTICAL**2 * squares[:, 1]
        return possible

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """theta, phi and rho of new landmarks (Eq. 21-24); the anchor is the camera position (Eq. 20)."""
        return np.column_stack([angles_of(h_w), scale / np.sqrt((h_w * h_w).sum(axis=1))])

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """`parameters_of` with its Jacobians."""
        parameters = self.parameters_of(position, h_w, scale)
        square = (h_w * h_w).sum(axis=1)
        by_direction, by_scale = np.empty((len(h_w), 3, 3)), np.zeros((len(h_w), 3))
        by_direction[:, :2] = angles_jacobian(h_w)
        by_direction[:, 2] = -(parameters[:, 2] / square)[:, None] * h_w
        by_scale[:, 2] = 1.0 / np.sqrt(square)
        anchored = np.ones(len(h_w), dtype=bool)
        return StartedLandmarks(parameters, np.zeros((len(h_w), 3, 3)), by_direction, by_scale, anchored)

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Direction = rho (anchor - r) + m, scale = rho: Eq. 8 multiplied by rho, so regular at rho = 0."""
        assert anchors is not None
        homogeneous = np.empty((len(parameters), 4))
        homogeneous[:, :3] = parameters[:, 2:] * (anchors - position) + ray_direction(parameters)
        homogeneous[:, 3] = parameters[:, 2]
        return homogeneous

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""
        assert anchors is not None
        by_map = np.zeros((len(parameters), 4, 6))
        by_map[:, [0, 1, 2], [0, 1, 2]] = parameters[:, 2:]
        by_map[:, :3, 3:5] = ray_direction_jacobian(parameters)
        by_map[:, :3, 5] = anchors - position
        by_map[:, 3, 5] = 1.0
        return ScaledPoints(self.homogeneous(position, anchors, parameters), -by_map[:, :, :3], by_map)

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """The ray turns, rho stays."""
        return np.column_stack([angles_of(ray_direction(parameters) @ R.T), parameters[:, 2]])

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """The ray turns, rho stays."""
        m = ray_direction(parameters)
        effect = np.zeros((len(parameters), 3, 3))
        effect[:, :2] = -angles_jacobian(m) @ rotations.skew(m)
        return effect

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """The first angles, the current rho: turning the world leaves rho alone, and freezing it can diverge."""
        return np.column_stack([first[:, :2], current[:, 2]])

    def turned_jacobians(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """By the chain rule through the ray."""
        corrected, turn = parameters + correction, rotations.exp(theta)
        m = ray_direction(corrected) @ turn.T
        by_m = angles_jacobian(m)
        by_correction, by_theta = np.zeros((len(m), 3, 3)), np.zeros((len(m), 3, 3))
        by_correction[:, :2, :2] = by_m @ turn @ ray_direction_jacobian(corrected)
        by_correction[:, 2, 2] = 1.0
        by_theta[:, :2] = -by_m @ rotations.skew(m) @ rotations.right_jacobian(-theta)
        return by_correction, by_theta
