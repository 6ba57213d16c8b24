"""Six-dimensional inverse depth: y = (x, y, z, theta, phi, rho) of Eq. 3, with own or shared anchors.

rho is inverse *distance* along the ray (Eq. 22). It may be zero or negative: a measurement with d <= 0 is kept as
the forward ray with rho <= 0, which has the same projection as the literal Eq. 21-24 (a point behind the camera).

Landmarks that enter the map in one frame would all copy the same camera position, so their anchor rows of P are equal
and stay equal under every Kalman update: with one shared anchor the estimate is that of six-dimensional inverse depth,
in 3 n + 3 k instead of 6 n numbers.

Derivation: docs/derivations/inverse_depth.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.machine_code import compiled
from filters.geometry.rotations import left_jacobian_derivative_of, matrix_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import cross_matrix, multiply, times
from filters.landmarks.landmark_model import LandmarkKernels, LandmarkModel, ScaledPoints, StartedLandmarks

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


# --- the same in machine code ---


@compiled
def ray(theta: float, phi: float) -> rotations.Three:
    """`ray_direction` of one landmark."""
    across = math.cos(phi)
    return across * math.sin(theta), -math.sin(phi), across * math.cos(theta)


@compiled
def _angles_jacobian(x: float, y: float, z: float) -> tuple[float, ...]:
    across_squared = x * x + z * z
    across, length_squared = math.sqrt(across_squared), across_squared + y * y
    below = length_squared * across
    return z / across_squared, 0.0, -x / across_squared, x * y / below, -across / length_squared, z * y / below


@compiled
def _rotation_of(theta: float, phi: float) -> tuple[float, ...]:
    """-A [m]x, row by row (2, 3)."""
    x, y, z = ray(theta, phi)
    a = _angles_jacobian(x, y, z)
    return (  # -a^T [m]x = (m x a)^T
        *(y * a[2] - z * a[1], z * a[0] - x * a[2], x * a[1] - y * a[0]),
        *(y * a[5] - z * a[4], z * a[3] - x * a[5], x * a[4] - y * a[3]),
    )


def _point(settings: FloatArray, values: FloatArray, points: FloatArray, J: FloatArray) -> None:
    for i in range(len(values)):
        theta, phi = values[i, 0], values[i, 1]
        sin_theta, cos_theta, sin_phi, cos_phi = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
        points[i, 0], points[i, 1], points[i, 2] = cos_phi * sin_theta, -sin_phi, cos_phi * cos_theta
        points[i, 3] = values[i, 2]
        J[i, 0, 0], J[i, 2, 0] = cos_phi * cos_theta, -cos_phi * sin_theta
        J[i, 0, 1], J[i, 1, 1], J[i, 2, 1] = -sin_phi * sin_theta, -cos_phi, -sin_phi * cos_theta
        J[i, 3, 2] = 1.0


def _start(settings: FloatArray, points: FloatArray, values: FloatArray, J: FloatArray, possible: BoolArray) -> None:
    for i in range(len(values)):
        x, y, z, scale = points[i, 0], points[i, 1], points[i, 2], points[i, 3]
        across_squared = x * x + z * z
        square = across_squared + y * y
        inverse = 1.0 / math.sqrt(square)
        possible[i] = across_squared > _VERTICAL * _VERTICAL * (y * y)
        values[i, 0], values[i, 1] = math.atan2(x, z), math.atan2(-y, math.sqrt(across_squared))
        values[i, 2] = scale * inverse
        a = _angles_jacobian(x, y, z)
        for k in range(3):
            J[i, 0, k], J[i, 1, k], J[i, 2, k] = a[k], a[3 + k], -scale * inverse / square * points[i, k]
        J[i, 2, 3] = inverse


def _turn(
    settings: FloatArray,
    values: FloatArray,
    theta: FloatArray,
    correction: FloatArray,
    moved: FloatArray,
    J: FloatArray,
    J_theta: FloatArray,
) -> None:
    q0, q1, q2, q3 = quaternion_of(theta[0], theta[1], theta[2])
    world = matrix_of(q0, q1, q2, q3)
    spread = right_jacobian_of(-theta[0], -theta[1], -theta[2])
    for i in range(len(values)):
        sin_theta, cos_theta = math.sin(values[i, 0]), math.cos(values[i, 0])
        sin_phi, cos_phi = math.sin(values[i, 1]), math.cos(values[i, 1])
        by_azimuth = cos_phi * cos_theta, 0.0, -cos_phi * sin_theta
        by_elevation = -sin_phi * sin_theta, -cos_phi, -sin_phi * cos_theta
        b0 = by_azimuth[0] * correction[i, 0] + by_elevation[0] * correction[i, 1]
        b1 = by_elevation[1] * correction[i, 1]
        b2 = by_azimuth[2] * correction[i, 0] + by_elevation[2] * correction[i, 1]
        r0, r1, r2 = times(world, cos_phi * sin_theta, -sin_phi, cos_phi * cos_theta)
        s0, s1, s2 = times(spread, b0, b1, b2)
        x, y, z = r0 + s0, r1 + s1, r2 + s2
        moved[i, 0], moved[i, 1] = math.atan2(x, z), math.atan2(-y, math.sqrt(x * x + z * z))
        moved[i, 2] = values[i, 2] + correction[i, 2]
        a = _angles_jacobian(x, y, z)
        c0, c1 = times(spread, *by_azimuth), times(spread, *by_elevation)
        turned = multiply(cross_matrix(-r0, -r1, -r2), spread)
        derivative = left_jacobian_derivative_of(theta[0], theta[1], theta[2], b0, b1, b2)
        J[i, 2, 2] = 1.0
        for r in range(2):
            for k in range(3):
                J[i, r, 0] += a[3 * r + k] * c0[k]
                J[i, r, 1] += a[3 * r + k] * c1[k]
                for c in range(3):
                    J_theta[i, r, c] += a[3 * r + k] * (turned[3 * k + c] + derivative[3 * k + c])


def _rotation(settings: FloatArray, values: FloatArray, effect: FloatArray) -> None:
    for i in range(len(values)):
        by_turn = _rotation_of(values[i, 0], values[i, 1])
        for r in range(2):
            for k in range(3):
                effect[i, r, k] = by_turn[3 * r + k]


KERNELS = LandmarkKernels(_point, _start, _turn, _rotation)


@dataclass(frozen=True)
class InverseDepth(LandmarkModel):
    """Inverse depth with one anchor a landmark: six numbers each."""

    anchored: ClassVar[bool] = True
    submaps: ClassVar[bool] = True
    follows: ClassVar[tuple[int, ...]] = (2,)
    kernels: ClassVar[LandmarkKernels | None] = KERNELS

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

    def turned(
        self,
        anchors: FloatArray | None,
        parameters: FloatArray,
        turn: FloatArray,
        spread: FloatArray,
        correction: FloatArray,
    ) -> FloatArray:
        """The ray as a point of the group: turn m + spread b, with b what the correction moves it by; rho is added.

        A correction that only takes back what the turn does leaves the ray where it is, however far the turn is.
        """
        m = ray_direction(parameters) @ turn.T + self._shift(parameters, correction) @ spread.T
        return np.column_stack([angles_of(m), parameters[:, 2] + correction[:, 2]])

    @staticmethod
    def _shift(parameters: FloatArray, correction: FloatArray) -> FloatArray:
        shift: FloatArray = np.einsum("mij,mj->mi", ray_direction_jacobian(parameters), correction[:, :2])
        return shift

    def turned_jacobians(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """By the chain rule through the ray."""
        spread, shift = rotations.right_jacobian(-theta), self._shift(parameters, correction)
        m = ray_direction(parameters) @ rotations.exp(theta).T
        by_m = angles_jacobian(m + shift @ spread.T)
        by_correction, by_theta = np.zeros((len(m), 3, 3)), np.zeros((len(m), 3, 3))
        by_correction[:, :2, :2] = by_m @ spread @ ray_direction_jacobian(parameters)
        by_correction[:, 2, 2] = 1.0
        by_theta[:, :2] = by_m @ (rotations.left_jacobian_derivative(theta, shift) - rotations.skew(m) @ spread)
        return by_correction, by_theta


@dataclass(frozen=True)
class SharedAnchorInverseDepth(InverseDepth):
    """`InverseDepth` whose anchors are shared by the landmarks of one frame."""

    shares_anchors: ClassVar[bool] = True
    kernels: ClassVar[LandmarkKernels | None] = KERNELS
