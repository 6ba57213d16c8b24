"""`StereoEKFTrials`: the filter `StereoEKF`, B times in lock-step.

The same steps in the same order with the same models as `filters.engine.ekf`, on arrays that hold all trials: a
trial's belief is what `StereoEKF` would have on its own, to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import signature
from typing import Any

import numpy as np

from filters import rotations
from filters.engine import gating, unscented
from filters.engine.ekf import StereoEKF
from filters.engine.error_definition import StandardError, moved_camera
from filters.engine.fates import BEHIND, FAILED, GATED, USED
from filters.engine.kalman import LinearisedMeasurements
from filters.engine.linearisation import measurement_jacobians
from filters.engine.options import Parts
from filters.interface import BodyVelocity, PoseBelief, StereoObservation, VelocityBelief
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.shared_anchor import SharedAnchorInverseDepth
from filters.measurements.model import Stage
from filters.motion import CAMERA_SIZE, POSE_SIZE, ROTATION, CameraState, ConstantVelocity
from filters.start import start_belief
from filters.trials import lockstep
from filters.trials.joint_states import JointStates
from filters.trials.observations import INITIALISED, REJECTED, Sightings, TrialReports
from filters.validation import BoolArray, FloatArray, IntArray, positive

_RESET_ARGUMENTS = tuple(signature(start_belief).parameters)


class StereoEKFTrials:
    """Many independent trials of one `StereoEKF`, several times faster than one after the other for small maps.

    Trial b gives what `one` would give on the same input. Beliefs are those of `StereoFilter` with a leading
    dimension of B trials; `trial(b)` is one of them as an ordinary filter, with its map.

    Parameters
    ----------
    one : StereoEKF
        The filter: `StereoEKF(camera, noise, **options)`, or a named one of `make_filter`.
    trials : int
        B.

    Raises
    ------
    ValueError
        The filter has an option that works only one by one; the message names it.
    """

    def __init__(self, one: StereoEKF, trials: int) -> None:
        if not isinstance(one, StereoEKF):
            raise ValueError(f"one must be a StereoEKF, got {type(one).__name__}: run other filters one by one")
        if type(trials) is not int or trials < 1:
            raise ValueError(f"trials must be an integer >= 1, got {trials!r}")
        _refuse_what_needs_one_by_one(one.parts)
        self.camera, self.noise = one.camera, one.noise
        self._one, self._parts, self._trials = one, one.parts, trials
        self._work = lockstep.Workspace()
        self.reset()

    def __len__(self) -> int:
        return self._trials

    def reset(self, starts: Sequence[Mapping[str, Any]] | None = None) -> None:
        """Start all trials again with empty maps.

        Parameters
        ----------
        starts : B mappings, optional
            Arguments of `StereoFilter.reset` for each trial, by their names; None: its defaults.

        Raises
        ------
        ValueError
            Not one mapping for each trial, an unknown argument, or a value that `StereoFilter.reset` refuses.
        """
        starts = [{}] * self._trials if starts is None else starts
        if len(starts) != self._trials:
            raise ValueError(f"starts must be one for each of {self._trials} trials, got {len(starts)}")
        unknown = sorted({name for start in starts for name in start} - set(_RESET_ARGUMENTS))
        if unknown:
            raise ValueError(f"starts must name arguments of reset ({', '.join(_RESET_ARGUMENTS)}), got {unknown[0]!r}")
        beliefs = [start_belief(**start) for start in starts]
        cameras = [camera for camera, _ in beliefs]
        camera = CameraState(
            np.array([camera.position for camera in cameras]),
            np.array([camera.orientation for camera in cameras]),
            np.array([camera.linear_velocity for camera in cameras]),
            np.array([camera.angular_velocity for camera in cameras]),
        )
        self._states = JointStates.without_maps(camera, np.array([P for _, P in beliefs]), self._parts.landmark)

    def predict(self, dt: float, odometry: Sequence[BodyVelocity | None] | None = None) -> None:
        """Move the beliefs forward by `dt` seconds (Eq. 6, 11, 12); odometry, if any, is one for each trial, or None.

        Raises
        ------
        ValueError
            dt is not > 0, or odometry is not one BodyVelocity or None for each trial.
        """
        dt = positive("dt", dt)
        measured = self._stacked(odometry)
        states, motion = self._states, self._parts.motion
        predicted = motion.predict(states.camera, dt, None)
        states.transform_camera(predicted.F, predicted.G @ predicted.Q @ predicted.G.swapaxes(1, 2))
        states.camera = predicted.state
        if measured is not None:
            seen = motion.odometry_measurement(_chosen(predicted.state, measured.trial), dt, measured)  # type: ignore[arg-type]
            assert seen is not None
            nothing, no_rows = np.zeros((*seen.innovation.shape, 0)), np.zeros((len(seen.H), 0), dtype=np.int64)
            of_camera = LinearisedMeasurements(seen.innovation, seen.H, nothing, no_rows, seen.R)
            self._retract(lockstep.update(states.P, CAMERA_SIZE, measured.trial, of_camera, None, self._work).delta)

    def update(self, observations: Sequence[StereoObservation]) -> TrialReports:
        """Use a frame of every trial: known ids correct the state, unseen ones leave, new ones enter.

        Parameters
        ----------
        observations : sequence of StereoObservation
            One for each trial; it may be empty.

        Returns
        -------
        TrialReports
            Trial b's `UpdateReport` is `reports[b]`.

        Raises
        ------
        ValueError
            Not one StereoObservation for each trial, or v_right measured in some trials and not in others.
        """
        if len(observations) != self._trials:
            raise ValueError(f"observations must be one for each of {self._trials} trials, got {len(observations)}")
        sightings = Sightings.of(observations, self.noise)
        states = self._states
        known, place = states.locate(sightings.trial, sightings.ids)
        seen, place = sightings[known], place[known]
        outcome = np.full(len(sightings), REJECTED)
        outcome[known], nis, dof = self._correct(seen, place)
        reports = TrialReports(sightings.trial, sightings.ids, outcome, nis, dof)
        if self._parts.drop_unseen:
            gone = states.taken.copy()
            gone[seen.trial, place] = False
            reports = replace(reports, dropped_trial=np.nonzero(gone)[0], dropped_ids=states.ids[gone])
            states.remove(gone)
        if not known.all():
            outcome[~known] = np.where(self._initialise(sightings[~known]), INITIALISED, REJECTED)
        return reports

    @property
    def pose(self) -> PoseBelief:
        """Poses of the left cameras: (B, 3), (B, 4), (B, 6, 6)."""
        states = self._states
        P = states.P[:, :POSE_SIZE, :POSE_SIZE].copy()
        return PoseBelief(states.camera.position.copy(), states.camera.orientation.copy(), P)

    @property
    def velocity(self) -> VelocityBelief:
        """Velocities of the left cameras: (B, 3), (B, 3), (B, 6, 6)."""
        states = self._states
        P = states.P[:, POSE_SIZE:CAMERA_SIZE, POSE_SIZE:CAMERA_SIZE].copy()
        return VelocityBelief(states.camera.linear_velocity.copy(), states.camera.angular_velocity.copy(), P)

    @property
    def map_sizes(self) -> IntArray:
        """Number of landmarks in the map of each trial, (B,)."""
        sizes: IntArray = self._states.taken.sum(axis=1)
        return sizes

    @property
    def state_sizes(self) -> IntArray:
        """Numbers in the error state of each trial, (B,); see `StereoEKF.state_size`."""
        return self._states.sizes

    def pose_error(self, position: FloatArray, orientation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Errors of the poses in the filter's own error definition, as of `StereoFilter.pose_error`.

        Parameters
        ----------
        position, orientation : (B, 3), (B, 4)
            True r^WC, m, and q^WC, unit quaternions xyzw; NaN where unknown.

        Returns
        -------
        error, covariance : (B, 6), (B, 6, 6)
            Position part, then rotation part.
        """
        return self._parts.error.pose_error(self._states.camera, self.pose.covariance, position, orientation)

    def trial(self, number: int) -> StereoEKF:
        """One trial as a filter of its own: pose, map and forecast, and it can go on from here alone."""
        return self._one.with_state(self._states.single(number))

    def _stacked(self, odometry: Sequence[BodyVelocity | None] | None) -> _Odometry | None:
        """The odometry of those trials that have some."""
        if odometry is None:
            return None
        if len(odometry) != self._trials:
            raise ValueError(f"odometry must be one for each of {self._trials} trials, got {len(odometry)}")
        given = [(b, o) for b, o in enumerate(odometry) if o is not None]
        for b, o in given:
            if not isinstance(o, BodyVelocity):
                raise ValueError(f"odometry[{b}] must be a BodyVelocity or None, got {o!r}")
        if not given:
            return None
        return _Odometry(
            np.array([b for b, _ in given]),
            np.array([o.linear for _, o in given]),
            np.array([o.angular for _, o in given]),
            np.array([o.covariance for _, o in given]),
        )

    def _correct(self, seen: Sightings, place: IntArray) -> tuple[IntArray, FloatArray, IntArray]:
        """Stage by stage as in `StereoEKF`; returns the outcome of each measurement (N,), NIS and its dof (B,)."""
        outcome = np.full(len(seen), USED)
        nis, dof = np.zeros(self._trials), np.zeros(self._trials, dtype=np.int64)
        if len(seen) == 0:
            return outcome, nis, dof
        stages = self._parts.measurement.stages(seen.numbered(), seen.R)
        gate = self._parts.gate and self._parts.gate ** (1 / len(stages))
        for stage in stages:
            forward, linear = self._linearise(seen.trial, place, stage)
            outcome[(outcome == USED) & ~forward] = BEHIND
            candidates = np.flatnonzero(outcome == USED)
            limit = gating.gate_limit(gate, stage.z.shape[1]) if gate is not None else None
            part = linear if len(candidates) == len(seen) else linear[candidates]
            correction = lockstep.update(
                self._states.P, self._states.head, seen.trial[candidates], part, limit, self._work
            )
            self._retract(correction.delta)
            outcome[candidates[~correction.passed]] = GATED
            outcome[candidates[correction.passed & ~correction.used]] = FAILED
            nis, dof = nis + correction.nis, dof + correction.dof
        return outcome, nis, dof

    def _linearise(self, trial: IntArray, place: IntArray, stage: Stage) -> tuple[BoolArray, LinearisedMeasurements]:
        """Which rays point forward, and the stage's measurements linearised at the current states (Eq. 14)."""
        states = self._states
        R_wc = states.camera.R_wc[trial]
        anchors, parameters = states.anchors_and_parameters(trial, place)
        seen = states.model.relative_to(states.camera.position[trial], anchors, parameters)
        h_c = rotations.turned(R_wc.swapaxes(1, 2), seen.homogeneous[:, :3])
        by_pose, by_map = measurement_jacobians(self.camera, R_wc, seen, h_c, stage.T)
        predicted = self.camera.project_scaled(h_c, seen.homogeneous[:, 3]) @ stage.T.T
        rows = states.map_rows(trial, place)
        return h_c[:, 2] > 0, LinearisedMeasurements(stage.z - predicted, by_pose, by_map, rows, stage.R)

    def _retract(self, delta: FloatArray) -> None:
        """Move the states by their corrections (Eq. 17) and carry P along."""
        states, retraction = self._states, self._parts.error.retraction
        states.camera = moved_camera(states.camera, delta, retraction)
        states.add(delta)
        carried = np.zeros((self._trials, CAMERA_SIZE, CAMERA_SIZE))
        carried[...] = np.eye(CAMERA_SIZE)
        carried[:, ROTATION, ROTATION] = retraction.transport(delta[:, ROTATION])
        states.transform_camera(carried)

    def _initialise(self, unknown: Sightings) -> BoolArray:
        """Add new landmarks from the updated poses (Eq. 19-25); returns which measurements (N,) gave one."""
        camera, model = self._states.camera, self._parts.landmark
        possible = model.can_initialise(self.camera, camera.R_wc[unknown.trial], unknown.uvd)
        if self._parts.min_disparity is not None:
            possible &= unknown.uvd[:, 2] >= self._parts.min_disparity
        accepted = unknown[possible]
        if len(accepted):
            trial = accepted.trial
            new = model.initialise(self.camera, camera.position[trial], camera.R_wc[trial], accepted.uvd)
            self._states.augment(trial, accepted.ids, new, accepted.R)
        return possible


