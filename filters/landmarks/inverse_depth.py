"""Six-dimensional inverse depth: y = (x, y, z, theta, phi, rho) of Eq. 3, each landmark with an anchor of its own.

rho is inverse *distance* along the ray (Eq. 22). It may be zero or negative: a measurement with d <= 0 is kept as
the forward ray with rho <= 0, which has the same projection as the literal Eq. 21-24 (a point behind the camera).

Derivation: docs/derivations/inverse_depth.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from filters import rotations
from filters.camera import StereoCamera
from filters.landmarks.parametrisation import InverseDistances, NewLandmarks, Points, ScaledPoints
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
class InverseDepth:
    """Inverse depth with one anchor a landmark: six numbers each."""

    anchored: bool = True
    shares_anchors: bool = False

    def can_initialise(self, camera: StereoCamera, R_wc: FloatArray, uvd: FloatArray) -> BoolArray:
        """All but rays along the vertical of W, where the azimuth (Eq. 24) is undefined."""
        h_w = rotations.turned(R_wc, camera.ray(uvd))
        squares = h_w * h_w
        possible: BoolArray = squares[:, 0] + squares[:, 2] > _VERTICAL**2 * squares[:, 1]
        return possible

    def initialise(self, camera: StereoCamera, position: FloatArray, R_wc: FloatArray, uvd: FloatArray) -> NewLandmarks:
        """theta, phi and rho of new landmarks (Eq. 21-24); the anchor is the camera position (Eq. 20)."""
        h_c = camera.ray(uvd)
        h_w = rotations.turned(R_wc, h_c)
        length = np.sqrt((h_c * h_c).sum(axis=1))
        rho_per_d = 1.0 / (camera.disparity_constant * length)
        parameters = np.empty((len(uvd), 3))
        parameters[:, :2], parameters[:, 2] = angles_of(h_w), uvd[:, 2] * rho_per_d
        angles_by_h_c = angles_jacobian(h_w) @ R_wc

        by_rotation = np.zeros((len(uvd), 3, 3))
        by_rotation[:, :2] = -angles_by_h_c @ rotations.skew(h_c)
        h_c_by_pixel = np.array([1.0 / camera.fx, 1.0 / camera.fy])
        by_measurement = np.zeros((len(uvd), 3, 3))
        by_measurement[:, :2, :2] = angles_by_h_c[:, :, :2] * h_c_by_pixel
        by_measurement[:, 2, :2] = -(parameters[:, 2] / length**2)[:, None] * h_c[:, :2] * h_c_by_pixel
        by_measurement[:, 2, 2] = rho_per_d
        return NewLandmarks(
            parameters,
            np.zeros((len(uvd), 3, 3)),
            by_rotation,
            by_measurement,
            np.ones(len(uvd), dtype=bool),
        )

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

    def points(self, anchors: FloatArray | None, parameters: FloatArray) -> Points:
        """Eq. 4; not finite where rho = 0."""
        assert anchors is not None
        rho = parameters[:, 2, None]
        m = ray_direction(parameters)
        by_map = np.zeros((len(parameters), 3, 6))
        by_map[:, :, :3] = np.eye(3)
        with np.errstate(divide="ignore", invalid="ignore"):
            positions = anchors + m / rho
            by_map[:, :, 3:5] = ray_direction_jacobian(parameters) / rho[:, :, None]
            by_map[:, :, 5] = -m / rho**2
        return Points(positions, by_map)

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """The ray turns, rho stays."""
        m = ray_direction(parameters)
        effect = np.zeros((len(parameters), 3, 3))
        effect[:, :2] = -angles_jacobian(m) @ rotations.skew(m)
        return effect

    def turned(
        self,
        anchors: FloatArray | None,
        parameters: FloatArray,
        turn: FloatArray,
        spread: FloatArray,
        correction: FloatArray,
    ) -> FloatArray:
        """Correct the parameters, then turn the ray."""
        corrected = parameters + correction
        return np.column_stack([angles_of(ray_direction(corrected) @ turn.T), corrected[:, 2]])

    def first_estimates(self, anchors: FloatArray | None, first: FloatArray, current: FloatArray) -> FloatArray:
        """The first angles, the current rho: turning the world leaves rho alone, and freezing it can diverge."""
        return np.column_stack([first[:, :2], current[:, 2]])

    def inverse_distances(
        self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray
    ) -> InverseDistances:
        """Rho itself: the distance is from the anchor."""
        by_parameters = np.zeros((len(parameters), 3))
        by_parameters[:, 2] = 1.0
        return InverseDistances(parameters[:, 2].copy(), np.zeros((len(parameters), 3)), by_parameters)
