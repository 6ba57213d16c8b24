"""`StereoEKF`: landmark parametrisation x measurement model x error definition x motion model, as one filter.

The named filters are choices of these parts; this module only says in which order they work.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from filters.contract.beliefs import Forecast, LandmarkBelief, PoseBelief, VelocityBelief
from filters.contract.drift import LandmarkDrift
from filters.contract.known_names import require_known
from filters.contract.noise import StereoNoise
from filters.contract.observation import StereoObservation
from filters.contract.odometry import BodyVelocity
from filters.contract.start import Start
from filters.contract.stereo_filter import AT_ORIGIN, StereoFilter, check_rig, check_start
from filters.contract.update_report import UpdateReport
from filters.contract.variables import POSE, VELOCITY, VariableBelief
from filters.engine.machine_code import compiled_filter
from filters.engine.marginals import joint_covariance, pose_landmark_covariances
from filters.engine.numpy_filter import NumpyFilter, locate
from filters.engine.options import Options
from filters.errors.model import ErrorDefinition
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose, relative_jacobian
from filters.landmarks.model import LandmarkModel
from filters.measurements.model import MeasurementModel, Stage
from filters.motions.model import POSE_SIZE, MotionModel
from filters.parts import Named
from filters.state import symmetric
from filters.state.joint_state import JointState
from filters.updates.extended import Extended
from filters.updates.model import Linearisation, points_in_camera
from filters.validation import (
    FloatArray,
    IntArray,
    finite_array,
    positive,
    unique_ids,
    unit_quaternion,
)

if TYPE_CHECKING:
    from filters.engine.compiled.stereo_ekf import CompiledFilter


class StereoEKF(StereoFilter):
    """Extended Kalman filter for stereo SLAM, composed by options.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d) for measurements that bring none of their own.
    motion : str, mapping or MotionModel
        Motion model: "constant-velocity" (Eq. 6) or "velocity-driven". As of the other parts: a name, a table of
        settings, or an object, see `filters.make_part`.
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
        Process noise of measured landmarks: a share of their R, or a table of `LandmarkDrift`'s numbers. None: points
        that are tracked stay where they are.
    gauge_walk : float
        Random walk of camera and map together in the directions that vision cannot see, rad per root of a radian by
        which the landmarks move in the image: for errors that all tracks have in common. More than 0 needs
        error="first-estimates" or "right-invariant".
    iterations : int
        Passes of the update; 1 is the plain EKF, more relinearise at the result with the prior held (Gauss-Newton).
    drop_unseen : bool
        The paper's policy: a landmark not in the current observation leaves the map.
    min_disparity : float, optional
        A landmark is not started from a smaller disparity, px. None: whatever the parametrisation can do.
    max_landmarks : int, optional
        Of the landmarks in view, keep at most so many: those that say most about the pose. None: all.
    compiled : bool, optional
        Machine code: the same estimates in a fraction of the time. None: where all parts have it. True: refuse parts
        that have none.

    Raises
    ------
    ValueError
        An option has an unknown or impossible value.
    """

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
        drop_unseen: bool = True,
        min_disparity: float | None = None,
        max_landmarks: int | None = None,
        compiled: bool | None = None,
    ) -> None:
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
            drop_unseen=drop_unseen,
            min_disparity=min_disparity,
            max_landmarks=max_landmarks,
            compiled=compiled,
        )
        state = JointState.at(AT_ORIGIN, self.options.layout, self.options.landmark)
        self._filter = compiled_filter(camera, self.options) or NumpyFilter(camera, self.options, state)
        self.reset()

    def reset(self, start: Start = AT_ORIGIN) -> None:
        """Start again with an empty map; see `StereoFilter.reset`."""
        check_start(start)
        self.state = JointState.at(start, self.options.layout, self.options.landmark)

    def predict(self, dt: float, odometry: BodyVelocity | None = None) -> None:
        """Move the belief forward (Eq. 6, 11, 12), then fuse what odometry adds."""
        dt = positive("dt", dt)
        if odometry is not None and not isinstance(odometry, BodyVelocity):
            raise ValueError(f"odometry must be a BodyVelocity or None, got {odometry!r}")
        self.options.motion.check_odometry(odometry)
        self._filter.predict(dt, odometry)

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Known ids correct the state, unseen ones leave, new ones enter; see `StereoFilter.update`."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        # One order for everything below, so that the result cannot depend on the order of the measurements.
        return self._filter.update(observation.ordered(), self.noise)

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predicted (u, v, d) and S of landmarks at the current pose."""
        state, sensor = self.state, self.options.measurement
        wanted, index = self._wanted(ids)
        points_c = points_in_camera(state, index)
        uvd = sensor.predict(self.camera, points_c, state.camera.variables)[:, :3]
        stage = Stage(uvd, np.eye(3, sensor.size), self.noise.R[None].repeat(len(index), axis=0))
        linearised = Extended().linearise(sensor, self.camera, state, index, stage)
        S = linearised.innovation_covariances(state.P)
        return Forecast(wanted, uvd, S, sensor.in_front(points_c) & self.camera.in_view(uvd))

    def joint_covariance(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """Covariance of the pose error and landmark positions, correlations included; see the base class."""
        return joint_covariance(self.state, self._wanted(ids)[1])

    def pose_landmark_covariances(self, ids: Sequence[int] | IntArray | None = None) -> FloatArray:
        """Covariances of pose and one landmark each; see the base class."""
        return pose_landmark_covariances(self.state, self._wanted(ids)[1])

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Marginalise landmarks out; ids not in the map are ignored."""
        state = self.state
        state.remove(np.isin(state.ids, unique_ids("ids", np.asarray(ids))))
        self.state = state

    @property
    def state_size(self) -> int:
        """Numbers in the error state: of the named variables, and three for every landmark and every anchor."""
        return self._filter.state_size

    @property
    def state(self) -> JointState:
        """The joint state, for filters built on this one; a copy, to be assigned after a change."""
        return self._filter.state

    @state.setter
    def state(self, state: JointState) -> None:
        self._filter.state = state

    @property
    def compiled(self) -> CompiledFilter | None:
        """The filter in machine code; None: it runs by NumPy."""
        return None if isinstance(self._filter, NumpyFilter) else self._filter

    def share(self, compiled: CompiledFilter) -> None:
        """Keep what the filter knows from now on in a storage with others; its map is empty until it is reset."""
        self._filter = compiled
        self.reset()

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map, (N,), in no order; cheaper to ask than `landmarks`."""
        return self._filter.ids

    def with_state(self, state: JointState) -> StereoEKF:
        """The same filter with another state: what it says of landmarks that are kept elsewhere."""
        other = copy(self)
        other._filter = NumpyFilter(self.camera, self.options, state)
        return other

    @property
    def pose(self) -> PoseBelief:
        """Pose of the left camera."""
        camera = self._filter.camera
        return PoseBelief(camera.position.copy(), camera.orientation.copy(), self._covariance_of(POSE))

    @property
    def velocity(self) -> VelocityBelief:
        """Velocity of the left camera."""
        camera = self._filter.camera
        return VelocityBelief(
            camera.linear_velocity.copy(), camera.angular_velocity.copy(), self._covariance_of(VELOCITY)
        )

    def belief(self, name: str) -> VariableBelief:
        """Belief of a named variable: "pose", "velocity", one that a part has asked for, or a clone of the pose.

        Raises
        ------
        ValueError
            There is no variable of that name.
        """
        state, camera = self.state, self.state.camera
        if name in state.clones:
            clone = state.clones[name]
            rows = state.block_rows(clone.blocks)
            covariance = symmetric.full(symmetric.rows(state.P, rows)[:, rows])
            return VariableBelief(np.concatenate([clone.position, clone.orientation]), covariance)
        values = {
            POSE: np.concatenate([camera.position, camera.orientation]),
            VELOCITY: np.concatenate([camera.linear_velocity, camera.angular_velocity]),
            **camera.variables,
        }
        require_known("there is no variable", [name], [*values, *state.clones])
        return VariableBelief(values[name].copy(), self._covariance_of(name))

    def clone_pose(self, name: str) -> None:
        """Keep the present pose as a variable of that name, correlated with all others, until it is forgotten.

        Raises
        ------
        ValueError
            There is a variable of that name already.
        """
        state = self.state
        if name in (*self.options.layout.places, *state.clones):
            raise ValueError(f"name must be new, there is a variable {name!r} already: forget_clone it first")
        state.clone_pose(name)
        self._filter = NumpyFilter(self.camera, self.options, state)  # the kernels know no clones

    def forget_clone(self, name: str) -> None:
        """Marginalise a clone of the pose out.

        Raises
        ------
        ValueError
            There is no clone of that name.
        """
        state = self.state
        require_known("there is no clone", [name], state.clones)
        state.forget_clone(name)

    def relative_pose(self, name: str) -> PoseBelief:
        """Pose of the camera as seen from a clone of an earlier one: how the camera has moved since.

        Its covariance holds the correlation of both poses, so what is common to both, such as the error of an early
        heading, is not in it.

        Raises
        ------
        ValueError
            There is no clone of that name.
        """
        state = self.state
        require_known("there is no clone", [name], state.clones)
        clone = state.clones[name]
        rows = np.concatenate([state.block_rows(clone.blocks), np.arange(POSE_SIZE)])
        first = Pose(clone.position, clone.orientation)
        last = Pose(state.camera.position, state.camera.orientation)
        J, moved = relative_jacobian(first, last), first.inverse() @ last
        covariance = J @ symmetric.full(symmetric.rows(state.P, rows)[:, rows]) @ J.T
        return PoseBelief(moved.position, moved.orientation, covariance)

    @property
    def landmarks(self) -> LandmarkBelief:
        """The map, in ascending order of ids."""
        state, index = self.state, np.argsort(self.state.ids)
        parameters, anchors = state.parameters(index), state.anchors(index)
        points = self.options.landmark.points(anchors, parameters)
        P_map = symmetric.blocks(state.P, state.map_rows(index))
        with np.errstate(invalid="ignore", over="ignore"):
            covariances = points.by_map @ P_map @ points.by_map.transpose(0, 2, 1)
        inverse = self.options.landmark.inverse_distances(state.camera.position, anchors, parameters)
        own_rows = state.own_rows(index)
        position_rows = np.broadcast_to(np.arange(3), own_rows.shape)
        P_own = symmetric.blocks(state.P, np.concatenate([position_rows, own_rows], axis=1))
        J = np.concatenate([inverse.by_position, inverse.by_parameters], axis=1)
        variance = np.einsum("mi,mij,mj->m", J, P_own, J)
        return LandmarkBelief(state.ids[index], points.positions, covariances, inverse.values, variance)

    def pose_error(self, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Error of the pose in this filter's error definition; see `StereoFilter.pose_error`."""
        true_position = finite_array("position", position, (3,))
        true_orientation = unit_quaternion("orientation", orientation)
        camera = self._filter.camera
        return self.options.error.pose_error(camera, self.pose.covariance, true_position, true_orientation)

    def _wanted(self, ids: Sequence[int] | IntArray | None) -> tuple[IntArray, IntArray]:
        """The landmarks asked for (None: all, ascending), and where they are; refuses those that are not there."""
        there = self.ids
        wanted = np.sort(there) if ids is None else unique_ids("ids", np.asarray(ids))
        known, index = locate(there, wanted)
        if not known.all():
            raise ValueError(f"ids must be in the map, not there: {wanted[~known][:5].tolist()}: see landmarks.ids")
        return wanted, index

    def _covariance_of(self, name: str) -> FloatArray:
        return self._filter.covariance(self.options.layout.places[name])
