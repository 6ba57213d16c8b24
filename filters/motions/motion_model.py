"""Base class of motion models, and the state that they move (Eq. 2, 6, 11, 12), with or without odometry.

Errors of a camera state are 12 numbers, those of the variables "pose" and "velocity": position (W, m), rotation (camera
frame, rad, on the right), linear velocity (W, m/s), angular velocity (camera frame, rad/s). A motion model may move
variables of its own, too: their errors follow in the order in which it names them.

Derivation: docs/derivations/motion.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from filters.contract.inputs import BodyVelocity, InertialSamples, Start
from filters.contract.stereo_filter import StereoFilter
from filters.contract.variables import POSE, VELOCITY, Variable
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import settings_of
from filters.geometry.retractions import RotationVector

POSITION, ROTATION, LINEAR, ANGULAR = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Errors of pose and velocity."""
POSE_SIZE, VELOCITY_SIZE = 6, 6
CAMERA_SIZE = POSE_SIZE + VELOCITY_SIZE
_ROTATION_VECTOR = RotationVector()
StepInput = BodyVelocity | InertialSamples
"""What may be known of a step besides its length."""


@dataclass(frozen=True, eq=False)
class CameraState:
    """x_C of Eq. 2 and the other named variables; of one camera, or of many with the same leading dimensions."""

    position: FloatArray
    """(..., 3): r^WC, m."""
    orientation: FloatArray
    """(..., 4): q^WC, xyzw."""
    linear_velocity: FloatArray
    """(..., 3): v^W, m/s."""
    angular_velocity: FloatArray
    """(..., 3): omega^C, rad/s."""
    variables: Mapping[str, FloatArray] = field(default_factory=dict)
    """Values of the variables that parts have asked for."""

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
    """The predicted state, its Jacobians and its noise."""

    state: CameraState
    """After the step."""
    F: FloatArray
    """(..., m, m): d error / d previous error, of the variables that the model moves: 12 numbers of pose and velocity,
    then its own."""
    G: FloatArray
    """(..., m, k): d error / d noise."""
    Q: FloatArray
    """(k, k): covariance of the noise."""


@dataclass(frozen=True, eq=False)
class LinearMeasurement:
    """A linearised measurement of what the model moves: innovation (..., r), H (..., r, m), R (..., r, r)."""

    innovation: FloatArray
    H: FloatArray
    R: FloatArray


@dataclass(frozen=True)
class MotionKernels:
    """Compiled functions of a motion, in C-ordered arrays; outputs are zero before.

    A kernel is a function that Numba can compile; it writes what it is to give into its last arguments. The state is
    what the model moves, in one vector: position (3), orientation xyzw (4), linear (3) and angular velocity (3), then
    the values of its variables. Errors are in the order of `MotionPrediction.F`.
    """

    step: Callable[..., None]
    """(settings, state (v,), dt, odometry (K, w), moved (v,), F (m, m), Q (m, m)): the state after dt seconds, its
    Jacobian, and the covariance that the step adds."""
    measure: Callable[..., None] | None = None
    """(settings, moved (v,), dt, odometry (K, w), innovation (r,), H (r, m), R (r, r)): odometry as a measurement of
    the state after the step, where there is odometry."""
    rows: int = 0
    """Numbers r of that measurement."""
    settings: tuple[str, ...] = ()
    """Attributes of the part whose numbers are the first argument."""


