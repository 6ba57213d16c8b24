"""Camera state (Eq. 2) and motion models (Eq. 6, 11, 12), with or without odometry.

Errors of a camera state are 12 numbers: position (W, m), rotation (camera frame, rad, on the right),
linear velocity (W, m/s), angular velocity (camera frame, rad/s). Every Jacobian here is with respect to them.

Derivation: docs/derivations/motion.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from filters import rotations
from filters.interface import BodyVelocity
from filters.start import Start
from filters.validation import FloatArray, positive

POSITION, ROTATION, LINEAR, ANGULAR = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
CAMERA_SIZE = 12
POSE_SIZE = 6
_EYE = np.eye(CAMERA_SIZE)


@dataclass(frozen=True, eq=False)
class CameraState:
    """x_C of Eq. 2; of one camera, or of many at once with the same leading dimensions everywhere.

    Attributes
    ----------
    position : (..., 3)
        r^WC, m.
    orientation : (..., 4)
        q^WC, xyzw.
    linear_velocity : (..., 3)
        v^W, m/s.
    angular_velocity : (..., 3)
        omega^C, rad/s.
    """

    position: FloatArray
    orientation: FloatArray
    linear_velocity: FloatArray
    angular_velocity: FloatArray

    @classmethod
    def at(cls, start: Start) -> CameraState:
        """The state that a filter is told at the start."""
        return cls(start.position, start.orientation, start.linear_velocity, start.angular_velocity)

    @cached_property
    def R_wc(self) -> FloatArray:
        """Rotation matrix of the orientation."""
        return rotations.matrix(self.orientation)


@dataclass(frozen=True, eq=False)
class MotionPrediction:
    """The predicted state, its Jacobians and its noise.

    Attributes
    ----------
    state : CameraState
        After the step.
    F : (..., 12, 12)
        d state / d previous state.
    G : (..., 12, k)
        d state / d noise.
    Q : (k, k)
        Covariance of the noise.
    """

    state: CameraState
    F: FloatArray
    G: FloatArray
    Q: FloatArray


@dataclass(frozen=True, eq=False)
class LinearMeasurement:
    """A linearised measurement of the camera state: innovation (..., m), H (..., m, 12), R (..., m, m)."""

    innovation: FloatArray
    H: FloatArray
    R: FloatArray


@runtime_checkable
class MotionModel(Protocol):
    """Motion of the camera between two frames.

    References
    ----------
    Davison, Reid, Molton and Stasse, "MonoSLAM", IEEE PAMI 29(6), 2007, section 3.4 (constant velocity).
    Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018 (Jacobians).
    """

    def predict(self, state: CameraState, dt: float, odometry: BodyVelocity | None) -> MotionPrediction:
        """Predicted state, its Jacobians and its noise after `dt` > 0 seconds (Eq. 6, 12)."""

    def odometry_measurement(self, state: CameraState, dt: float, odometry: BodyVelocity) -> LinearMeasurement | None:
        """Odometry of the step as a measurement of the predicted state; None where the prediction has used it up."""


@dataclass(frozen=True)
class ConstantVelocity:
    """Constant velocity with white accelerations (Eq. 6): impulses V = a dt and Omega = alpha dt each step.

    Odometry, where given, is a measurement of the velocity of the step and is fused after the prediction.

    Parameters
    ----------
    sigma_acceleration : float
        Standard deviation of each component of a, m/s^2.
    sigma_angular_acceleration : float
        Standard deviation of each component of alpha, rad/s^2.
    """

    sigma_acceleration: float = 3.0
    sigma_angular_acceleration: float = 0.6

    def __post_init__(self) -> None:
        positive("sigma_acceleration", self.sigma_acceleration, allow_zero=True)
        positive("sigma_angular_acceleration", self.sigma_angular_acceleration, allow_zero=True)

    def predict(self, state: CameraState, dt: float, odometry: BodyVelocity | None) -> MotionPrediction:
        """Eq. 6 at zero noise, with F and G of Eq. 12; noise n = (V, Omega)."""
        turn = state.angular_velocity * dt
        by_quaternion = rotations.exp_quaternion(turn)
        moved = CameraState(
            state.position + state.linear_velocity * dt,
            rotations.multiply(state.orientation, by_quaternion),
            state.linear_velocity,
            state.angular_velocity,
        )
        F = np.empty((*turn.shape[:-1], CAMERA_SIZE, CAMERA_SIZE))
        F[...] = _EYE
        F[..., POSITION, LINEAR] = dt * _EYE[:3, :3]
        F[..., ROTATION, ROTATION] = rotations.matrix(by_quaternion).swapaxes(-1, -2)
        F[..., ROTATION, ANGULAR] = rotations.right_jacobian(turn) * dt
        G = F[..., LINEAR.start :]  # the impulses act on the velocities before the step
        Q = np.zeros((6, 6))
        Q.flat[:15:7], Q.flat[21::7] = (self.sigma_acceleration * dt) ** 2, (self.sigma_angular_acceleration * dt) ** 2
        return MotionPrediction(moved, F, G, Q)

    def odometry_measurement(self, state: CameraState, dt: float, odometry: BodyVelocity) -> LinearMeasurement | None:
        """Measure the velocity of the step: linear in the camera frame half-way through the turn, and angular."""
        half_turn = 0.5 * dt * state.angular_velocity
        back_half = rotations.exp(half_turn)
        R_cw = state.R_wc.swapaxes(-1, -2)
        v_c = rotations.turned(R_cw, state.linear_velocity)
        by_half_turn = back_half @ rotations.skew(v_c)
        H = np.zeros((*v_c.shape[:-1], 6, CAMERA_SIZE))
        H[..., :3, ROTATION] = by_half_turn
        H[..., :3, LINEAR] = back_half @ R_cw
        H[..., :3, ANGULAR] = -0.5 * dt * by_half_turn @ rotations.right_jacobian(half_turn)
        H[..., 3:, ANGULAR] = _EYE[:3, :3]
        linear, angular = odometry.linear - rotations.turned(back_half, v_c), odometry.angular - state.angular_velocity
        return LinearMeasurement(np.concatenate([linear, angular], axis=-1), H, odometry.covariance)


@dataclass(frozen=True)
class VelocityDriven:
    """Dead reckoning: the odometry is the motion, its covariance the only noise. Needs odometry in every step."""

    def predict(self, state: CameraState, dt: float, odometry: BodyVelocity | None) -> MotionPrediction:
        """R' = r + R Exp(w dt / 2) v dt, q' = q x q(w dt); noise n = errors of (v, w)."""
        if odometry is None:
            raise ValueError(
                "odometry must be given in every predict with motion=VelocityDriven(): "
                "pass a BodyVelocity, or use motion=ConstantVelocity(...)"
            )
        turn = odometry.angular * dt
        half = rotations.exp(0.5 * turn)
        R_mid = state.R_wc @ half
        moved = CameraState(
            state.position + R_mid @ odometry.linear * dt,
            rotations.multiply(state.orientation, rotations.exp_quaternion(turn)),
            R_mid @ odometry.linear,
            odometry.angular,
        )
        by_rotation = -state.R_wc @ rotations.skew(half @ odometry.linear)
        by_turn = -0.5 * dt * R_mid @ rotations.skew(odometry.linear) @ rotations.right_jacobian(0.5 * turn)
        F = np.zeros((CAMERA_SIZE, CAMERA_SIZE))
        F[POSITION, POSITION] = np.eye(3)
        F[POSITION, ROTATION] = by_rotation * dt
        F[ROTATION, ROTATION] = rotations.exp(-turn)
        F[LINEAR, ROTATION] = by_rotation
        G = np.zeros((CAMERA_SIZE, 6))
        G[POSITION, :3], G[POSITION, 3:] = R_mid * dt, by_turn * dt
        G[ROTATION, 3:] = rotations.right_jacobian(turn) * dt
        G[LINEAR, :3], G[LINEAR, 3:] = R_mid, by_turn
        G[ANGULAR, 3:] = np.eye(3)
        return MotionPrediction(moved, F, G, odometry.covariance)

    def odometry_measurement(self, state: CameraState, dt: float, odometry: BodyVelocity) -> LinearMeasurement | None:
        """Nothing: the prediction has used the odometry."""
        return None


def predict_camera(
    motion: MotionModel, state: CameraState, dt: float, odometry: BodyVelocity | None
) -> MotionPrediction:
    """Prediction of a motion model for one camera, with its shapes checked.

    Raises
    ------
    ValueError
        The model returned something else than a `MotionPrediction` with the shapes of its documentation.
    """
    predicted = motion.predict(state, dt, odometry)
    _require_type(motion, "a MotionPrediction from predict", predicted, MotionPrediction)
    _require_type(motion, "its predicted state as a CameraState", predicted.state, CameraState)
    noises = _rows(predicted.Q)
    _require_shapes(
        motion,
        ("state.position", predicted.state.position, (3,)),
        ("state.orientation", predicted.state.orientation, (4,)),
        ("state.linear_velocity", predicted.state.linear_velocity, (3,)),
        ("state.angular_velocity", predicted.state.angular_velocity, (3,)),
        ("F", predicted.F, (CAMERA_SIZE, CAMERA_SIZE)),
        ("Q", predicted.Q, (noises, noises)),
        ("G", predicted.G, (CAMERA_SIZE, noises)),
    )
    return predicted


def measure_odometry(
    motion: MotionModel, state: CameraState, dt: float, odometry: BodyVelocity
) -> LinearMeasurement | None:
    """Odometry of one camera as a measurement, with its shapes checked; None: it adds nothing.

    Raises
    ------
    ValueError
        The model returned something else than None or a `LinearMeasurement` with the shapes of its documentation.
    """
    measured = motion.odometry_measurement(state, dt, odometry)
    if measured is not None:
        _require_type(motion, "a LinearMeasurement or None from odometry_measurement", measured, LinearMeasurement)
        rows = _rows(measured.innovation)
        _require_shapes(
            motion,
            ("the innovation of odometry", measured.innovation, (rows,)),
            ("the H of odometry", measured.H, (rows, CAMERA_SIZE)),
            ("the R of odometry", measured.R, (rows, rows)),
        )
    return measured


def _rows(array: FloatArray) -> int:
    shape = getattr(array, "shape", ())
    return shape[0] if shape else 0


def _require_type(motion: MotionModel, wanted: str, returned: object, kind: type) -> None:
    if not isinstance(returned, kind):
        raise ValueError(f"motion model {type(motion).__name__} must return {wanted}, got {type(returned).__name__}")


def _require_shapes(motion: MotionModel, *parts: tuple[str, FloatArray, tuple[int, ...]]) -> None:
    for name, array, wanted in parts:
        shape = getattr(array, "shape", None)
        if shape != wanted:
            got = type(array).__name__ if shape is None else shape
            raise ValueError(f"motion model {type(motion).__name__} must return {name} of shape {wanted}, got {got}")


def motion_model(value: MotionModel | None) -> MotionModel:
    """Return `value`, or `ConstantVelocity()` for None.

    Raises
    ------
    ValueError
        It is no motion model.
    """
    if value is not None and not isinstance(value, MotionModel):
        raise ValueError(f"motion must be a motion model such as ConstantVelocity(3.0, 0.6), got {value!r}")
    return ConstantVelocity() if value is None else value
