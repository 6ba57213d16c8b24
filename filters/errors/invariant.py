"""Invariant errors: camera and map are corrected together, as one element of a group.

The group is that of the rotation with all points (position, velocity, anchors, XYZ) behind it. The left- and the
right-invariant correction of one estimate are the same element, X exp(xi_L) = exp(Ad xi_L) X, and where the covariance
is carried along by the full Jacobian of the retraction both are the same filter (Ge et al. 2025). What differs is the
form in which they are computed, and the coordinates of the pose error.

Derivation: docs/derivations/errors.md.

References
----------
Barrau and Bonnabel, "An EKF-SLAM algorithm with consistency properties", arXiv 1510.06263, 2015. Zhang, Wu, Song, Huang
and Dissanayake, "Convergence and consistency analysis for a 3-D invariant-EKF SLAM", IEEE RA-L 2(2), 2017. Ge et al.,
arXiv 2507.04568, 2025.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from filters.errors.error_definition import ErrorDefinition, ErrorKernels
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import POSITION, ROTATION, CameraState
from filters.state.joint_state import JointState
from filters.state.layout import Transport


class _InvariantError(ErrorDefinition):
    """What both sides have in common: the retraction and its full Jacobian."""

    submaps: ClassVar[bool] = False

    def moved(self, state: JointState, delta: FloatArray) -> JointState:
        """The state corrected by delta, with all points turned about the origin of W; P is shared."""
        moved = super().moved(state, delta)
        camera, rows = state.camera, state.layout.linear_velocity
        theta, turn, spread = _turn(camera, delta)
        by_block = delta[state.layout.size :].reshape(-1, state.size)
        blocks = moved.blocks
        blocks[:, :3] = self._points(state.blocks[:, :3], by_block[:, :3], theta, turn, spread)
        own, anchors, values = state.parameter_block, state.anchors(), state.parameters()
        xi = by_block[own] - state.model.world_rotation(anchors, values) @ theta
        blocks[own] = state.model.turned(anchors, values, theta, xi)
        turned = replace(
            moved.camera,
            position=self._points(camera.position, delta[POSITION], theta, turn, spread),
            linear_velocity=self._points(camera.linear_velocity, delta[rows], theta, turn, spread),
        )
        return replace(moved, camera=turned, blocks=blocks)

    def _points(
        self, points: FloatArray, delta: FloatArray, theta: FloatArray, turn: FloatArray, spread: FloatArray
    ) -> FloatArray:
        """Points (..., 3) corrected by delta (..., 3)."""
        raise NotImplementedError

    def transport(self, state: JointState, moved: JointState, delta: FloatArray) -> Transport:
        """The full Jacobian of the retraction: points by themselves and by the rotation."""
        step = super().transport(state, moved, delta)
        camera, layout = state.camera, state.layout
        theta, _, spread = _turn(camera, delta)
        for rows in (POSITION, layout.linear_velocity):
            step.leading[rows, rows] = spread
            step.leading[rows, ROTATION] = rotations.left_jacobian_derivative(theta, delta[rows]) @ camera.R_wc
        by_block = delta[layout.size :].reshape(-1, state.size)
        own, by_rotation = np.zeros((len(by_block), state.size, state.size)), np.zeros((len(by_block), state.size, 3))
        own[:] = np.eye(state.size)
        own[:, :3, :3] = spread
        by_rotation[:, :3] = rotations.left_jacobian_derivative(theta, by_block[:, :3])
        index, anchors, values = state.parameter_block, state.anchors(), state.parameters()
        gamma = state.model.world_rotation(anchors, values)
        xi = by_block[index] - gamma @ theta
        own[index], by_turn = state.model.turned_jacobians(anchors, values, theta, xi)
        by_rotation[index] = by_turn - own[index] @ gamma
        for clone in state.clones.values():
            own[clone.blocks, :3, :3] = np.eye(3), self.orientation.transport(by_block[clone.blocks[1], :3])
            by_rotation[clone.blocks] = 0.0
        map_rows = layout.size + np.arange(state.size * len(own)).reshape(-1, state.size)
        return Transport(step.leading, (by_rotation @ camera.R_wc).reshape(-1, 3), map_rows, own)


@dataclass(frozen=True)
class RightInvariant(_InvariantError):
    """Right-invariant errors: the correction exp(xi) is applied from the left.

    Parameters
    ----------
    reset : bool
        Whether the covariance is carried along by the full Jacobian of the retraction (Ge et al. 2025). False: P stays
        what it was in invariant coordinates, as Barrau and Bonnabel, and Zhang et al. have it. Then a rotation of the
        world stays unobservable, which under large orientation uncertainty is worth more (docs/derivations/errors.md).
    """

    reset: bool = False
    kernels: ClassVar[ErrorKernels | None] = ErrorKernels(turns=True)

    @property
    def keeps_gauge(self) -> bool:  # type: ignore[override]
        """Whether P stays what it was in invariant coordinates, in which these directions never change."""
        return not self.reset

    def _points(
        self, points: FloatArray, delta: FloatArray, theta: FloatArray, turn: FloatArray, spread: FloatArray
    ) -> FloatArray:
        """Exp(theta) p + J_l(theta) xi with xi = delta + [p]x theta."""
        moved: FloatArray = points @ turn.T + (delta + np.cross(points, theta)) @ spread.T
        return moved

    def transport(self, state: JointState, moved: JointState, delta: FloatArray) -> Transport:
        """The full Jacobian, or (Gamma+ - Gamma) R_wc on the rotation columns."""
        if self.reset:
            return super().transport(state, moved, delta)
        W = (moved.world_rotation() - state.world_rotation()) @ state.camera.R_wc
        size = state.layout.size
        leading = ErrorDefinition.transport(self, state, moved, delta).leading
        leading[:, ROTATION] = np.eye(size)[:, ROTATION] + W[:size]
        return Transport(leading, W[size:])

    def pose_error(
        self, camera: CameraState, P_pose: FloatArray, position: FloatArray, orientation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """xi of the pose, position part first: what is left of the true pose after turning the estimate by theta."""
        R_wc = camera.R_wc
        theta = rotations.log(rotations.matrix(orientation) @ R_wc.T)
        spread = rotations.right_jacobian(-theta)
        shift = np.linalg.solve(spread, position - rotations.exp(theta) @ camera.position)
        # delta -> xi: theta = R delta_theta, e_p = delta_r + [r]x theta
        J = np.eye(6)
        J[POSITION, ROTATION] = rotations.skew(camera.position) @ R_wc
        J[ROTATION, ROTATION] = R_wc
        covariance = J @ P_pose @ J.T
        return np.concatenate([shift, theta]), 0.5 * (covariance + covariance.T)


@dataclass(frozen=True)
class LeftInvariant(_InvariantError):
    """Left-invariant errors: the correction exp(xi) is applied from the right."""

    kernels: ClassVar[ErrorKernels | None] = ErrorKernels(turns=True)

    def _points(
        self, points: FloatArray, delta: FloatArray, theta: FloatArray, turn: FloatArray, spread: FloatArray
    ) -> FloatArray:
        """p + R J_l(phi) R^T delta = p + J_l(theta) delta."""
        moved: FloatArray = points + delta @ spread.T
        return moved

    def pose_error(
        self, camera: CameraState, P_pose: FloatArray, position: FloatArray, orientation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """xi of the pose in the camera frame, position part first."""
        R_wc = camera.R_wc
        phi = rotations.log(R_wc.T @ rotations.matrix(orientation))
        shift = np.linalg.solve(rotations.right_jacobian(-phi), R_wc.T @ (position - camera.position))
        J = np.eye(6)
        J[POSITION, POSITION] = R_wc.T
        covariance = J @ P_pose @ J.T
        return np.concatenate([shift, phi]), 0.5 * (covariance + covariance.T)


def _turn(camera: CameraState, delta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """theta in W, Exp(theta) and its left Jacobian."""
    theta = camera.R_wc @ delta[ROTATION]
    return theta, rotations.exp(theta), rotations.right_jacobian(-theta)