class MotionModel:
    """Motion of the camera between two frames.

    A part gives `move` and `noise`, and has numerical Jacobians; or it gives `predict` with its own; or `kernels`.

    References
    ----------
    Davison, Reid, Molton and Stasse, "MonoSLAM", IEEE PAMI 29(6), 2007, section 3.4 (constant velocity).
    Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018 (Jacobians).
    """

    variables: tuple[Variable, ...] = ()
    """Variables of the state that it moves or needs besides pose and velocity, such as biases. Their random walks are
    added by the filter."""
    kernels: ClassVar[MotionKernels | None] = None
    """The same, compiled. They hold for the class that states them, not for its subclasses."""

    takes: ClassVar[type[BodyVelocity] | type[InertialSamples]] = BodyVelocity
    """What it is given of a step as `odometry`: velocities, or `InertialSamples`, which filters have as `inertial`."""

    def check_odometry(self, odometry: Any) -> None:
        """Raise a `ValueError` if the model cannot make a step with this odometry."""

    def move(self, state: CameraState, dt: float, odometry: Any, noise: FloatArray) -> CameraState:
        """State after `dt` > 0 seconds with this noise (k,)."""
        raise NotImplementedError(f"{type(self).__name__} must have move and noise, or predict: see MotionModel")

    def noise(self, dt: float, odometry: Any) -> FloatArray:
        """Covariance (k, k) of the noise of a step."""
        raise NotImplementedError(f"{type(self).__name__} must have move and noise, or predict: see MotionModel")

    def predict(self, state: CameraState, dt: float, odometry: Any) -> MotionPrediction:
        """Predicted state, its Jacobians and its noise after `dt` > 0 seconds (Eq. 6, 12)."""
        size = _size(self)
        if self.kernels is not None:
            self.check_odometry(odometry)
            before, F, Q = self.numbers_of(state), np.zeros((size, size)), np.zeros((size, size))
            moved, given = before.copy(), self.odometry_numbers(odometry)
            self.kernels.step(settings_of(self, self.kernels), before, dt, given, moved, F, Q)
            return MotionPrediction(self.state_of(moved), F, np.eye(size), Q)
        Q = self.noise(dt, odometry)
        still = np.zeros(len(Q))
        there = self.move(state, dt, odometry, still)

        def by_state(delta: FloatArray) -> FloatArray:
            return self.difference(there, self.move(self.corrected(state, delta), dt, odometry, still))

        F = derivatives.jacobian(by_state, size)
        G = derivatives.jacobian(lambda n: self.difference(there, self.move(state, dt, odometry, n)), len(Q))
        return MotionPrediction(there, F, G, Q)

    def odometry_measurement(self, state: CameraState, dt: float, odometry: Any) -> LinearMeasurement | None:
        """Odometry of the step as a measurement of the predicted state; None: the prediction has used it up."""
        if self.kernels is None or self.kernels.measure is None:
            return None
        r, size, given = self.kernels.rows, _size(self), self.odometry_numbers(odometry)
        measured = LinearMeasurement(np.zeros(r), np.zeros((r, size)), np.zeros((r, r)))
        written = measured.innovation, measured.H, measured.R
        self.kernels.measure(settings_of(self, self.kernels), self.numbers_of(state), dt, given, *written)
        return measured

    def odometry_numbers(self, odometry: Any) -> FloatArray:
        """What kernels take of the odometry of a step, (K, w): velocities, then their covariance; none: no rows."""
        if odometry is None:
            return np.zeros((0, 6))
        return np.vstack([np.concatenate([odometry.linear, odometry.angular]), odometry.covariance])

    def numbers_of(self, state: CameraState) -> FloatArray:
        """What the model moves as kernels take it: pose, velocities, values of its variables; (v,)."""
        camera = state.position, state.orientation, state.linear_velocity, state.angular_velocity
        return np.concatenate([*camera, *(state.variables[variable.name] for variable in self.variables)])

    def state_of(self, numbers: FloatArray) -> CameraState:
        """The state that has these numbers."""
        stops = np.cumsum([3, 4, 3, 3, *(len(variable.value) for variable in self.variables)])[:-1]
        position, orientation, linear, angular, *own = np.split(numbers, stops)
        variables = {variable.name: value for variable, value in zip(self.variables, own, strict=True)}
        return CameraState(position, orientation, linear, angular, variables)

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


def input_of(
    motion: MotionModel, slam: StereoFilter, odometry: BodyVelocity | None, inertial: InertialSamples | None
) -> StepInput | None:
    """Of what is known of a step, what the motion takes; the filter says once that it makes no use of samples."""
    given = inertial if motion.takes is InertialSamples else odometry
    if inertial is not None and given is not inertial:
        slam.say_unused("inertial")
    motion.check_odometry(given)
    return given


def predict_camera(motion: MotionModel, state: CameraState, dt: float, odometry: StepInput | None) -> MotionPrediction:
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
    motion: MotionModel, state: CameraState, dt: float, odometry: StepInput
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
