"""Filters of the camera alone, without a map: their base, dead reckoning, and stereo odometry by PnP with RANSAC."""

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
    RangeBearing,
    Start,
    StereoCamera,
    StereoFilter,
    StereoNoise,
    StereoObservation,
    UpdateReport,
    VelocityBelief,
    VelocityDriven,
)
from filters.checks.consistency import chi_square_quantile
from filters.contract.stereo_filter import AT_ORIGIN, check_rig, check_start, check_step
from filters.contract.validation import finite_array, gate_probability, positive, unique_ids, unit_quaternion
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import ANGULAR, LINEAR, POSE_SIZE, POSITION, ROTATION
from filters.parts import Named, make_part
from stereo_slam_env.frontend.ego_motion import (
    Pairs,
    StepEstimate,
    left_pixel_step,
    most_likely_step,
    perspective_n_point,
    squared_distances,
)

_DRIVEN = VelocityDriven()


@dataclass(frozen=True, eq=False)
class CameraBelief:
    """A camera state and the covariance (12, 12) of its error, in the order of `filters.motions.motion_model`."""

    state: CameraState
    P: FloatArray

    def predicted(self, dt: float, odometry: BodyVelocity | None, motion: MotionModel) -> CameraBelief:
        """After `dt` seconds: driven by the odometry where there is one, by `motion` where not."""
        from filters.engine.own_state import predict_camera

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
        """Forecast without landmarks: there is no map."""
        wanted_ids = unique_ids("ids", np.asarray([] if ids is None else ids))
        if len(wanted_ids):
            raise ValueError(f"ids must be in the map, and this filter has none, got {wanted_ids[:5].tolist()}")
        return Forecast(wanted_ids, np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=bool))

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Ignore the call: there is no map."""
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
        """Belief of a map that is always empty."""
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


REFINEMENTS = ("stereo", "opencv")


@dataclass(frozen=True, eq=False)
class _Reference:
    """The frame to compare the next one with."""

    belief: CameraBelief  # of the camera then
    observation: StereoObservation  # its measurements, ascending ids
    R: FloatArray  # (M, 3, 3): their covariance, px^2
    # (M, 12, 3): covariance of the camera's error with the error of each measurement: they made the step before
    cross: FloatArray


class FrameToFrame(CameraFilter):
    """Stereo odometry: PnP with RANSAC from one frame to the next, no map.

    Points triangulated in the previous frame, their pixels in this one, `cv2.solvePnPRansac`, a refinement on the
    inliers; steps are chained. The covariance of a step comes from the noise of both frames, and the chain knows that
    consecutive steps share a frame, whose errors partly cancel. Where too few landmarks are in both frames, the
    predicted pose stays (counted in `fallbacks`).

    Parameters
    ----------
    camera, noise, motion
        See `CameraFilter`.
    gate : float or None
        Probability with which a consistent landmark is used for the refinement "stereo"; None: all are.
    refinement : {"stereo", "opencv"}
        The most likely step given (u, v, d) and R of both frames, or `cv2.solvePnPRefineLM`, which counts left pixels
        of this frame only, all alike.
    min_points : int
        Landmarks that must be in both frames, at least 6.
    min_disparity : float
        Landmarks nearer to infinity than this, px, take no part in PnP, which needs points; "stereo" uses them.

    Raises
    ------
    ValueError
        An option has an impossible value.
    """

    open_options = frozenset({"motion", "gate"})

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        *,
        motion: Named | MotionModel | None = None,
        gate: float | None = 0.99,
        refinement: str = "stereo",
        min_points: int = 6,
        min_disparity: float = 1.0,
    ) -> None:
        if refinement not in REFINEMENTS:
            raise ValueError(f"refinement must be one of {', '.join(REFINEMENTS)}, got {refinement!r}")
        if type(min_points) is not int or min_points < 6:
            raise ValueError(f"min_points must be an integer >= 6, got {min_points!r}")
        self._gate = gate_probability(gate)
        self._refinement = refinement
        self._min_points = min_points
        self._min_disparity = positive("min_disparity", min_disparity)
        super().__init__(camera, noise, motion=motion)

    @property
    def fallbacks(self) -> int:
        """Frames since `reset` whose step could not be measured, so that the prediction stayed."""
        return self._fallbacks

    def _restart(self) -> None:
        self._reference: _Reference | None = None
        self._elapsed = 0.0
        self._fallbacks = 0

    def predict(self, dt: float, odometry: BodyVelocity | None = None, inertial: InertialSamples | None = None) -> None:
        """Move the belief forward, in case that the step cannot be measured."""
        super().predict(dt, odometry, inertial)
        self._elapsed += float(dt)

    def forget(self, ids: Sequence[int] | IntArray) -> None:
        """Leave the measurements of these landmarks in the previous frame out of the next step."""
        forgotten_ids = unique_ids("ids", np.asarray(ids))
        if self._reference is not None:
            remaining = ~np.isin(self._reference.observation.ids, forgotten_ids)
            before = self._reference
            observation, R, cross = before.observation.select(remaining), before.R[remaining], before.cross[remaining]
            self._reference = _Reference(before.belief, observation, R, cross)

    def _use(self, observation: StereoObservation) -> UpdateReport:
        """Measure the step from the reference frame; the frame becomes the next reference if it can be one."""
        observation = RangeBearing().completed(observation, self.camera)
        R = observation.covariances(self.noise)
        cross = np.zeros((len(observation), 12, 3))
        matched_ids = used = np.zeros(0, dtype=np.int64)
        nis, nis_dof, gated = 0.0, 0, matched_ids
        measured = False
        if self._reference is not None and self._elapsed > 0.0:
            reference = self._reference
            _, i, matched_ids = np.intersect1d(
                reference.observation.ids, observation.ids, assume_unique=True, return_indices=True
            )
            pairs = Pairs(reference.observation.uvd[i], observation.uvd[matched_ids], reference.R[i], R[matched_ids])
            motion = self._measure(pairs)
            if motion is None:
                self._fallbacks += 1
            else:
                estimate, inliers = motion
                used, gated = matched_ids[inliers], np.delete(matched_ids, inliers)
                self._belief, by_step = _chained(reference, i[inliers], estimate, self._elapsed)
                cross[used] = -by_step @ estimate.gain @ R[used]
                nis, nis_dof, measured = estimate.nis, estimate.nis_dof, True
        ids = observation.ids
        new = np.delete(ids, matched_ids)
        takes_over = len(observation) >= self._min_points
        if takes_over:
            self._reference = _Reference(self._belief, observation, R, cross)
            self._elapsed = 0.0
        return UpdateReport(
            updated=ids[used],
            gated=ids[gated],
            failed=ids[:0] if measured else ids[matched_ids],
            initialised=new if takes_over else ids[:0],
            rejected=ids[:0] if takes_over else new,
            nis=nis,
            nis_dof=nis_dof,
        )

    def _measure(self, pairs: Pairs) -> tuple[StepEstimate, IntArray] | None:
        """The step and the pairs it rests on; None where it cannot be told."""
        usable = np.flatnonzero(pairs.first[:, 2] >= self._min_disparity)
        if len(usable) < self._min_points:
            return None
        solution = perspective_n_point(
            self.camera, pairs.select(usable), self._min_points, polished=self._refinement == "opencv"
        )
        if solution is None:
            return None
        step, inliers = solution[0], usable[solution[1]]
        if self._refinement == "opencv":
            estimate = left_pixel_step(self.camera, pairs.select(inliers), step)
        else:
            estimate = most_likely_step(self.camera, pairs.select(inliers), step)
            if estimate is not None:
                # PnP has judged by left pixels and noisy points; the refined step judges all pairs by all it knows.
                limit = np.inf if self._gate is None else chi_square_quantile(self._gate, 3)
                distances = squared_distances(self.camera, pairs, estimate.step)
                inliers = np.flatnonzero((distances <= limit) & np.isfinite(distances))
                if len(inliers) < self._min_points:
                    return None
                estimate = most_likely_step(self.camera, pairs.select(inliers), estimate.step)
        return None if estimate is None else (estimate, inliers)


def _chained(
    reference: _Reference, used: IntArray, estimate: StepEstimate, elapsed: float
) -> tuple[CameraBelief, FloatArray]:
    """The camera after the step, and the derivative (12, 6) of its error by that of the step.

    e = by_pose e_reference + by_step e_step, where e_step holds the errors of the reference's measurements, which are
    correlated with e_reference (they made the step before).
    """
    before, step = reference.belief.state, estimate.step
    R_wc, turn = before.R_wc, rotations.log(step.R)
    state = CameraState(
        before.position + R_wc @ step.t,
        rotations.multiply(before.orientation, rotations.exp_quaternion(turn)),
        R_wc @ step.t / elapsed,
        turn / elapsed,
    )
    by_turn = -R_wc @ rotations.skew(step.t)
    by_pose = np.zeros((12, POSE_SIZE))
    by_pose[POSITION, POSITION], by_pose[POSITION, ROTATION] = np.eye(3), by_turn
    by_pose[ROTATION, ROTATION] = step.R.T
    by_pose[LINEAR, ROTATION] = by_turn / elapsed
    by_step = np.zeros((12, 6))
    by_step[POSITION, :3], by_step[LINEAR, :3] = R_wc, R_wc / elapsed
    by_step[ROTATION, 3:] = np.eye(3)
    by_step[ANGULAR, 3:] = np.linalg.inv(rotations.right_jacobian(turn)) / elapsed

    cross = reference.cross[used, :POSE_SIZE]
    shared = np.einsum("mij,mkj,mlk->il", cross, estimate.by_first, estimate.gain, optimize=True)
    mixed = by_pose @ shared @ by_step.T
    P_pose = reference.belief.P[:POSE_SIZE, :POSE_SIZE]
    P = by_pose @ P_pose @ by_pose.T + by_step @ estimate.covariance @ by_step.T + mixed + mixed.T
    return CameraBelief(state, symmetrised(P)), by_step