@dataclass(frozen=True, eq=False)
class _Odometry:
    """Body velocities of some trials (N,): linear (N, 3), angular (N, 3), covariance (N, 6, 6)."""

    trial: IntArray
    linear: FloatArray
    angular: FloatArray
    covariance: FloatArray


def _chosen(camera: CameraState, trial: IntArray) -> CameraState:
    return CameraState(
        camera.position[trial],
        camera.orientation[trial],
        camera.linear_velocity[trial],
        camera.angular_velocity[trial],
    )


def _refuse_what_needs_one_by_one(parts: Parts) -> None:
    """Raise a `ValueError` for the first option that has no vectorised form."""
    supported = {
        'update="extended"': parts.linearise is not unscented.linearise,
        "consensus=False": not parts.consensus,
        "tail_dof=None": parts.tail_dof is None,
        "iterations=1": parts.iterations == 1,
        'error="quaternion" or "so3"': type(parts.error) is StandardError,
        "motion=ConstantVelocity(...)": type(parts.motion) is ConstantVelocity,
        "max_landmarks=None": parts.max_landmarks is None,
        'landmark="inverse-depth", "shared-anchor" or "euclidean"': type(parts.landmark)
        in (InverseDepth, SharedAnchorInverseDepth, Euclidean),
    }
    for wanted, given in supported.items():
        if not given:
            name = wanted.partition("=")[0]
            raise ValueError(
                f"{name} must be {wanted.partition('=')[2]} for trials in lock-step: use StereoEKF one by one"
            )
