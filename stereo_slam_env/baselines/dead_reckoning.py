"""Filters of the camera alone: their base, a belief without a map, and dead reckoning."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from filters import (
    BodyVelocity,
    CameraState,
    Forecast,
    InertialSamples,
    LandmarkBelief,
    MotionModel,
    PoseBelief,
    Start,
    StereoCamera,
    StereoFilter,
    StereoNoise,
    StereoObservation,
    UpdateReport,
    VelocityBelief,
    VelocityDriven,
)
from filters.contract.stereo_filter import AT_ORIGIN, check_rig, check_start, check_step
from filters.contract.validation import finite_array, unique_ids, unit_quaternion
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE
from filters.parts import Named, make_part

_DRIVEN = VelocityDriven()


@dataclass(frozen=True, eq=False)
class CameraBelief:
    """A camera state and the covariance (12, 12) of its error, in the order of `filters.motions.motion_model`."""

    state: CameraState
    P: FloatArray

    def predicted(self, dt: float, odometry: BodyVelocity | None, motion: MotionModel) -> CameraBelief:
        """After `dt` seconds: driven by the odometry where there is one, by `motion` where not."""
        from filters.engine.steps import predict_camera  # Numba takes longer to import than all the rest

        step = predict_camera(motion if odometry is None else _DRIVEN, self.state, dt, odometry)
        P = step.F @ self.P @ step.F.T + step.G @ step.Q @ step.G.T
        return CameraBelief(step.state, symmetrised(P))


def symmetrised(P: FloatArray) -> FloatArray:
    """The mean of P (..., n, n) and its transpose: rounding leaves no asymmetry behind."""
    mean: FloatArray = 0.5 * (P + P.swapaxes(-1, -2))
    return mean


class CameraFilter(StereoFilter):
    """A filter that keeps a belief about the camera, and (unless a subclass says otherwise) no map.

    The pose error is [position in W ; Log(R_est^T R_true)], the one of `PoseBelief`.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d) for measurements that bring none of their own.
    motion : str, mapping or MotionModel, optional
        How the camera moves where there is no odometry, a model without variables of its own; None:
        `ConstantVelocity()`.

    Raises
    ------
    ValueError
        An argument is of the wrong type.
    """

    open_options = frozenset({"motion"})

    def __init__(self, camera: StereoCamera, noise: StereoNoise, *, motion: Named | MotionModel | None = None) -> None:
        check_rig(camera, noise)
        self.camera = camera
        self.noise = noise
        self._motion: MotionModel = make_part("motion", "constant-velocity" if motion is None else motion)
        if self._motion.variables:
            names = ", ".join(variable.name for variable in self._motion.variables)
            raise ValueError(f"motion must have no variables of its own in this filter, got {names}: use a StereoEKF")
        self.reset()

    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Start again; see `StereoFilter.reset`."""
        check_start(start)
        self._belief = CameraBelief(CameraState.at(start), start.assumed_covariance)
        self._restart()

    def _restart(self) -> None:
        """Forget whatever a subclass keeps besides the belief, which is already the new one."""

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the belief forward; see `CameraBelief.predicted`."""
        dt = check_step(dt, odometry, inertial)
        if inertial is not None:
            self.say_unused("inertial")
        self._move(dt, odometry)

    def _move(self, dt: float, odometry: BodyVelocity | None) -> None:
        self._belief = self._belief.predicted(dt, odometry, self._motion)

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Use the frame; see `StereoFilter.update`."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        # One order for everything below, so that the result cannot depend on the order of the measurements.
        return self._use(observation.ordered())

    @abstractmethod
    def _use(self, observation: StereoObservation) -> UpdateReport:
        """Use the frame, whose ids ascend."""

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Nothing to forecast: there is no map."""
        wanted = unique_ids("ids", np.asarray([] if ids is None else ids))
        if len(wanted):
            raise ValueError(f"ids must be in the map, and this filter has none, got {wanted[:5].tolist()}")
        return Forecast(wanted, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=bool))

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Nothing to forget: there is no map."""
        unique_ids("ids", np.asarray(ids))

    @property
    def pose(self) -> PoseBelief:
        """Pose of the left camera."""
        state, P = self._belief.state, self._belief.P
        return PoseBelief(state.position.copy(), state.orientation.copy(), P[:POSE_SIZE, :POSE_SIZE].copy())

    @property
    def velocity(self) -> VelocityBelief:
        """Velocity of the left camera."""
        state, P = self._belief.state, self._belief.P
        return VelocityBelief(
            state.linear_velocity.copy(), state.angular_velocity.copy(), P[POSE_SIZE:, POSE_SIZE:].copy()
        )

    @property
    def landmarks(self) -> LandmarkBelief:
        """An empty map."""
        none = np.zeros(0)
        return LandmarkBelief(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3, 3)), none, none.copy())

    def pose_error(self, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position difference in W and Log(R_est^T R_true), with the covariance of the pose."""
        true_position = finite_array("position", position, (3,))
        true_orientation = unit_quaternion("orientation", orientation)
        state = self._belief.state
        turn = rotations.log(state.R_wc.T @ rotations.matrix(true_orientation))
        return np.concatenate([true_position - state.position, turn]), self.pose.covariance


class DeadReckoning(CameraFilter):
    """Odometry integrated, or constant velocity where there is none: no camera, no map.

    Every measurement is new to it and starts nothing, so every id is reported as rejected.
    """

    def _use(self, observation: StereoObservation) -> UpdateReport:
        return UpdateReport(rejected=observation.ids)
