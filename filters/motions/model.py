"""Base class of motion models, and the state that they move (Eq. 2, 6, 11, 12), with or without odometry.

Errors of a camera state are 12 numbers, those of the variables "pose" and "velocity": position (W, m), rotation (camera
frame, rad, on the right), linear velocity (W, m/s), angular velocity (camera frame, rad/s). A motion model may move
variables of its own, too: their errors follow in the order in which it names them.

Derivation: docs/derivations/motion.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from filters.contract.odometry import BodyVelocity
from filters.contract.start import Start
from filters.contract.variables import POSE, VELOCITY, Variable
from filters.geometry import differences, rotations
from filters.geometry.retractions import RotationVector
from filters.validation import FloatArray

POSITION, ROTATION, LINEAR, ANGULAR = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Errors of pose and velocity."""
POSE_SIZE, CAMERA_SIZE = 6, 12
_ROTATION_VECTOR = RotationVector()


@dataclass(frozen=True, eq=False)
class CameraState:
    """x_C of Eq. 2 and the other named variables; of one camera, or of many at once with the same leading dimensions.

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
    variables : mapping of str to (v,)
        Values of the variables that parts have asked for.
    """

    position: FloatArray
    orientation: FloatArray
    linear_velocity: FloatArray
    angular_velocity: FloatArray
    variables: Mapping[str, FloatArray] = field(default_factory=dict)

    @classmethod
    def at(cls, start: Start, variables: Mapping[str, FloatArray] | None = None) -> CameraState:
        """The state that a filter is told at the start."""
        return cls(
            start.position, start.orientation, start.linear_velocity, start.angular_velocity, dict(variables or {})
        )

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
    F : (..., m, m)
        d error / d previous error, of the variables that the model moves: 12 numbers of pose and velocity, then its
        own.
    G : (..., m, k)
        d error / d noise.
    Q : (k, k)
        Covariance of the noise.
    """

    state: CameraState
    F: FloatArray
    G: FloatArray
    Q: FloatArray


@dataclass(frozen=True, eq=False)
class LinearMeasurement:
    """A linearised measurement of what the model moves: innovation (..., r), H (..., r, m), R (..., r, r)."""

    innovation: FloatArray
    H: FloatArray
    R: FloatArray


class MotionModel:
    """Motion of the camera between two frames.

    A part gives `move` and `noise`, and has numerical Jacobians; or it gives `predict` with its own.

    Attributes
    ----------
    variables : tuple of Variable
        Variables of the state that it moves or needs besides pose and velocity, such as biases. Their random walks are
        added by the filter.
    kernel : str or None
        Compiled counterpart. It holds for the class that states it, not for its subclasses.

    References
    ----------
    Davison, Reid, Molton and Stasse, "MonoSLAM", IEEE PAMI 29(6), 2007, section 3.4 (constant velocity).
    Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018 (Jacobians).
    """

    variables: tuple[Variable, ...] = ()
    kernel: ClassVar[str | None] = None

    def check_odometry(self, odometry: BodyVelocity | None) -> None:
        """Raise a `ValueError` if the model cannot make a step with this odometry."""

    def move(self, state: CameraState, dt: float, odometry: BodyVelocity | None, noise: FloatArray) -> CameraState:
        """State after `dt` > 0 seconds with this noise (k,)."""
        raise NotImplementedError(f"{type(self).__name__} must have move and noise, or predict: see MotionModel")

    def noise(self, dt: float, odometry: BodyVelocity | None) -> FloatArray:
        """Covariance (k, k) of the noise of a step."""
        raise NotImplementedError(f"{type(self).__name__} must have move and noise, or predict: see MotionModel")

    def predict(self, state: CameraState, dt: float, odometry: BodyVelocity | None) -> MotionPrediction:
        """Predicted state, its Jacobians and its noise after `dt` > 0 seconds (Eq. 6, 12)."""
        Q = self.noise(dt, odometry)
        still = np.zeros(len(Q))
        there = self.move(state, dt, odometry, still)
        size = CAMERA_SIZE + sum(variable.size for variable in self.variables)

        def by_state(delta: FloatArray) -> FloatArray:
            return self.difference(there, self.move(self.corrected(state, delta), dt, odometry, still))

        F = differences.jacobian(by_state, size)
        G = differences.jacobian(lambda n: self.difference(there, self.move(state, dt, odometry, n)), len(Q))
        return MotionPrediction(there, F, G, Q)

    def odometry_measurement(self, state: CameraState, dt: float, odometry: BodyVelocity) -> LinearMeasurement | None:
        """Odometry of the step as a measurement of the predicted state; None: the prediction has used it up."""
        return None

    @property
    def moves(self) -> tuple[str, ...]:
        """Names of what F moves, in its order."""
        return (POSE, VELOCITY, *(variable.name for variable in self.variables))

    def corrected(self, state: CameraState, delta: FloatArray) -> CameraState:
        """The state with errors (m,) of what the model moves added."""
        moved, row = dict(state.variables), CAMERA_SIZE
        for variable in self.variables:
            part = delta[row : row + variable.size]
            moved[variable.name] = variable.retraction.retract(moved[variable.name], part)
            row += variable.size
        return CameraState(
            state.position + delta[POSITION],
            _ROTATION_VECTOR.retract(state.orientation, delta[ROTATION]),
            state.linear_velocity + delta[LINEAR],
            state.angular_velocity + delta[ANGULAR],
            moved,
        )

    def difference(self, state: CameraState, other: CameraState) -> FloatArray:
        """Errors (m,) that take `state` to `other`."""
        own = [x.retraction.local(state.variables[x.name], other.variables[x.name]) for x in self.variables]
        return np.concatenate(
            [
                other.position - state.position,
                _ROTATION_VECTOR.local(state.orientation, other.orientation),
                other.linear_velocity - state.linear_velocity,
                other.angular_velocity - state.angular_velocity,
                *own,
            ]
        )


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
    noises, size = _rows(predicted.Q), _size(motion)
    _require_shapes(
        motion,
        ("state.position", predicted.state.position, (3,)),
        ("state.orientation", predicted.state.orientation, (4,)),
        ("state.linear_velocity", predicted.state.linear_velocity, (3,)),
        ("state.angular_velocity", predicted.state.angular_velocity, (3,)),
        ("F", predicted.F, (size, size)),
        ("Q", predicted.Q, (noises, noises)),
        ("G", predicted.G, (size, noises)),
        *(
            (f"state.variables[{variable.name!r}]", predicted.state.variables.get(variable.name), variable.value.shape)
            for variable in motion.variables
        ),
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
            ("the H of odometry", measured.H, (rows, _size(motion))),
            ("the R of odometry", measured.R, (rows, rows)),
        )
    return measured


def _size(motion: MotionModel) -> int:
    return CAMERA_SIZE + sum(variable.size for variable in motion.variables)


def _rows(array: FloatArray) -> int:
    shape = getattr(array, "shape", ())
    return shape[0] if shape else 0


def _require_type(motion: MotionModel, wanted: str, returned: object, kind: type) -> None:
    if not isinstance(returned, kind):
        raise ValueError(f"motion model {type(motion).__name__} must return {wanted}, got {type(returned).__name__}")


def _require_shapes(motion: MotionModel, *parts: tuple[str, FloatArray | None, tuple[int, ...]]) -> None:
    for name, array, wanted in parts:
        shape = getattr(array, "shape", None)
        if shape != wanted:
            got = type(array).__name__ if shape is None else shape
            raise ValueError(f"motion model {type(motion).__name__} must return {name} of shape {wanted}, got {got}")
