"""The EKF by NumPy, for parts of any kind: prediction, gate, update and map management of one filter."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.linalg import blas

from filters.contract.drift import in_own_numbers, step_covariances
from filters.contract.noise import StereoNoise
from filters.contract.observation import StereoObservation
from filters.contract.odometry import BodyVelocity
from filters.contract.update_report import UpdateReport
from filters.engine import gating, kalman
from filters.engine.consensus import largest_agreement
from filters.engine.gating import BEHIND, FAILED, GATED, USED, FateArray
from filters.engine.gauge_walk import directions, image_motion
from filters.engine.heavy_tails import reweighted
from filters.engine.map_policy import MapPolicy
from filters.engine.options import Options
from filters.geometry import rotations
from filters.geometry.camera import StereoCamera
from filters.measurements.model import Stage
from filters.motions.model import CameraState, MotionPrediction, measure_odometry, predict_camera
from filters.state import symmetric
from filters.state.joint_state import JointState, world_rotation_of_variables
from filters.state.linearised import LinearisedMeasurements, of_variables
from filters.updates.extended import Extended
from filters.updates.model import points_in_camera
from filters.validation import BoolArray, FloatArray, IntArray


class NumpyFilter:
    """One filter by NumPy: what `StereoEKF` asks of it, as of `filters.engine.compiled.stereo_ekf.CompiledFilter`.

    Attributes
    ----------
    camera : StereoCamera
        The rig.
    options : Options
        Of the filter.
    state : JointState
        What it knows.
    """

    def __init__(self, camera: StereoCamera, options: Options, state: JointState) -> None:
        self._rig, self.options, self.state = camera, options, state

    def predict(self, dt: float, odometry: BodyVelocity | None) -> None:
        """Move the belief forward by dt (Eq. 6, 11, 12), then fuse what odometry adds."""
        motion = self.options.motion
        predicted = predict_camera(motion, self.state.camera, dt, odometry)
        measured = None if odometry is None else measure_odometry(motion, predicted.state, dt, odometry)
        before = self.state.camera
        # The model has said all it has to say, in the right shapes: only now does the state change.
        self._move_covariance(predicted, dt)
        self.state.camera = self.state.predicted = predicted.state
        if self.options.gauge_walk:
            self._walk_gauge(before)
        if measured is not None:
            layout = self.options.layout
            linear = of_variables(measured, layout.rows_of(motion.moves), layout.size)
            self._retract(kalman.update(self.state.P, linear, layout.considered).delta)

    def update(self, observation: StereoObservation, noise: StereoNoise) -> UpdateReport:
        """Known ids correct the state, unseen ones leave, new ones enter; ids ascending."""
        known, index = locate(self.state.ids, observation.ids)
        all_known = len(index) == len(observation)
        measured = observation if all_known else observation.select(known)
        report = self._correct(measured, noise, index)
        if all_known and self.options.is_steady and (len(index) == len(self.state) or not self.options.drop_unseen):
            return report
        policy = MapPolicy(self._rig, noise, self.options)
        change = policy.renew(self.state, measured, index, observation.select(~known))
        return replace(report, **vars(change))

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map."""
        return self.state.ids

    @property
    def state_size(self) -> int:
        """Rows of the covariance in use."""
        return len(self.state.rows_in_use)

    @property
    def camera(self) -> CameraState:
        """Values of the named variables."""
        return self.state.camera

    def covariance(self, place: slice) -> FloatArray:
        """Covariance of some of the named variables."""
        return symmetric.full(self.state.P[place, place])

    def _move_covariance(self, predicted: MotionPrediction, dt: float) -> None:
        """P of the predicted variables (Eq. 12)."""
        state, layout, error = self.state, self.options.layout, self.options.error
        rows = np.ix_(*[layout.rows_of(self.options.motion.moves)] * 2)
        F, added = np.eye(layout.size), np.zeros((layout.size, layout.size))
        F[rows], added[rows] = predicted.F, predicted.G @ predicted.Q @ predicted.G.T
        if layout.walk_rates is not None:
            added[layout.rows, layout.rows] += layout.walk_rates * dt
        if error.constrains:
            F = error.constrained(F, world_rotation_of_variables(layout, predicted.state), state)
        symmetric.transform_leading(state.P, F, added)

    def _walk_gauge(self, before: CameraState) -> None:
        """Add to P what no measurement can see. Clones of the pose stay where the camera was."""
        at, now = self.options.error.linearisation_point(self.state) or self.state, self.state.camera
        turn = float(np.linalg.norm(rotations.log(before.R_wc.T @ now.R_wc)))
        seen = points_in_camera(self.state, np.arange(len(self.state)))
        motion, distance = image_motion(turn, now.R_wc.T @ (now.position - before.position), seen)
        sigma = self.options.gauge_walk * math.sqrt(motion)
        B = directions(at.world_rotation(), at.world_translation(), at.camera.position, sigma, distance)
        for clone in at.clones.values():
            B[at.block_rows(clone.blocks)] = 0.0
        blas.dsyrk(1.0, B, beta=1.0, c=self.state.P, lower=1, overwrite_c=1)

    def _linearise(self, state: JointState, index: IntArray, stage: Stage) -> LinearisedMeasurements:
        options = self.options
        point = options.error.linearisation_point(state)
        return options.update.linearise(options.measurement, self._rig, state, index, stage, point)

    def _correct(self, observation: StereoObservation, noise: StereoNoise, index: IntArray) -> UpdateReport:
        """Stage by stage: leave out what is behind the camera or not believable, correct with the rest.

        A landmark refused in one stage takes no part in the later ones. Each of n stages has the gate
        probability^(1/n), so that a consistent landmark passes all of them with the probability asked for.
        """
        if len(index) == 0:
            return UpdateReport()
        stages = self.options.measurement.stages(observation, observation.covariances(noise))
        gate = self.options.gate and self.options.gate ** (1 / len(stages))
        fates = np.zeros(len(index), dtype=np.uint8)
        R, nis, dof = observation.covariances(noise), 0.0, 0
        for number, stage in enumerate(stages):
            gained, rows = self._correct_stage(stage, index, gate, fates, None if number else R)
            nis, dof = nis + gained, dof + rows
        if not np.count_nonzero(fates):
            return UpdateReport(updated=observation.ids, nis=nis, nis_dof=dof)
        updated, behind, gated, failed = (observation.ids[fates == fate] for fate in (USED, BEHIND, GATED, FAILED))
        return UpdateReport(updated, gated=gated, behind_camera=behind, failed=failed, nis=nis, nis_dof=dof)

    def _correct_stage(
        self, stage: Stage, index: IntArray, gate: float | None, fates: FateArray, R: FloatArray | None
    ) -> tuple[float, int]:
        """Correct with the measurements whose fate so far is USED, and write their fates; the NIS and its dof.

        R (M, 3, 3) is the noise of (u, v, d) in the first stage, before which landmarks drift, and None later.
        """
        candidates = fates == USED
        forward = self.options.measurement.in_front(points_in_camera(self.state, index))
        fates[candidates & ~forward] = BEHIND
        candidates &= forward
        fates[candidates] = GATED
        steps, rest = None, None
        if R is not None and self.options.drift is not None:
            steps, rest = (step_covariances(part, R) for part in self.options.drift.parts)
            self._drift(index[candidates], steps[candidates])
        nis, dof = 0.0, 0
        for where, measurements in self._passes(stage, index, candidates, gate, steps):
            if rest is not None and rest.any():
                self._drift(index[where], rest[where])
            correction = self._apply(measurements, _select(stage, where), index[where])
            fates[where] = np.where(correction.used, USED, FAILED)
            nis, dof = nis + correction.nis, dof + correction.dof
        return nis, dof

    def _passes(
        self,
        stage: Stage,
        index: IntArray,
        candidates: BoolArray,
        gate: float | None,
        steps: FloatArray | None,
    ) -> Iterator[tuple[BoolArray, LinearisedMeasurements]]:
        """The measurements (M,) to correct with next, chosen and linearised at the state the previous ones left.

        A landmark that agrees with the others may have taken a step, (M, 3, 3).
        """
        if gate is None:
            yield candidates, self._linearise(self.state, index[candidates], _select(stage, candidates))
            return
        limit = gating.gate_limit(gate, stage.z.shape[1])
        believable, measurements = self._believable(stage, index, candidates, limit)
        if not self.options.consensus:
            yield believable, measurements
            return
        core = believable.copy()
        T, noise = stage.T[:, :3], measurements.R
        if steps is not None:
            noise = noise + T @ steps[believable] @ T.T
        agree = largest_agreement(self.state.P, measurements, noise, limit)
        core[believable] = agree
        yield core, measurements[agree]
        yield self._believable(stage, index, candidates & ~core, limit)

    def _believable(
        self, stage: Stage, index: IntArray, candidates: BoolArray, limit: float
    ) -> tuple[BoolArray, LinearisedMeasurements]:
        """Which of the candidates (M,) pass the gate at the current state, and those linearised."""
        measurements = self._linearise(self.state, index[candidates], _select(stage, candidates))
        passed = kalman.squared_distances(self.state.P, measurements) <= limit
        if passed.all():
            return candidates, measurements
        believable = candidates.copy()
        believable[candidates] = passed
        return believable, measurements[passed]

    def _drift(self, index: IntArray, Q: FloatArray) -> None:
        """Add the covariance of a step in the image, Q (M, 3, 3) px^2, to that of landmarks."""
        sensor = self.options.measurement
        numbers = Stage(np.zeros((len(index), 3)), np.eye(3, sensor.size), Q)
        point = self.options.error.linearisation_point(self.state)
        by_map = Extended().linearise(sensor, self._rig, self.state, index, numbers, point).by_map
        rows = self.state.own_rows(index)
        self.state.P[rows[:, :, None], rows[:, None, :]] += in_own_numbers(Q, by_map[:, :, -3:])

    def _apply(self, measurements: LinearisedMeasurements, stage: Stage, index: IntArray) -> kalman.Correction:
        """One pass of the update, or Gauss-Newton passes with the prior held."""
        if self.options.tail_dof is not None:
            measurements = reweighted(self.state.P, measurements, self.options.tail_dof)
            stage = replace(stage, R=measurements.R)
        prior, considered = self.state, self.options.layout.considered
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
        moved = self.options.error.moved(self.state, delta)
        self.options.error.transport(self.state, moved, delta).apply(moved.P)
        self.state = moved


def _select(stage: Stage, mask: BoolArray) -> Stage:
    return stage if mask.all() else Stage(stage.z[mask], stage.T, stage.R[mask])


def locate(there: IntArray, ids: IntArray) -> tuple[BoolArray, IntArray]:
    """Which of `ids` are among those that are `there`, and where those are."""
    if len(there) == 0:
        return np.zeros(len(ids), dtype=bool), np.zeros(0, dtype=np.int64)
    if len(ids) == len(there) and (ids == there).all():
        return np.ones(len(ids), dtype=bool), np.arange(len(ids))
    order = np.argsort(there)
    candidate = order.take(np.searchsorted(there, ids, sorter=order), mode="clip")
    known = there[candidate] == ids
    return known, candidate[known]
