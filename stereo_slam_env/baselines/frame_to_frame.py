"""Stereo odometry without a map: the step between two frames by OpenCV's PnP with RANSAC, then refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from filters import (
    BodyVelocity,
    CameraState,
    InertialSamples,
    MotionModel,
    RangeBearing,
    StereoCamera,
    StereoNoise,
    StereoObservation,
    UpdateReport,
)
from filters.checks.consistency import chi_square_quantile
from filters.contract.validation import gate_probability, positive, unique_ids
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import ANGULAR, LINEAR, POSE_SIZE, POSITION, ROTATION
from filters.parts import Named
from stereo_slam_env.baselines.dead_reckoning import CameraBelief, CameraFilter, symmetrised
from stereo_slam_env.frontend.ego_motion import (
    Pairs,
    StepEstimate,
    left_pixel_step,
    most_likely_step,
    perspective_n_point,
    squared_distances,
)

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
        gone = unique_ids("ids", np.asarray(ids))
        if self._reference is not None:
            kept = ~np.isin(self._reference.observation.ids, gone)
            before = self._reference
            seen, R, cross = before.observation.select(kept), before.R[kept], before.cross[kept]
            self._reference = _Reference(before.belief, seen, R, cross)

    def _use(self, observation: StereoObservation) -> UpdateReport:
        """Measure the step from the reference frame; the frame becomes the next reference if it can be one."""
        observation = RangeBearing().completed(observation, self.camera)
        R = observation.covariances(self.noise)
        cross = np.zeros((len(observation), 12, 3))
        known = used = np.zeros(0, dtype=np.int64)
        nis, nis_dof, gated = 0.0, 0, known
        measured = False
        if self._reference is not None and self._elapsed > 0.0:
            reference = self._reference
            _, i, known = np.intersect1d(
                reference.observation.ids, observation.ids, assume_unique=True, return_indices=True
            )
            pairs = Pairs(reference.observation.uvd[i], observation.uvd[known], reference.R[i], R[known])
            found = self._measure(pairs)
            if found is None:
                self._fallbacks += 1
            else:
                estimate, inliers = found
                used, gated = known[inliers], np.delete(known, inliers)
                self._belief, by_step = _chained(reference, i[inliers], estimate, self._elapsed)
                cross[used] = -by_step @ estimate.gain @ R[used]
                nis, nis_dof, measured = estimate.nis, estimate.nis_dof, True
        ids = observation.ids
        new = np.delete(ids, known)
        takes_over = len(observation) >= self._min_points
        if takes_over:
            self._reference = _Reference(self._belief, observation, R, cross)
            self._elapsed = 0.0
        return UpdateReport(
            updated=ids[used],
            gated=ids[gated],
            failed=ids[:0] if measured else ids[known],
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
        found = perspective_n_point(
            self.camera, pairs.select(usable), self._min_points, polished=self._refinement == "opencv"
        )
        if found is None:
            return None
        step, inliers = found[0], usable[found[1]]
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
