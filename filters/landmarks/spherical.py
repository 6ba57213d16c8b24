"""Bearings on the sphere: with inverse distance (`Spherical`), or with log-distance (`Polar`).

Inverse distance is inverse depth without a singular direction, S^2 x R. With log-distance a landmark is moved by the
group SOT(3) of rotations and scalings about its anchor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.landmarks.landmark_model import LandmarkModel, ScaledPoints, StartedLandmarks

_TURNED_OVER = -0.9
"""Below this z of a bearing its tangent basis is the other one; both are smooth there."""


def tangent_basis(m: FloatArray) -> FloatArray:
    """Two unit vectors perpendicular to each bearing, smooth outside a circle far behind the start; -> (M, 3, 2).

    The rotation by the shortest way from (0, 0, 1), or from (0, 0, -1), to m, applied to x and y (Duff et al.,
    "Building an orthonormal basis, revisited", JCGT 6(1), 2017).
    """
    x, y, z = m.T
    side = np.where(z > _TURNED_OVER, 1.0, -1.0)
    a = -1.0 / (side + z)
    first = [1.0 + side * x * x * a, side * x * y * a, -side * x]
    second = [x * y * a, side + y * y * a, -y]
    return np.stack([np.stack(first, axis=1), np.stack(second, axis=1)], axis=2)


def bearing_jacobian(m: FloatArray) -> FloatArray:
    """d m / d (its two error numbers), the columns b x m of the tangent basis; transposed, d local / d m; (M, 3, 2)."""
    basis = tangent_basis(m)
    return np.stack([-basis[:, :, 1], basis[:, :, 0]], axis=2)


@dataclass(frozen=True)
class Spherical(LandmarkModel):
    """A landmark is a unit vector in W from its anchor, and rho: four numbers.

    Its error is a rotation perpendicular to the bearing, two numbers in `tangent_basis`, and that of rho.
    """

    anchored: ClassVar[bool] = True
    shares_anchors: ClassVar[bool] = True
    value_size: ClassVar[int] = 4
    follows: ClassVar[tuple[int, ...]] = (3,)

    def parameters_of(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> FloatArray:
        """The unit vector of the direction, and scale / length."""
        m_rho: FloatArray = np.column_stack([h_w, scale]) / np.linalg.norm(h_w, axis=1, keepdims=True)
        return m_rho

    def started(self, position: FloatArray, h_w: FloatArray, scale: FloatArray) -> StartedLandmarks:
        """`parameters_of` with its Jacobians."""
        parameters, inverse = self.parameters_of(position, h_w, scale), 1.0 / np.linalg.norm(h_w, axis=1)
        m, rho = parameters[:, :3], parameters[:, 3]
        by_direction, by_scale = np.empty((len(h_w), 3, 3)), np.zeros((len(h_w), 3))
        by_direction[:, :2] = inverse[:, None, None] * bearing_jacobian(m).transpose(0, 2, 1)
        by_direction[:, 2] = -(inverse * rho)[:, None] * m
        by_scale[:, 2] = inverse
        anchored = np.ones(len(h_w), dtype=bool)
        return StartedLandmarks(parameters, np.zeros((len(h_w), 3, 3)), by_direction, by_scale, anchored)

    def homogeneous(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """Direction = rho (anchor - r) + m, scale = rho."""
        assert anchors is not None
        m, rho = parameters[:, :3], parameters[:, 3:]
        return np.hstack([rho * (anchors - position) + m, rho])

    def relative_to(self, position: FloatArray, anchors: FloatArray | None, parameters: FloatArray) -> ScaledPoints:
        """`homogeneous` with its Jacobians."""
        assert anchors is not None
        by_map = np.zeros((len(parameters), 4, 6))
        by_map[:, [0, 1, 2], [0, 1, 2]] = parameters[:, 3:]
        by_map[:, :3, 3:5] = bearing_jacobian(parameters[:, :3])
        by_map[:, :3, 5] = anchors - position
        by_map[:, 3, 5] = 1.0
        return ScaledPoints(self.homogeneous(position, anchors, parameters), -by_map[:, :, :3], by_map)

    def rotated(self, anchors: FloatArray | None, parameters: FloatArray, R: FloatArray) -> FloatArray:
        """The bearing turns, rho stays."""
        return np.hstack([parameters[:, :3] @ R.T, parameters[:, 3:]])

    def world_rotation(self, anchors: FloatArray | None, parameters: FloatArray) -> FloatArray:
        """The part of the rotation vector perpendicular to the bearing."""
        effect = np.zeros((len(parameters), 3, 3))
        effect[:, :2] = tangent_basis(parameters[:, :3]).transpose(0, 2, 1)
        return effect

    def retract(self, parameters: FloatArray, delta: FloatArray) -> FloatArray:
        """Exp(B a) m = cos|a| m + sin|a| / |a| (B a) x m, and rho plus its correction."""
        m, angle = parameters[:, :3], np.linalg.norm(delta[..., :2], axis=-1, keepdims=True)
        axis = (tangent_basis(m) @ delta[..., :2, None])[..., 0]
        turned = np.cos(angle) * m + np.sinc(angle / np.pi) * np.cross(axis, m)
        return np.hstack([turned / np.linalg.norm(turned, axis=1, keepdims=True), parameters[:, 3:] + delta[..., 2:]])

    def local(self, parameters: FloatArray, other: FloatArray) -> FloatArray:
        """The rotation vector by the shortest way from bearing to bearing, in the basis of the first."""
        m = parameters[:, :3]
        across = np.cross(m, other[:, :3])
        sine, cosine = np.linalg.norm(across, axis=1), np.einsum("mi,mi->m", m, other[:, :3])
        longer = np.divide(np.arctan2(sine, cosine), sine, out=np.ones(len(m)), where=sine > 0.0)
        turn = longer[:, None] * np.einsum("mij,mi->mj", tangent_basis(m), across)
        return np.hstack([turn, other[:, 3:] - parameters[:, 3:]])

    def transport(self, parameters: FloatArray, delta: FloatArray) -> FloatArray | None:
        """By the left Jacobian of the turn, seen in the basis where it ends."""
        basis = tangent_basis(parameters[:, :3])
        axis = (basis @ delta[..., :2, None])[..., 0]
        back = tangent_basis(self.retract(parameters, delta)[:, :3]).transpose(0, 2, 1)
        J = np.zeros((len(parameters), 3, 3))
        J[:, :2, :2] = back @ rotations.right_jacobian(-axis) @ basis
        J[:, 2, 2] = 1.0
        return J

    def turned(
        self,
        anchors: FloatArray | None,
        parameters: FloatArray,
        turn: FloatArray,
        spread: FloatArray,
        correction: FloatArray,
    ) -> FloatArray:
        """The bearing as a point of the group, as `InverseDepth` has it."""
        m = parameters[:, :3] @ turn.T + self._shift(parameters, correction) @ spread.T
        return np.hstack([m / np.linalg.norm(m, axis=1, keepdims=True), parameters[:, 3:] + correction[:, 2:]])

    @staticmethod
    def _shift(parameters: FloatArray, correction: FloatArray) -> FloatArray:
        m = parameters[:, :3]
        shift: FloatArray = np.cross((tangent_basis(m) @ correction[:, :2, None])[:, :, 0], m)
        return shift

    def turned_jacobians(
        self, anchors: FloatArray | None, parameters: FloatArray, theta: FloatArray, correction: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """By the chain rule through the bearing, seen in the basis where it ends."""
        spread, shift = rotations.right_jacobian(-theta), self._shift(parameters, correction)
        start = parameters[:, :3]
        m = start @ rotations.exp(theta).T
        end = m + shift @ spread.T
        square = np.einsum("mi,mi->m", end, end)[:, None, None]
        by_end = tangent_basis(end / np.sqrt(square[:, :, 0])).transpose(0, 2, 1) @ rotations.skew(end) / square
        by_correction, by_theta = np.zeros((len(m), 3, 3)), np.zeros((len(m), 3, 3))
        by_correction[:, :2, :2] = by_end @ spread @ -rotations.skew(start) @ tangent_basis(start)
        by_correction[:, 2, 2] = 1.0
        by_theta[:, :2] = by_end @ (rotations.left_jacobian_derivative(theta, shift) - rotations.skew(m) @ spread)
        return by_correction, by_theta


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
