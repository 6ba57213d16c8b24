"""`StereoEKF`: landmark parametrisation x measurement model x error definition x motion model, as one filter.

The named filters are choices of these parts; this module only says in which order they work.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from filters.camera import StereoCamera
from filters.engine import gating, kalman, symmetric
from filters.engine.arithmetic import arithmetic
from filters.engine.consensus import largest_agreement
from filters.engine.error_definition import ERRORS
from filters.engine.fates import BEHIND, FAILED, GATED, USED, FateArray
from filters.engine.heavy_tails import reweighted
from filters.engine.joint_state import JointState, world_rotation_of_camera
from filters.engine.linearisation import in_front, linearise, project
from filters.engine.options import LANDMARKS, LINEARISATIONS, MEASUREMENTS, choice
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
from filters.measurements.model import Stage
from filters.motion import CAMERA_SIZE, CameraState, ConstantVelocity, MotionModel
from filters.noise import StereoNoise
from filters.start import start_belief
from filters.validation import (
    BoolArray,
    FloatArray,
    IntArray,
    finite_array,
    positive,
    unique_ids,
    unit_quaternion,
)


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
    error : {"quaternion", "so3", "first-estimates", "right-invariant"}
        Error definition: the paper's · rotation vector · first-estimates Jacobians · right-invariant.
    update : {"extended", "unscented"}
        Linearisation by Jacobians, or by sigma points on the measured part of the state.
    consensus : bool
        One-point RANSAC over the frame: first correct with the largest set of measurements that agree, then let in
        those that pass the gate at the corrected state.
    tail_dof : float, optional
        Degrees of freedom of Student's t for heavy-tailed noise: surprising measurements count less. None: Gaussian.
    iterations : int
        Passes of the update; 1 is the plain EKF, more relinearise at the result with the prior held (Gauss-Newton).
    drop_unseen : bool
        The paper's policy: a landmark not in the current observation leaves the map.
    min_disparity : float, optional
        A landmark is not started from a smaller disparity, px. None: whatever the parametrisation can do.
    compiled : bool
        Machine code for the hot loops, see `filters.compilation`: same estimates, in a fraction of the time.

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
        update: str = "extended",
        consensus: bool = False,
        tail_dof: float | None = None,
        iterations: int = 1,
        drop_unseen: bool = True,
        min_disparity: float | None = None,
        compiled: bool = False,
    ) -> None:
        if not isinstance(camera, StereoCamera):
            raise ValueError(f"camera must be a StereoCamera, got {camera!r}")
        if not isinstance(noise, StereoNoise):
            raise ValueError(f"noise must be a StereoNoise, got {noise!r}: see StereoNoise.independent_pixels")
        if gate is not None and not (isinstance(gate, float | int) and 0.0 < gate < 1.0):
            raise ValueError(f"gate must be a probability between 0 and 1, or None for no gate, got {gate!r}")
        if type(iterations) is not int or iterations < 1:
            raise ValueError(f"iterations must be an integer >= 1, got {iterations!r}")
        for name, value in (("drop_unseen", drop_unseen), ("consensus", consensus)):
            if not isinstance(value, bool):
                raise ValueError(f"{name} must be True or False, got {value!r}")
        if consensus and gate is None:
            raise ValueError("gate must be a probability with consensus=True, got None: it is the limit of agreement")
        if update == "unscented" and error == "first-estimates":
            raise ValueError('error must not be "first-estimates" with update="unscented", which has no Jacobians')
        if min_disparity is not None and not (isinstance(min_disparity, float | int) and np.isfinite(min_disparity)):
            raise ValueError(f"min_disparity must be a finite number of px, or None, got {min_disparity!r}")
        if motion is not None and not isinstance(motion, MotionModel):
            raise ValueError(f"motion must be a motion model such as ConstantVelocity(3.0, 0.6), got {motion!r}")
        self.camera = camera
        self.noise = noise
        self._motion: MotionModel = ConstantVelocity() if motion is None else motion
        self._gate = gate
        self._landmark = choice("landmark", landmark, LANDMARKS)
        self._measurement = choice("measurement", measurement, MEASUREMENTS)
        self._error = choice("error", error, ERRORS)
        self._arithmetic = arithmetic(compiled)
        self._linearised_by = choice("update", update, LINEARISATIONS) or self._arithmetic.linearise
        self._consensus = consensus
        self._tail_dof = None if tail_dof is None else positive("tail_dof", tail_dof)
        self._iterations = iterations
        # Nothing happens between linearisation, gate and update.
        self._is_plain = (
            update == "extended"
            and error != "first-estimates"
            and iterations == 1
            and not consensus
            and tail_dof is None
        )
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
        camera, P = start_belief(position, orientation, linear_velocity, angular_velocity, covariance)
        self._state = JointState.without_map(camera, P, self._landmark, self._arithmetic.transform_leading)

    def predict(self, dt: float, odometry: BodyVelocity | None = None) -> None:
        """Move the belief forward (Eq. 6, 11, 12), then fuse what odometry adds."""
        dt = positive("dt", dt)
        if odometry is not None and not isinstance(odometry, BodyVelocity):
            raise ValueError(f"odometry must be a BodyVelocity or None, got {odometry!r}")
        at_once = self._arithmetic.predict
        moved = None if at_once is None or self._error.constrains else at_once(self._state, self._motion, dt)
        if moved is None:
            moved = self._predict_step_by_step(dt, odometry)
        self._state.camera = self._state.predicted = moved
        if odometry is not None:
            measured = self._motion.odometry_measurement(moved, dt, odometry)
            if measured is not None:
                correction = self._arithmetic.update(self._state.P, kalman.of_camera(measured))
                self._retract(correction.delta)

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Known ids correct the state, unseen ones leave, new ones enter; see `StereoFilter.update`."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        # One order for everything below, so that the result cannot depend on the order of the measurements.
        observation = observation.ordered()
        known, index = self._locate(observation.ids)
        all_known = len(index) == len(observation)
        report = self._correct(observation if all_known else observation.select(known), index)
        if self._drop_unseen and len(index) < len(self._state):
            gone = np.ones(len(self._state), dtype=bool)
            gone[index] = False
            report = replace(report, dropped=self._state.ids[gone])
            self._state.remove(gone)
        if not all_known:
            initialised, rejected = self._initialise(observation.select(~known))
            report = replace(report, initialised=initialised, rejected=rejected)
        return report

    def forecast(self, ids: Sequence[int] | IntArray | None = None) -> Forecast:
        """Predicted (u, v, d) and S of landmarks at the current pose."""
        state = self._state
        wanted = np.sort(state.ids) if ids is None else unique_ids("ids", np.asarray(ids))
        known, index = self._locate(wanted)
        if not known.all():
            raise ValueError(f"ids must be in the map, not there: {wanted[~known][:5].tolist()}: see landmarks.ids")
        uvd, in_front = project(self.camera, state, index)
        linearised = linearise(self.camera, state, index, Stage(uvd, np.eye(3), self._noise_of(len(index))))
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
        P_map = symmetric.blocks(state.P, state.map_rows(index))
        with np.errstate(invalid="ignore", over="ignore"):
            covariances = points.by_map @ P_map @ points.by_map.transpose(0, 2, 1)
        inverse = self._landmark.inverse_distances(state.camera.position, anchors, parameters)
        own_rows = CAMERA_SIZE + 3 * state.parameter_block[index, None] + np.arange(3)
        position_rows = np.broadcast_to(np.arange(3), own_rows.shape)
        P_own = symmetric.blocks(state.P, np.concatenate([position_rows, own_rows], axis=1))
        J = np.concatenate([inverse.by_position, inverse.by_parameters], axis=1)
        variance = np.einsum("mi,mij,mj->m", J, P_own, J)
        return LandmarkBelief(state.ids[index], points.positions, covariances, inverse.values, variance)

    def pose_error(self, position: ArrayLike, orientation: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Error of the pose in this filter's error definition; see `StereoFilter.pose_error`."""
        true_position = finite_array("position", position, (3,))
        true_orientation = unit_quaternion("orientation", orientation)
        camera = self._state.camera
        return self._error.pose_error(camera, self.pose.covariance, true_position, true_orientation)

    def _locate(self, ids: IntArray) -> tuple[BoolArray, IntArray]:
        """Which of `ids` are in the map, and where those are."""
        if len(self._state) == 0:
            return np.zeros(len(ids), dtype=bool), np.zeros(0, dtype=np.int64)
        there = self._state.ids
        if len(ids) == len(there) and (ids == there).all():
            return np.ones(len(ids), dtype=bool), np.arange(len(ids))
        order = np.argsort(there)
        candidate = order.take(np.searchsorted(there, ids, sorter=order), mode="clip")
        known = there[candidate] == ids
        return known, candidate[known]

    def _noise_of(self, count: int, R: FloatArray | None = None) -> FloatArray:
        return self.noise.R[None].repeat(count, axis=0) if R is None else R

    def _predict_step_by_step(self, dt: float, odometry: BodyVelocity | None) -> CameraState:
        """Move P, and return the camera it leads to."""
        predicted = self._motion.predict(self._state.camera, dt, odometry)
        F = predicted.F
        if self._error.constrains:
            F = self._constrained(F, world_rotation_of_camera(predicted.state))
        self._state.transform_camera(F, predicted.G @ predicted.Q @ predicted.G.T)
        return predicted.state

    def _linearise(self, state: JointState, index: IntArray, stage: Stage) -> kalman.LinearisedMeasurements:
        return self._linearised_by(self.camera, state, index, stage, self._error.linearisation_point(state))

    def _correct(self, observation: StereoObservation, index: IntArray) -> UpdateReport:
        """Stage by stage: leave out what is behind the camera or not believable, correct with the rest.

        A landmark refused in one stage takes no part in the later ones. Each of n stages has the gate
        probability^(1/n), so that a consistent landmark passes all of them with the probability asked for.
        """
        if len(index) == 0:
            return UpdateReport()
        stages = self._measurement.stages(observation, self._noise_of(len(observation), observation.R))
        gate = self._gate and self._gate ** (1 / len(stages))
        fates = np.zeros(len(index), dtype=np.uint8)
        nis, dof = 0.0, 0
        for stage in stages:
            gained, rows = self._correct_stage(stage, index, gate, fates)
            nis, dof = nis + gained, dof + rows
        if not np.count_nonzero(fates):
            return UpdateReport(updated=observation.ids, nis=nis, nis_dof=dof)
        updated, behind, gated, failed = (observation.ids[fates == fate] for fate in (USED, BEHIND, GATED, FAILED))
        return UpdateReport(updated, gated=gated, behind_camera=behind, failed=failed, nis=nis, nis_dof=dof)

    def _correct_stage(self, stage: Stage, index: IntArray, gate: float | None, fates: FateArray) -> tuple[float, int]:
        """Correct with the measurements whose fate so far is USED, and write their fates; the NIS and its dof."""
        at_once = self._arithmetic.correct_stage
        if at_once is not None and self._is_plain:
            limit = np.inf if gate is None else gating.gate_limit(gate, stage.z.shape[1])
            corrected = at_once(self.camera, self._state, index, stage, limit, fates)
            if corrected is not None:
                delta, nis, dof = corrected
                self._retract(delta)
                return nis, dof
        candidates = fates == USED
        forward = in_front(self._state, index)
        fates[candidates & ~forward] = BEHIND
        candidates &= forward
        fates[candidates] = GATED
        nis, dof = 0.0, 0
        for where, measurements in self._passes(stage, index, candidates, gate):
            correction = self._apply(measurements, _select(stage, where), index[where])
            fates[where] = np.where(correction.used, USED, FAILED)
            nis, dof = nis + correction.nis, dof + correction.dof
        return nis, dof

    def _passes(
        self, stage: Stage, index: IntArray, candidates: BoolArray, gate: float | None
    ) -> Iterator[tuple[BoolArray, kalman.LinearisedMeasurements]]:
        """The measurements (M,) to correct with next, chosen and linearised at the state the previous ones left."""
        if gate is None:
            yield candidates, self._linearise(self._state, index[candidates], _select(stage, candidates))
            return
        limit = gating.gate_limit(gate, stage.z.shape[1])
        believable, measurements = self._believable(stage, index, candidates, limit)
        if not self._consensus:
            yield believable, measurements
            return
        core = believable.copy()
        agree = largest_agreement(self._state.P, measurements, limit)
        core[believable] = agree
        yield core, measurements[agree]
        yield self._believable(stage, index, candidates & ~core, limit)

    def _believable(
        self, stage: Stage, index: IntArray, candidates: BoolArray, limit: float
    ) -> tuple[BoolArray, kalman.LinearisedMeasurements]:
        """Which of the candidates (M,) pass the gate at the current state, and those linearised."""
        measurements = self._linearise(self._state, index[candidates], _select(stage, candidates))
        passed = self._arithmetic.squared_distances(self._state.P, measurements) <= limit
        if passed.all():
            return candidates, measurements
        believable = candidates.copy()
        believable[candidates] = passed
        return believable, measurements[passed]

    def _apply(self, measurements: kalman.LinearisedMeasurements, stage: Stage, index: IntArray) -> kalman.Correction:
        """One pass of the update, or Gauss-Newton passes with the prior held."""
        if self._tail_dof is not None:
            measurements = reweighted(self._state.P, measurements, self._tail_dof)
            stage = replace(stage, R=measurements.R)
        prior = self._state
        for _ in range(self._iterations - 1):
            delta = self._arithmetic.update(prior.P.copy(order="F"), measurements).delta
            moved = self._error.moved(prior, delta)
            measurements = self._linearise(moved, index, stage).by_earlier_errors(
                self._error.transport(prior, moved, delta), delta
            )
        correction = self._arithmetic.update(prior.P, measurements)
        self._retract(correction.delta)
        return correction

    def _retract(self, delta: FloatArray) -> None:
        """Move the state by the correction (Eq. 17) and carry P along."""
        at_once = self._arithmetic.retract
        if at_once is not None and at_once(self._state, self._error, delta):
            return
        moved = self._error.moved(self._state, delta)
        moved.shear_by_rotation(self._error.transport(self._state, moved, delta))
        self._state = moved

    def _initialise(self, observation: StereoObservation) -> tuple[IntArray, IntArray]:
        """Add new landmarks from the updated pose (Eq. 19-25); returns the ids added and those refused."""
        camera = self._state.camera
        possible = self._landmark.can_initialise(self.camera, camera.R_wc, observation.uvd)
        if self._min_disparity is not None:
            possible &= observation.uvd[:, 2] >= self._min_disparity
        accepted = observation if possible.all() else observation.select(possible)
        if len(accepted):
            at_once = self._arithmetic.initialise
            new = at_once and at_once(self._landmark, self.camera, camera, accepted.uvd)
            new = new or self._landmark.initialise(self.camera, camera.position, camera.R_wc, accepted.uvd)
            R = self._noise_of(len(accepted), accepted.R)
            self._state.augment(accepted.ids, new, R, self._constrained if self._error.constrains else None)
        return accepted.ids, observation.ids[~possible]

    def _constrained(self, J: FloatArray, image: FloatArray) -> FloatArray:
        """J (m, k) by the first k numbers of the predicted camera, as the error definition wants it."""
        source = world_rotation_of_camera(self._state.predicted)[: J.shape[1]]
        return self._error.constrained(J, image, source, self._state.predicted.R_wc)


def _select(stage: Stage, mask: BoolArray) -> Stage:
    return stage if mask.all() else Stage(stage.z[mask], stage.T, stage.R[mask])
