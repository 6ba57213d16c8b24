"""`StereoEKF`: landmark parametrisation x measurement model x error definition x motion model, as one filter.

The named filters are choices of these parts; this module only says in which order they work.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from filters import rotations
from filters.camera import StereoCamera
from filters.engine import gating, kalman, symmetric
from filters.engine.joint_state import JointState
from filters.engine.retraction import AdditiveQuaternion, Retraction, RotationVector
from filters.interface import (
    BodyVelocity,
    Forecast,
    LandmarkBelief,
    PoseBelief,
    StereoFilter,
    StereoObservation,
    UpdateReport,
    VelocityBelief,
)
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.parametrisation import LandmarkModel
from filters.landmarks.shared_anchor import SharedAnchorInverseDepth
from filters.measurements.bearing import LeftOnly, LeftThenRight, Stacked
from filters.measurements.model import MeasurementModel, Stage
from filters.measurements.range_bearing import RangeBearing
from filters.motion import (
    ANGULAR,
    CAMERA_SIZE,
    LINEAR,
    POSITION,
    ROTATION,
    CameraState,
    ConstantVelocity,
    MotionModel,
)
from filters.noise import StereoNoise
from filters.validation import (
    BoolArray,
    FloatArray,
    IntArray,
    covariance_matrix,
    finite_array,
    positive,
    unique_ids,
    unit_quaternion,
)

LANDMARKS: Mapping[str, LandmarkModel] = {
    "inverse-depth": InverseDepth(),
    "shared-anchor": SharedAnchorInverseDepth(),
    "euclidean": Euclidean(),
}
MEASUREMENTS: Mapping[str, MeasurementModel] = {
    "joint": RangeBearing(),
    "sequential": LeftThenRight(),
    "stacked": Stacked(),
    "left": LeftOnly(),
}
ERRORS: Mapping[str, Retraction] = {"quaternion": AdditiveQuaternion(), "so3": RotationVector()}

# Standard deviations at reset when the caller gives no covariance: a known pose, a broad velocity.
KNOWN_POSE = 1e-6
BROAD_LINEAR_VELOCITY = 10.0
BROAD_ANGULAR_VELOCITY = 0.5

T = TypeVar("T")


class StereoEKF(StereoFilter):
    """Extended Kalman filter for stereo SLAM, composed by options.

    Parameters
    ----------
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d) for measurements that bring none of their own.
    motion : MotionModel
        `ConstantVelocity` (Eq. 6) or `VelocityDriven`.
    gate : float or None
        Probability with which a consistent measurement of a landmark passes the chi-square gate; None: no gate.
    landmark : {"inverse-depth", "shared-anchor", "euclidean"}
        Parametrisation of landmarks.
    measurement : {"joint", "sequential", "stacked", "left"}
        Measurement model: (u, v, d) · left then right · both eyes' pixels at once · left pixel only.
    error : {"quaternion", "so3"}
        Error definition of the orientation.
    iterations : int
        Passes of the update; 1 is the plain EKF, more relinearise at the result with the prior held (Gauss-Newton).
    drop_unseen : bool
        The paper's policy: a landmark not in the current observation leaves the map.
    min_disparity : float, optional
        A landmark is not started from a smaller disparity, px. None: whatever the parametrisation can do.

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
        motion: MotionModel | None = None,
        gate: float | None = 0.99,
        landmark: str = "inverse-depth",
        measurement: str = "joint",
        error: str = "quaternion",
        iterations: int = 1,
        drop_unseen: bool = True,
        min_disparity: float | None = None,
    ) -> None:
        if not isinstance(camera, StereoCamera):
            raise ValueError(f"camera must be a StereoCamera, got {camera!r}")
        if not isinstance(noise, StereoNoise):
            raise ValueError(f"noise must be a StereoNoise, got {noise!r}: see StereoNoise.independent_pixels")
        if gate is not None and not (isinstance(gate, float | int) and 0.0 < gate < 1.0):
            raise ValueError(f"gate must be a probability between 0 and 1, or None for no gate, got {gate!r}")
        if type(iterations) is not int or iterations < 1:
            raise ValueError(f"iterations must be an integer >= 1, got {iterations!r}")
        if not isinstance(drop_unseen, bool):
            raise ValueError(f"drop_unseen must be True or False, got {drop_unseen!r}")
        if min_disparity is not None and not (isinstance(min_disparity, float | int) and np.isfinite(min_disparity)):
            raise ValueError(f"min_disparity must be a finite number of px, or None, got {min_disparity!r}")
        if motion is not None and not isinstance(motion, MotionModel):
            raise ValueError(f"motion must be a motion model such as ConstantVelocity(3.0, 0.6), got {motion!r}")
        self.camera = camera
        self.noise = noise
        self._motion: MotionModel = ConstantVelocity() if motion is None else motion
        self._gate = gate
        self._landmark = _choice("landmark", landmark, LANDMARKS)
        self._measurement = _choice("measurement", measurement, MEASUREMENTS)
        self._error = _choice("error", error, ERRORS)
        self._iterations = iterations
        self._drop_unseen = drop_unseen
        self._min_disparity = min_disparity
        self.reset()

    def reset(
        self,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        linear_velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        covariance: ArrayLike | None = None,
    ) -> None:
        """Start again with an empty map; see `StereoFilter.reset`."""
        camera = CameraState(
            finite_array("position", position, (3,)),
            unit_quaternion("orientation", orientation),
            finite_array("linear_velocity", linear_velocity, (3,)),
            finite_array("angular_velocity", angular_velocity, (3,)),
        )
        if covariance is None:
            sigmas = np.repeat([KNOWN_POSE, KNOWN_POSE, BROAD_LINEAR_VELOCITY, BROAD_ANGULAR_VELOCITY], 3)
            P = np.diag(sigmas**2)
        else:
            P = covariance_matrix("covariance", covariance, CAMERA_SIZE)
        self._state = JointState(camera, np.array(P, order="F"), self._landmark)

    def predict(self, dt: float, odometry: BodyVelocity | None = None) -> None:
        """Move the belief forward (Eq. 6, 11, 12), then fuse what odometry adds."""
        dt = positive("dt", dt)
        if odometry is not None and not isinstance(odometry, BodyVelocity):
            raise ValueError(f"odometry must be a BodyVelocity or None, got {odometry!r}")
        predicted = self._motion.predict(self._state.camera, dt, odometry)
        self._state.transform_camera(predicted.F, predicted.G @ predicted.Q @ predicted.G.T)
        self._state.camera = predicted.state
        if odometry is not None:
            measured = self._motion.odometry_measurement(predicted.state, dt, odometry)
            if measured is not None:
                correction = kalman.update(self._state.P, kalman.of_camera(measured))
                self._retract(self._state, correction.delta)

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Known ids correct the state, unseen ones leave, new ones enter; see `StereoFilter.update`."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        # One order for everything below, so that the result cannot depend on the order of the measurements.
        observation = observation.select(np.argsort(observation.ids))
        known, index = self._locate(observation.ids)
        report = self._correct(observation.select(known), index)
        gone = ~np.isin(self._state.ids, observation.ids) & self._drop_unseen
        dropped = self._state.ids[gone]
        self._state.remove(gone)
        initialised, rejected = self._initialise(observation.select(~known))
        return replace(report, dropped=dropped, initialised=initialised, rejected=rejected)

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predicted (u, v, d) and S of landmarks at the current pose."""
        state = self._state
        wanted = np.sort(state.ids) if ids is None else unique_ids("ids", np.asarray(ids))
        known, index = self._locate(wanted)
        if not known.all():
            raise ValueError(f"ids must be in the map, not there: {wanted[~known][:5].tolist()}: see landmarks.ids")
        uvd, in_front = self._project(state, index)
        linearised = self._linearise(state, index, Stage(uvd, np.eye(3), self._noise_of(len(index))))
        S = linearised.innovation_covariances(state.P)
        return Forecast(wanted, uvd, S, in_front & self.camera.in_view(uvd))

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Marginalise landmarks out; ids not in the map are ignored."""
        self._state.remove(np.isin(self._state.ids, unique_ids("ids", np.asarray(ids))))

    @property
    def pose(self) -> PoseBelief:
        """Pose of the left camera."""
        camera = self._state.camera
        return PoseBelief(camera.position.copy(), camera.orientation.copy(), symmetric.full(self._state.P[:6, :6]))

    @property
    def velocity(self) -> VelocityBelief:
        """Velocity of the left camera."""
        camera = self._state.camera
        return VelocityBelief(
            camera.linear_velocity.copy(),
            camera.angular_velocity.copy(),
            symmetric.full(self._state.P[6:12, 6:12]),
        )

    @property
    def landmarks(self) -> LandmarkBelief:
        """The map, in ascending order of ids."""
        state, index = self._state, np.argsort(self._state.ids)
        parameters, anchors = state.parameters(index), state.anchors(index)
        points = self._landmark.points(anchors, parameters)
        by_map = points.by_parameters
        if points.by_anchor is not None:
            by_map = np.concatenate([points.by_anchor, points.by_parameters], axis=2)
        P_map = symmetric.blocks(state.P, state.map_rows(index))
        with np.errstate(invalid="ignore", over="ignore"):
            covariances = by_map @ P_map @ by_map.transpose(0, 2, 1)
        inverse = self._landmark.inverse_distances(state.camera.position, parameters)
        own_rows = CAMERA_SIZE + 3 * state.parameter_block[index, None] + np.arange(3)
        position_rows = np.broadcast_to(np.arange(3), own_rows.shape)
        P_own = symmetric.blocks(state.P, np.concatenate([position_rows, own_rows], axis=1))
        J = np.concatenate([inverse.by_position, inverse.by_parameters], axis=1)
        variance = np.einsum("mi,mij,mj->m", J, P_own, J)
        return LandmarkBelief(state.ids[index], points.positions, covariances, inverse.values, variance)

    def pose_error(self, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Position difference in W, and the correction that takes the orientation to the true one."""
        true_position = finite_array("position", position, (3,))
        true_orientation = unit_quaternion("orientation", orientation)
        camera = self._state.camera
        error = np.concatenate(
            [true_position - camera.position, self._error.local(camera.orientation, true_orientation)]
        )
        return error, self.pose.covariance

    def _locate(self, ids: IntArray) -> tuple[BoolArray, IntArray]:
        """Which of `ids` are in the map, and where those are."""
        order = np.argsort(self._state.ids)
        place = np.searchsorted(self._state.ids, ids, sorter=order)
        candidate = order[np.minimum(place, len(order) - 1)] if len(order) else np.zeros(len(ids), np.int64)
        known = self._state.ids[candidate] == ids if len(order) else np.zeros(len(ids), dtype=bool)
        return known, candidate[known]

    def _noise_of(self, count: int, R: FloatArray | None = None) -> FloatArray:
        return np.broadcast_to(self.noise.R, (count, 3, 3)) if R is None else R

    def _project(self, state: JointState, index: IntArray) -> tuple[FloatArray, BoolArray]:
        """Predicted (u, v, d) of landmarks (Eq. 8-10, 13), and whether their rays point forward."""
        seen = self._landmark.relative_to(
            state.camera.position, state.anchors(index), state.parameters(index)
        ).homogeneous
        h_c = seen[:, :3] @ state.camera.R_wc
        return self.camera.project_scaled(h_c, seen[:, 3]), h_c[:, 2] > 0

    def _linearise(self, state: JointState, index: IntArray, stage: Stage) -> kalman.LinearisedMeasurements:
        """Innovations (Eq. 14) and H of a stage at `state`, by the chain rule through Eq. 8-10."""
        R_cw = state.camera.R_wc.T
        seen = self._landmark.relative_to(state.camera.position, state.anchors(index), state.parameters(index))
        h_c, scale = seen.homogeneous[:, :3] @ R_cw.T, seen.homogeneous[:, 3]
        z_by_camera = stage.T @ self.camera.project_scaled_jacobian(h_c, scale)
        z_by_world = np.concatenate([z_by_camera[:, :, :3] @ R_cw, z_by_camera[:, :, 3:]], axis=2)
        by_position = z_by_world @ seen.by_position
        by_rotation = z_by_camera[:, :, :3] @ rotations.skew(h_c)
        by_map = z_by_world @ seen.by_parameters
        if seen.by_anchor is not None:
            by_map = np.concatenate([z_by_world @ seen.by_anchor, by_map], axis=2)
        return kalman.LinearisedMeasurements(
            stage.z - self.camera.project_scaled(h_c, scale) @ stage.T.T,
            np.concatenate([by_position, by_rotation], axis=2),
            by_map,
            state.map_rows(index),
            stage.R,
        )

    def _correct(self, observation: StereoObservation, index: IntArray) -> UpdateReport:
        """Stage by stage: leave out what is behind the camera or not believable, correct with the rest.

        A landmark refused in one stage takes no part in the later ones. Each of n stages has the gate
        probability^(1/n), so that a consistent landmark passes all of them with the probability asked for.
        """
        if len(index) == 0:
            return UpdateReport()
        R = self._noise_of(len(observation), observation.R)
        stages = self._measurement.stages(observation, R)
        used = np.ones(len(index), dtype=bool)
        behind, gated, failed = np.zeros_like(used), np.zeros_like(used), np.zeros_like(used)
        nis, dof = 0.0, 0
        for stage in stages:
            _, in_front = self._project(self._state, index)
            behind |= used & ~in_front
            used &= in_front
            measurements = self._linearise(self._state, index[used], _select(stage, used))
            if self._gate is not None:
                limit = gating.gate_limit(self._gate ** (1 / len(stages)), measurements.innovation.shape[1])
                S = measurements.innovation_covariances(self._state.P)
                believable = gating.passes(measurements.innovation, S, limit)
                gated[used] = ~believable
                used[used] = believable
                measurements = measurements[believable]
            correction = self._apply(measurements, _select(stage, used), index[used])
            failed[used] = ~correction.used
            used[used] = correction.used
            nis, dof = nis + correction.nis, dof + correction.dof
        return UpdateReport(
            updated=observation.ids[used],
            gated=observation.ids[gated],
            behind_camera=observation.ids[behind],
            failed=observation.ids[failed],
            nis=nis,
            nis_dof=dof,
        )

    def _apply(self, measurements: kalman.LinearisedMeasurements, stage: Stage, index: IntArray) -> kalman.Correction:
        """One stage of the update: one pass, or Gauss-Newton passes with the prior held."""
        prior = self._state
        for _ in range(self._iterations - 1):
            delta = kalman.update(prior.P.copy(order="F"), measurements).delta
            moved = replace(prior)
            self._retract(moved, delta, covariance=False)
            measurements = self._linearise(moved, index, stage)
            measurements.by_camera[:, :, ROTATION] = measurements.by_camera[:, :, ROTATION] @ self._error.transport(
                delta[ROTATION]
            )
            measurements.innovation[:] += measurements.times(delta)
        correction = kalman.update(prior.P, measurements)
        self._retract(prior, correction.delta)
        return correction

    def _retract(self, state: JointState, delta: FloatArray, *, covariance: bool = True) -> None:
        """Move the state by the correction (Eq. 17) and carry P along to the new orientation."""
        camera = state.camera
        state.camera = CameraState(
            camera.position + delta[POSITION],
            self._error.retract(camera.orientation, delta[ROTATION]),
            camera.linear_velocity + delta[LINEAR],
            camera.angular_velocity + delta[ANGULAR],
        )
        state.blocks = state.blocks + delta[CAMERA_SIZE:].reshape(-1, 3)
        if covariance:
            identity = np.eye(3)
            state.transform_camera(block_diag(identity, self._error.transport(delta[ROTATION]), identity, identity))

    def _initialise(self, observation: StereoObservation) -> tuple[IntArray, IntArray]:
        """Add new landmarks from the updated pose (Eq. 19-25); returns the ids added and those refused."""
        camera = self._state.camera
        possible = self._landmark.can_initialise(self.camera, camera.R_wc, observation.uvd)
        if self._min_disparity is not None:
            possible &= observation.uvd[:, 2] >= self._min_disparity
        accepted = observation.select(possible)
        if len(accepted):
            new = self._landmark.initialise(self.camera, camera.position, camera.R_wc, accepted.uvd)
            R = self._noise_of(len(accepted), accepted.R)
            self._state.augment(accepted.ids, new, R)
        return accepted.ids, observation.ids[~possible]


def _select(stage: Stage, mask: BoolArray) -> Stage:
    return Stage(stage.z[mask], stage.T, stage.R[mask])


def _choice(name: str, value: str, available: Mapping[str, T]) -> T:
    if isinstance(value, str) and value in available:
        return available[value]
    close = get_close_matches(str(value), available, 1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    raise ValueError(f"{name} must be one of {', '.join(map(repr, available))}, got {value!r}{hint}")
