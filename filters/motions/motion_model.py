"""Base class of motion models, and the state that they move (Eq. 2, 6, 11, 12), with or without odometry.

Errors of a camera state are 12 numbers, those of the variables "pose" and "velocity": position (W, m), rotation (camera
frame, rad, on the right), linear velocity (W, m/s), angular velocity (camera frame, rad/s). A motion model may move
variables of its own, too: their errors follow in the order in which it names them.

Derivation: docs/derivations/motion.md.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from filters.contract.inputs import BodyVelocity, InertialSamples, Start
from filters.contract.outputs import POSE, VELOCITY, Variable
from filters.contract.stereo_filter import StereoFilter
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.poses import ADDITIVE

POSITION, ROTATION, LINEAR, ANGULAR = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
"""Errors of pose and velocity."""
POSE_SIZE, VELOCITY_SIZE = 6, 6
CAMERA_SIZE = POSE_SIZE + VELOCITY_SIZE
StepInput = BodyVelocity | InertialSamples
"""What may be known of a step besides its length."""
_CAMERA = (("position", 3), ("orientation", 4), ("linear_velocity", 3), ("angular_velocity", 3))


@cache
def _record_type(layout: tuple[tuple[str, int], ...]) -> Any:
    return namedtuple("State", [name for name, _ in layout])


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


class MotionModel:
    """Motion of the camera between two frames.

    A part gives `step`, a plain function of tuples of numbers, and the standard deviations of its noise or
    `driven = True`; Jacobians follow.

    References
    ----------
    Davison, Reid, Molton and Stasse, "MonoSLAM", IEEE PAMI 29(6), 2007, section 3.4 (constant velocity).
    Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018 (Jacobians).
    """

    variables: tuple[Variable, ...] = ()
    """Variables of the state that it moves or needs besides pose and velocity, such as biases. Their random walks are
    added by the filter."""
    takes: ClassVar[type[BodyVelocity] | type[InertialSamples]] = BodyVelocity
    """Input of a step that it can use: odometry, or inertial samples."""
    driven: ClassVar[bool] = False
    """Whether that input is the motion; it is then needed in every step."""
    in_machine_code: bool = True
    """Whether the plain functions are compiled; else they run in Python."""

    def step(self, x: Any, dt: float, n: Any) -> Any:
        """State after `dt` > 0 seconds.

        Parameters
        ----------
        x : named tuple of tuples
            position (W, m), orientation (xyzw), linear_velocity (W, m/s), angular_velocity (camera frame, rad/s), then
            the values of `variables` in their order, with _ for - in their names.
        dt : float
            Seconds; with inertial samples those that a sample stands for.
        n : tuple
            Noise of the standard deviations `sigmas`. Where odometry drives: linear and angular velocity, with their
            errors. Where inertial samples do: angular rate and specific force with their errors, walks of the two
            biases, position and orientation of the unit in the camera frame.

        Returns
        -------
        tuple of tuples
            The state in the same order.
        """
        raise NotImplementedError(f"{type(self).__name__} must have step: see MotionModel")

    def sigmas(self, dt: float) -> tuple[float, ...]:
        """Standard deviations of the noise of a step, where nothing drives it."""
        raise NotImplementedError(f"{type(self).__name__} must have sigmas, or driven = True: see MotionModel")

    def odometry(self, x: Any, dt: float) -> Any:
        """Expected odometry of the step that has led to x: linear and angular velocity, camera frame.

        A model that has it fuses odometry as a measurement after the step.
        """
        raise NotImplementedError(f"{type(self).__name__} expects no odometry")

    def check_odometry(self, odometry: StepInput | None) -> None:
        """Raise a `ValueError` if the model cannot make a step with this input."""
        if self.driven and not isinstance(odometry, self.takes):
            name = "inertial" if self.takes is InertialSamples else "odometry"
            raise ValueError(
                f"{name} must be given in every predict with motion={type(self).__name__}(): "
                f"pass {self.takes.__name__}, or use motion=ConstantVelocity(...)"
            )

    def predict(self, state: CameraState, dt: float, odometry: StepInput | None) -> MotionPrediction:
        """Predicted state, its Jacobians and its noise after `dt` > 0 seconds (Eq. 6, 12)."""
        self.check_odometry(odometry)
        rows = np.zeros((0, 6)) if odometry is None else odometry.rows
        moved, F, G, Q = self.stepped(self.numbers_of(state), dt, rows)
        return MotionPrediction(self.state_of(moved, state.variables), F, G, Q)

    def odometry_measurement(self, state: CameraState, dt: float, odometry: Any) -> LinearMeasurement | None:
        """Odometry of the step as a measurement of the predicted state; None: the prediction has used it up."""
        if self.driven or not self.expects_odometry:
            return None
        expected, H = self.expected_odometry(self.numbers_of(state), dt)
        return LinearMeasurement(np.concatenate([odometry.linear, odometry.angular]) - expected, H, odometry.covariance)

    def stepped(self, x: FloatArray, dt: float, rows: FloatArray) -> tuple[FloatArray, ...]:
        """`predict` for numbers (v,) of the state and rows of the input: moved numbers, F, G and Q."""
        if not self.driven:
            sigmas = np.array(self.sigmas(dt))
            return *self._stepped(x, dt, 0.0 * sigmas, lambda n: n), np.diag(sigmas**2)
        if self.takes is BodyVelocity:
            return *self._stepped(x, dt, rows[0, :6], lambda n: (n[:3], n[3:])), rows[1:7, :6]
        size, begin = self.size, 0.0
        F, Q, unit_pose = np.eye(size), np.zeros((size, size)), (tuple(rows[0, :3]), tuple(rows[1, :4]))
        for end, *sample in zip([*rows[3:-1, 0], dt], rows[3:, 1:7], strict=True):
            h, begin, n = end - begin, end, np.concatenate([*sample, np.zeros(6)])
            noise = np.repeat(np.concatenate([rows[0, 3:5] / np.sqrt(h), rows[2, :2] * np.sqrt(h)]), 3)
            x, A, B = self._stepped(x, h, n, lambda n: (n[:3], n[3:6], n[6:9], n[9:], *unit_pose))
            F, Q = A @ F, A @ Q @ A.T + (B * noise**2) @ B.T
        return x, F, np.eye(size), Q

    def expected_odometry(self, x: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """`odometry` of numbers (v,) of the state, (6,), and its Jacobian (6, m) by the errors."""

        def expected(numbers: Any) -> Any:
            linear, angular = self.odometry(self.record(numbers), dt)
            return (*linear, *angular)

        (predicted,), (J,) = derivatives.jacobian_of(expected, x[None])
        return predicted, J @ self._by_errors(x)

    @property
    def size(self) -> int:
        """Error numbers m of what it moves."""
        return CAMERA_SIZE + sum(variable.size for variable in self.variables)

    @property
    def expects_odometry(self) -> bool:
        """Whether the model says which odometry it expects."""
        return type(self).odometry is not MotionModel.odometry

    def _stepped(self, x: FloatArray, dt: float, n: FloatArray, grouped: Callable[..., Any]) -> tuple[FloatArray, ...]:
        """Numbers after a step with the noise n (k,), as `step` takes it by groups, and its Jacobians F and G."""
        v = len(x)

        def stepped(numbers: Any) -> Any:
            return [y for part in self.step(self.record(numbers[:v]), dt, grouped(numbers[v:])) for y in part]

        (after,), (J,) = derivatives.jacobian_of(stepped, np.concatenate([x, n])[None])
        to_errors = self._to_errors(after)
        return after, to_errors @ J[:, :v] @ self._by_errors(x), to_errors @ J[:, v:]

    def record(self, numbers: Any) -> Any:
        """Numbers of a state as the plain functions take them."""
        stops = np.cumsum([0, *(size for _, size in self.layout)]).tolist()
        return _record_type(self.layout)(*(tuple(numbers[i:j]) for i, j in pairwise(stops)))

    @property
    def layout(self) -> tuple[tuple[str, int], ...]:
        """Names of what the model moves, and how many numbers each value has."""
        return (*_CAMERA, *((variable.name.replace("-", "_"), len(variable.value)) for variable in self.variables))

    def _by_errors(self, numbers: FloatArray) -> FloatArray:
        """Derivatives (v, m) of the numbers of a state by its errors."""
        J, row, column = np.zeros((len(numbers), self.size)), 0, 0
        adds = (True, False, True, True, *(variable.retraction is ADDITIVE for variable in self.variables))
        for (_, size), is_sum in zip(self.layout, adds, strict=True):
            errors = size if is_sum else 3
            x, y, z, w = np.zeros(4) if is_sum else 0.5 * numbers[row : row + 4]
            block = np.eye(size) if is_sum else [[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]]  # q x (delta / 2, 1)
            J[row : row + size, column : column + errors] = block
            row, column = row + size, column + errors
        return J

    def _to_errors(self, numbers: FloatArray) -> FloatArray:
        """Derivatives (m, v) of the errors by the numbers: the pseudo-inverse, as the columns are orthogonal."""
        J = self._by_errors(numbers)
        inverse: FloatArray = J.T / np.sum(J * J, axis=0)[:, None]
        return inverse

    def numbers_of(self, state: CameraState) -> FloatArray:
        """Pose, velocities and values of its variables in one vector; (v,)."""
        camera = state.position, state.orientation, state.linear_velocity, state.angular_velocity
        return np.concatenate([*camera, *(state.variables[variable.name] for variable in self.variables)])

    def state_of(self, numbers: FloatArray, others: Mapping[str, FloatArray]) -> CameraState:
        """The state that has these numbers, and of other variables the values of `others`."""
        stops = np.cumsum([size for _, size in self.layout])[:-1]
        position, orientation, linear, angular, *other_values = np.split(numbers, stops)
        moved = {variable.name: value for variable, value in zip(self.variables, other_values, strict=True)}
        return CameraState(position, orientation, linear, angular, {**others, **moved})

    @property
    def moves(self) -> tuple[str, ...]:
        """Names of what F moves, in its order."""
        return (POSE, VELOCITY, *(variable.name for variable in self.variables))

    def corrected(self, state: CameraState, delta: FloatArray) -> CameraState:
        """State with errors (m,) of what the model moves added, to first order."""
        numbers = self.numbers_of(state)
        return self.state_of(numbers + self._by_errors(numbers) @ delta, state.variables)

    def difference(self, state: CameraState, other: CameraState) -> FloatArray:
        """Errors (m,) that take `state` to `other`, to first order."""
        numbers = self.numbers_of(state)
        errors: FloatArray = self._to_errors(numbers) @ (self.numbers_of(other) - numbers)
        return errors


def input_of(
    motion: MotionModel, slam: StereoFilter, odometry: BodyVelocity | None, inertial: InertialSamples | None
) -> StepInput | None:
    """Input that the motion takes of a step; the filter says once that it makes no use of samples."""
    step_input = inertial if motion.takes is InertialSamples else odometry
    if inertial is not None and step_input is not inertial:
        slam.say_unused("inertial")
    motion.check_odometry(step_input)
    return step_input
