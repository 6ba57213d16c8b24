"""`StereoEKF`: landmark parametrisation x measurement model x error definition x motion model, as one filter.

The named filters are choices of these parts; this module only says in which order they work.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from filters.camera import StereoCamera
from filters.engine import gating, kalman
from filters.engine.consensus import largest_agreement
from filters.engine.gating import BEHIND, FAILED, GATED, USED, FateArray
from filters.engine.heavy_tails import reweighted
from filters.engine.map_policy import MapPolicy
from filters.engine.marginals import joint_covariance, pose_landmark_covariances
from filters.engine.options import Options
from filters.errors.model import ErrorDefinition
from filters.interface import (
    AT_ORIGIN,
    BodyVelocity,
    Forecast,
    LandmarkBelief,
    PoseBelief,
    StereoFilter,
    StereoObservation,
    UpdateReport,
    VelocityBelief,
    check_rig,
    check_start,
)
from filters.known_names import require_known
from filters.landmarks.model import LandmarkModel
from filters.machine_code import compiled_filter
from filters.measurements.model import MeasurementModel, Stage
from filters.motions.model import CameraState, MotionModel, MotionPrediction, measure_odometry, predict_camera
from filters.noise import StereoNoise
from filters.parts import Named
from filters.start import Start
from filters.state import symmetric
from filters.state.joint_state import JointState, world_rotation_of_variables
from filters.state.linearised import LinearisedMeasurements, of_variables
from filters.updates.extended import Extended
from filters.updates.model import Linearisation, points_in_camera
from filters.validation import (
    BoolArray,
    FloatArray,
    IntArray,
    finite_array,
    positive,
    unique_ids,
    unit_quaternion,
)
from filters.variables import POSE, VELOCITY, VariableBelief

if TYPE_CHECKING:
    from filters.compiled.stereo_ekf import CompiledFilter


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
            iterations=iterations,
            drop_unseen=drop_unseen,
            min_disparity=min_disparity,
            max_landmarks=max_landmarks,
            compiled=compiled,
        )
        self._policy = MapPolicy(camera, noise, self.options)
        self._compiled = compiled_filter(camera, self.options)
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
        motion = self.options.motion
        if self._compiled is not None:
            motion.check_odometry(odometry)
            self._compiled.predict(dt, odometry)
            return
        predicted = predict_camera(motion, self._state.camera, dt, odometry)
        measured = None if odometry is None else measure_odometry(motion, predicted.state, dt, odometry)
        # The model has said all it has to say, in the right shapes: only now does the state change.
        self._move_covariance(predicted, dt)
        self._state.camera = self._state.predicted = predicted.state
        if measured is not None:
            layout = self.options.layout
            linear = of_variables(measured, layout.rows_of(motion.moves), layout.size)
            self._retract(kalman.update(self._state.P, linear, layout.considered).delta)

    def update(self, observation: StereoObservation) -> UpdateReport:
        """Known ids correct the state, unseen ones leave, new ones enter; see `StereoFilter.update`."""
        if not isinstance(observation, StereoObservation):
            raise ValueError(f"observation must be a StereoObservation, got {type(observation).__name__}")
        # One order for everything below, so that the result cannot depend on the order of the measurements.
        observation = observation.ordered()
        if self._compiled is not None:
            return self._compiled.update(observation, self.noise)
        known, index = _locate(self._state.ids, observation.ids)
        all_known = len(index) == len(observation)
        measured = observation if all_known else observation.select(known)
        report = self._correct(measured, index)
        if all_known and self.options.is_steady and (len(index) == len(self._state) or not self.options.drop_unseen):
            return report
        change = self._policy.renew(self._state, measured, index, observation.select(~known))
        return replace(report, **vars(change))

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
        return len(self.state.rows_in_use)

    @property
    def state(self) -> JointState:
        """The joint state, for filters built on this one; a copy, to be assigned after a change."""
        return self._state if self._compiled is None else self._compiled.state

    @state.setter
    def state(self, state: JointState) -> None:
        if self._compiled is None:
            self._state = state
        else:
            self._compiled.state = state

    @property
    def compiled(self) -> CompiledFilter | None:
        """The filter in machine code; None: it runs by NumPy."""
        return self._compiled

    def share(self, compiled: CompiledFilter) -> None:
        """Keep what the filter knows from now on in a storage with others; its map is empty until it is reset."""
        self._compiled = compiled
        self.reset()

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map, (N,), in no order; cheaper to ask than `landmarks`."""
        return self._state.ids if self._compiled is None else self._compiled.ids

    def with_state(self, state: JointState) -> StereoEKF:
        """The same filter with another state: what it says of landmarks that are kept elsewhere."""
        other = copy(self)
        other._compiled, other._state = None, state
        return other

    @property
    def pose(self) -> PoseBelief:
        """Pose of the left camera."""
        camera = self._camera
        return PoseBelief(camera.position.copy(), camera.orientation.copy(), self._covariance_of(POSE))

    @property
    def velocity(self) -> VelocityBelief:
        """Velocity of the left camera."""
        camera = self._camera
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
        self._compiled, self._state = None, state  # the kernels know no clones

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
        camera = self._camera
        return self.options.error.pose_error(camera, self.pose.covariance, true_position, true_orientation)

    def _wanted(self, ids: Sequence[int] | IntArray | None) -> tuple[IntArray, IntArray]:
        """The landmarks asked for (None: all, ascending), and where they are; refuses those that are not there."""
        there = self.ids
        wanted = np.sort(there) if ids is None else unique_ids("ids", np.asarray(ids))
        known, index = _locate(there, wanted)
        if not known.all():
            raise ValueError(f"ids must be in the map, not there: {wanted[~known][:5].tolist()}: see landmarks.ids")
        return wanted, index

    @property
    def _camera(self) -> CameraState:
        """Values of the named variables."""
        return self._state.camera if self._compiled is None else self._compiled.camera

    def _covariance_of(self, name: str) -> FloatArray:
        place = self.options.layout.places[name]
        if self._compiled is not None:
            return self._compiled.covariance(place)
        return symmetric.full(self._state.P[place, place])

    def _move_covariance(self, predicted: MotionPrediction, dt: float) -> None:
        """P of the predicted variables (Eq. 12)."""
        state, layout, error = self._state, self.options.layout, self.options.error
        rows = np.ix_(*[layout.rows_of(self.options.motion.moves)] * 2)
        F, added = np.eye(layout.size), np.zeros((layout.size, layout.size))
        F[rows], added[rows] = predicted.F, predicted.G @ predicted.Q @ predicted.G.T
        if layout.walk_rates is not None:
            added[layout.rows, layout.rows] += layout.walk_rates * dt
        if error.constrains:
            F = error.constrained(F, world_rotation_of_variables(layout, predicted.state), state)
        symmetric.transform_leading(state.P, F, added)

    def _linearise(self, state: JointState, index: IntArray, stage: Stage) -> LinearisedMeasurements:
        options = self.options
        point = options.error.linearisation_point(state)
        return options.update.linearise(options.measurement, self.camera, state, index, stage, point)

    def _correct(self, observation: StereoObservation, index: IntArray) -> UpdateReport:
        """Stage by stage: leave out what is behind the camera or not believable, correct with the rest.

        A landmark refused in one stage takes no part in the later ones. Each of n stages has the gate
        probability^(1/n), so that a consistent landmark passes all of them with the probability asked for.
        """
        if len(index) == 0:
            return UpdateReport()
        stages = self.options.measurement.stages(observation, observation.covariances(self.noise))
        gate = self.options.gate and self.options.gate ** (1 / len(stages))
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
        candidates = fates == USED
        forward = self.options.measurement.in_front(points_in_camera(self._state, index))
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
    ) -> Iterator[tuple[BoolArray, LinearisedMeasurements]]:
        """The measurements (M,) to correct with next, chosen and linearised at the state the previous ones left."""
        if gate is None:
            yield candidates, self._linearise(self._state, index[candidates], _select(stage, candidates))
            return
        limit = gating.gate_limit(gate, stage.z.shape[1])
        believable, measurements = self._believable(stage, index, candidates, limit)
        if not self.options.consensus:
            yield believable, measurements
            return
        core = believable.copy()
        agree = largest_agreement(self._state.P, measurements, limit)
        core[believable] = agree
        yield core, measurements[agree]
        yield self._believable(stage, index, candidates & ~core, limit)

    def _believable(
        self, stage: Stage, index: IntArray, candidates: BoolArray, limit: float
    ) -> tuple[BoolArray, LinearisedMeasurements]:
        """Which of the candidates (M,) pass the gate at the current state, and those linearised."""
        measurements = self._linearise(self._state, index[candidates], _select(stage, candidates))
        passed = kalman.squared_distances(self._state.P, measurements) <= limit
        if passed.all():
            return candidates, measurements
        believable = candidates.copy()
        believable[candidates] = passed
        return believable, measurements[passed]

    def _apply(self, measurements: LinearisedMeasurements, stage: Stage, index: IntArray) -> kalman.Correction:
        """One pass of the update, or Gauss-Newton passes with the prior held."""
        if self.options.tail_dof is not None:
            measurements = reweighted(self._state.P, measurements, self.options.tail_dof)
            stage = replace(stage, R=measurements.R)
        prior, considered = self._state, self.options.layout.considered
        for _ in range(self.options.iterations - 1):
            delta = kalman.update(prior.P.copy(order="F"), measurements, considered).delta
            moved = self.options.error.moved(prior, delta)
            there = self._linearise(moved, index, stage)
            measurements = self.options.error.transport(prior, moved, delta).pulled_back(there, delta)
        correction = kalman.update(prior.P, measurements, considered)
        self._retract(correction.delta)
        return correction

    def _retract(self, delta: FloatArray) -> None:
        """Move the state by the correction (Eq. 17) and carry P along."""
        moved = self.options.error.moved(self._state, delta)
        self.options.error.transport(self._state, moved, delta).apply(moved.P)
        self._state = moved


def _select(stage: Stage, mask: BoolArray) -> Stage:
    return stage if mask.all() else Stage(stage.z[mask], stage.T, stage.R[mask])


def _locate(there: IntArray, ids: IntArray) -> tuple[BoolArray, IntArray]:
    """Which of `ids` are among those that are `there`, and where those are."""
    if len(there) == 0:
        return np.zeros(len(ids), dtype=bool), np.zeros(0, dtype=np.int64)
    if len(ids) == len(there) and (ids == there).all():
        return np.ones(len(ids), dtype=bool), np.arange(len(ids))
    order = np.argsort(there)
    candidate = order.take(np.searchsorted(there, ids, sorter=order), mode="clip")
    known = there[candidate] == ids
    return known, candidate[known]
