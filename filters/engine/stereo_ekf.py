"""`StereoEKF`: landmark parametrisation x measurement model x error definition x motion model, as one filter.

The named filters are choices of these parts; this module only says in which order they work.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from filters.bodies.moving_bodies import MovingBodies
from filters.bodies.rigid_bodies import BodiesBelief, RigidBodies
from filters.contract.inputs import BodyVelocity, InertialSamples, Start, StereoObservation
from filters.contract.noise import LandmarkDrift, StereoNoise
from filters.contract.outputs import (
    POSE,
    VELOCITY,
    Forecast,
    LandmarkBelief,
    PoseBelief,
    UpdateReport,
    VariableBelief,
    VelocityBelief,
)
from filters.contract.stereo_filter import AT_ORIGIN, check_rig, check_start, check_step
from filters.contract.validation import (
    finite_array,
    unique_ids,
    unit_quaternion,
)
from filters.engine.named_variables import VariableFilter
from filters.engine.options import Options
from filters.errors import ErrorDefinition, Linearisation
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose, relative_jacobian
from filters.joint_state import JointState, joint_covariance, landmark_belief, pose_landmark_covariances
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.constant_velocity import moved_by
from filters.motions.motion_model import CameraState, MotionModel, StepInput, input_of
from filters.parts import Named

if TYPE_CHECKING:
    from filters.engine.engine import Engine
    from filters.engine.row import Row

_ENGINE_DOES = ("reset", "predict", "update", "forecast", "pose", "velocity", "pose_error", "state_size", "state")
_STEP = "begin of the step"
"""Clone of the pose before a step of samples, while odometry of that step is fused."""


class StereoEKF(VariableFilter):
    """Extended Kalman filter for stereo SLAM, composed by options.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d) for measurements that bring none of their own.
    motion : str, mapping or MotionModel
        "constant-velocity" (Eq. 6), "velocity-driven", "strapdown"; a name, a table or an object (`filters.make_part`).
    gate : float or None
        Probability with which a consistent measurement of a landmark passes the chi-square gate; None: no gate.
    landmark : str, mapping or LandmarkModel
        Parametrisation: "inverse-depth", "shared-anchor", "euclidean", "hybrid", ...
    measurement : str, mapping or MeasurementModel
        What is measured, and in which steps: "joint" (u, v, d) · "sequential", left then right · "stacked", the pixels
        of both cameras at once · "left" pixel only; ...
    error : str, mapping or ErrorDefinition
        "quaternion", the paper's · "so3", rotation vector · "first-estimates" Jacobians · "right-invariant" ·
        "left-invariant".
    update : str, mapping or Linearisation
        "extended", by Jacobians, or "unscented", by sigma points on the measured part of the state.
    consensus : bool
        One-point RANSAC over the frame: first correct with the largest set of measurements that agree, then let in
        those that pass the gate at the corrected state.
    tail_dof : float, optional
        Degrees of freedom of Student's t for heavy-tailed noise: surprising measurements count less. None: Gaussian.
    drift : float, mapping or LandmarkDrift, optional
        Process noise of measured landmarks: a share of their R, or a table of `LandmarkDrift`'s numbers. None: none.
    gauge_walk : float
        Random walk of camera and map together in the directions that vision cannot see, for errors that all tracks have
        in common, rad per root of a radian of image motion. Needs error="first-estimates" or "right-invariant".
    iterations : int
        Passes of the update; 1 is the plain EKF, more relinearise at the result with the prior held (Gauss-Newton).
    relinearise_above : float
        More passes relinearise only measurements whose tangent misses the result by more: the sum of squares of the
        miss over the variances of the rows. 0: all, which makes the way too long where odometry is the scale.
    drop_unseen : bool
        The paper's policy: a landmark not in the current observation leaves the map.
    bodies : RigidBodies, mapping or bool, optional
        Moving bodies in the state: what they are, or a table of its settings; True: with the defaults. None: there are
        none, and what moves is for the gate.
    min_disparity : float, optional
        A landmark is not started from a smaller disparity, px. None: whatever the parametrisation can do.

    Raises
    ------
    ValueError
        An option has an unknown or impossible value.
    """

    open_options = frozenset(
        {"motion", "gate", "landmark", "measurement", "error", "update", "consensus", "tail_dof", "drift", "gauge_walk"}
        | {"iterations", "relinearise_above", "drop_unseen", "min_disparity", "bodies"}
    )

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        motion: Named | MotionModel | None = None,
        gate: float | None = 0.99,
        landmark: Named | LandmarkModel = "inverse-depth",
        measurement: Named | MeasurementModel = "joint",
        error: Named | ErrorDefinition = "quaternion",
        update: Named | Linearisation = "extended",
        consensus: bool = False,
        tail_dof: float | None = None,
        drift: float | Mapping[str, Any] | LandmarkDrift | None = None,
        gauge_walk: float = 0.0,
        iterations: int = 1,
        relinearise_above: float = 0.0,
        drop_unseen: bool = True,
        min_disparity: float | None = None,
        bodies: RigidBodies | Mapping[str, Any] | bool | None = None,
    ) -> None:
        from filters.engine.row import Row  # Numba takes longer to import than all the rest

        check_rig(camera, noise)
        self.camera = camera
        self.noise = noise
        self.options = Options.of(
            motion=motion,
            gate=gate,
            landmark=landmark,
            measurement=measurement,
            error=error,
            update=update,
            consensus=consensus,
            tail_dof=tail_dof,
            drift=drift,
            gauge_walk=gauge_walk,
            iterations=iterations,
            relinearise_above=relinearise_above,
            drop_unseen=drop_unseen,
            min_disparity=min_disparity,
            bodies=bodies,
        )
        self._row = Row.of(camera, self.options)
        self.reset()

    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Start again with an empty map; see `StereoFilter.reset`."""
        check_start(start)
        self.state = JointState.at(start, self.options.layout, self.options.landmark)
        self._bodies = None if self.options.bodies is None else MovingBodies(self.options.bodies, self.camera)

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the belief forward (Eq. 6, 11, 12), then fuse what odometry adds."""
        dt = check_step(dt, odometry, inertial)
        step_input = input_of(self.options.motion, self, odometry, inertial)
        self._move(dt, odometry, step_input)
        if self._bodies is not None:
            self._bodies.step(self._row, dt)

    def _move(self, dt: float, odometry: BodyVelocity | None, step_input: StepInput | None) -> None:
        """Move the camera, and fuse what odometry adds."""
        if odometry is None or step_input is odometry:
            self._row.predict(dt, step_input)
            return
        self._row.clone_pose(_STEP)  # samples have moved the belief: odometry measures how far
        self._row.predict(dt, step_input)
        begun, now = self._row.held_values()[_STEP], self._row.camera
        first, last = Pose(begun[:3], begun[3:]), Pose(now.position, now.orientation)
        innovation, R = moved_by(odometry, dt, first.inverse() @ last)
        H = relative_jacobian(first, last)
        self.correct(innovation, {_STEP: H[:, :6], POSE: H[:, 6:]}, R)
        self._row.remove(_STEP)

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Known ids correct the state, unseen ones leave, new ones enter; see `StereoFilter.update`."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        # One order for everything below, so that the result cannot depend on the order of the measurements.
        observation = self.options.measurement.completed(observation.ordered(), self.camera)
        if self._bodies is None:
            return self._row.update(observation, self.noise)
        admitted = self._bodies.admit(self._row, observation, self.noise)
        report = self._row.update(admitted, self.noise)
        return self._bodies.after(self._row, observation, report)

    def assume(self, noise: StereoNoise, **options: Any) -> None:
        """Go on with another noise of the measurements, as one that is measured while the drive goes.

        `options` are `drift`, `gauge_walk` and a `landmark` of the same kind; a `ValueError` says what is impossible.
        """
        present_type, asked_type = (type(one).__name__ for one in (self.options.landmark, options.get("landmark")))
        if "landmark" in options and asked_type != present_type:
            raise ValueError(f"landmark must be of the kind that the filter has, {present_type}, got {asked_type}")
        assumed = replace(self.options, **options)
        self._row.assume(self.camera, assumed)
        self.noise, self.options = noise, assumed

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predicted (u, v, d) and S of landmarks at the current pose."""
        wanted_ids, index = self._wanted(ids)
        engine, number = self._row.engine, self._row.number
        uvd, S, in_front = engine.forecast(slice(number, number + 1), self.noise.R[None])
        if ids is not None:
            uvd, S, in_front = uvd[index], S[index], in_front[index]
        return Forecast(wanted_ids, uvd, S, in_front & self.camera.in_view(uvd))

    def joint_covariance(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """Covariance of the pose error and landmark positions, correlations included; see the base class."""
        return joint_covariance(self.state, self._wanted(ids)[1])

    def pose_landmark_covariances(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """Covariances of pose and one landmark each; see the base class."""
        return pose_landmark_covariances(self.state, self._wanted(ids)[1])

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Marginalise landmarks out; ids not in the map are ignored."""
        self._row.forget(unique_ids("ids", np.asarray(ids)))

    @property
    def state_size(self) -> int:
        """Numbers in the error state: of the named variables, and for every landmark and anchor a landmark's (3)."""
        return self._row.state_size

    @property
    def state(self) -> JointState:
        """The joint state, for filters built on this one; a copy, to be assigned after a change."""
        return self._row.state

    @state.setter
    def state(self, state: JointState) -> None:
        self._row.state = state

    def move_to(self, camera: CameraState) -> None:
        """Put pose, velocity and variables elsewhere, as linearisation point; the covariance stays as it is."""
        self._row.move_to(camera)

    @property
    def does_as_the_engine(self) -> bool:
        """Whether it does what the engine does, nothing else, as in a `FilterBatch`; a subclass may say so itself."""
        unchanged = (
            getattr(type(self), name) is not getattr(StereoEKF, name) or name in vars(self) for name in _ENGINE_DOES
        )
        return self.options.bodies is None and not any(unchanged)

    @property
    def engine(self) -> Engine:
        """The engine that the filter is a row of."""
        return self._row.engine

    def join(self, row: Row) -> None:
        """Work on a row of an engine with others from now on; the map is empty until the filter is reset."""
        self._row = row
        self.reset()

    @property
    def pose(self) -> PoseBelief:
        """Pose of the left camera."""
        camera = self.camera_state
        return PoseBelief(camera.position, camera.orientation, self._row.joint(POSE))

    def belief(self, *names: str) -> VariableBelief:
        """Belief of named variables, or of moving bodies, "body-3"; see the base class.

        Of a body: position, orientation, velocity, angular velocity, and a covariance (12, 12), as in `BodiesBelief`.
        """
        bodies = {} if self._bodies is None else {body.names[0]: body.names for body in self._bodies.bodies}
        return super().belief(*(part for name in names for part in bodies.get(name, (name,))))

    @property
    def bodies(self) -> BodiesBelief:
        """Moving bodies in the state; none where the option `bodies` is None."""
        return (MovingBodies(RigidBodies(), self.camera) if self._bodies is None else self._bodies).belief(self._row)

    @property
    def velocity(self) -> VelocityBelief:
        """Velocity of the left camera."""
        camera = self.camera_state
        return VelocityBelief(camera.linear_velocity, camera.angular_velocity, self._row.joint(VELOCITY))

    @property
    def landmarks(self) -> LandmarkBelief:
        """The map, in ascending order of ids."""
        return landmark_belief(self.state)

    def pose_error(self, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Error of the pose in this filter's error definition; see `StereoFilter.pose_error`."""
        truth = finite_array("position", position, (3,)), unit_quaternion("orientation", orientation)
        return self.options.error.pose_error(self.camera_state, self.pose.covariance, *truth)

    def _wanted(self, ids: Sequence[int] | IntArray | None) -> tuple[IntArray, IntArray]:
        """The landmarks asked for (None: all, ascending), and where they are; refuses those that are not there."""
        all_ids = self.ids
        if ids is None:
            return all_ids, np.arange(len(all_ids))
        wanted_ids = unique_ids("ids", np.asarray(ids))
        unknown = ~np.isin(wanted_ids, all_ids)
        if unknown.any():
            raise ValueError(
                f"ids must be in the map, not there: {wanted_ids[unknown][:5].tolist()}: see landmarks.ids"
            )
        return wanted_ids, np.searchsorted(all_ids, wanted_ids)
