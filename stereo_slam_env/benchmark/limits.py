"""How good any filter could be: the posterior Cramer-Rao bound along the true trajectory.

The recursion of Tichavsky, Muravchik and Nehorai (IEEE Trans. Signal Processing 46(5), 1998) is, in covariance form,
that of an extended Kalman filter whose Jacobians are taken at the truth and whose estimates are never needed. So it is
the filters' own algebra (`JointState`, `kalman.update`) with the true camera in the state:

- start covariance of the recording; motion of Eq. 6 with the impulses of `ConstantVelocity`;
- every sighting of the recording with the noise it really has (of the observation, or else of the recording), and
  with the row of the right image where that was measured: a second measurement of v, which not every filter uses;
- a landmark enters at its first sighting with what that says and no prior, exactly: (u, v, d) and the pose determine
  it. It leaves after its last one; marginalising what is never measured again loses nothing. One that comes back is
  kept until then, so the bound also holds for filters that recognise places.

**What it bounds.** The mean square error of filters that know this motion model and this noise, on average over noise
and drives drawn from the model. A car accelerates less than the white 3 m/s^2 assumed of it: given such a drive, the
part of the bound that comes from the motion is too large, and an estimator may come out a little better than the bound
(by up to 1 % in position and 8 % in rotation on the reference drive, where landmarks say nearly all there is to say,
see docs/metrics.md). A filter that assumes a smaller acceleration and is right knows more, and has a bound of its own.
Jacobians at one true drive stand for their expectation over drives. With heavy-tailed noise of covariance R it bounds
estimators that know only R.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from filters import rotations
from filters.engine import kalman, symmetric
from filters.engine.joint_state import JointState
from filters.engine.linearisation import linearise
from filters.interface import BodyVelocity, StereoObservation
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.parametrisation import LandmarkModel
from filters.measurements.bearing import stacked_stage
from filters.measurements.model import Stage
from filters.motion import POSE_SIZE, CameraState, ConstantVelocity
from filters.noise import StereoNoise
from filters.start import start_belief
from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.recording import Pose, Recording

RESAMPLES = 10_000
_AS_MEASURED = np.eye(3)


@dataclass(frozen=True, eq=False)
class Bound:
    """Lower bound of the error covariance of any unbiased filter, frame by frame.

    Attributes
    ----------
    pose : (K, 6, 6)
        Of position in W, m, and rotation in the camera frame, rad, after the frame's update.
    """

    pose: FloatArray


def efficiency_interval(bounds: FloatArray, errors: FloatArray, confidence: float = 0.95) -> tuple[float, float]:
    """Bootstrap interval of the efficiency over runs, the ratio of both root mean squares, in percent.

    By percentiles, seeded: a ratio of means of squares, which are far from Gaussian, has no useful standard error. With
    ten runs it is a rough one.

    Parameters
    ----------
    bounds, errors : (N,) ndarray
        Bound and root mean square error of each run, in one unit.
    confidence : float
        Of the interval.
    """
    drawn = np.random.default_rng(0).integers(len(bounds), size=(RESAMPLES, len(bounds)))
    ratios = np.sqrt(np.square(bounds)[drawn].sum(axis=1) / np.square(errors)[drawn].sum(axis=1))
    low, high = 100.0 * np.quantile(ratios, [0.5 - 0.5 * confidence, 0.5 + 0.5 * confidence])
    return float(low), float(high)


def cramer_rao_bound(
    recording: Recording,
    motion: ConstantVelocity,
    *,
    use_odometry: bool = False,
    right_row: bool = True,
    landmark: LandmarkModel | None = None,
) -> Bound | None:
    """Posterior Cramer-Rao bound along the true trajectory of a recording.

    Costs about as much as a filter run.

    Parameters
    ----------
    recording : Recording
        With the true pose in every frame and the true position of every landmark seen.
    motion : ConstantVelocity
        The motion model the estimator knows.
    use_odometry : bool
        Whether the estimator is given the odometry of the recording.
    right_row : bool
        Whether the estimator is given the row of the right image, where it was measured.
    landmark : LandmarkModel, optional
        Parametrisation to calculate in; the result does not depend on it. None: XYZ.

    Returns
    -------
    Bound or None
        None where the truth is not complete.
    """
    poses = [frame.truth for frame in recording.frames if frame.truth is not None]
    if len(poses) < len(recording) or not poses or not _every_landmark_is_known(recording):
        return None
    bound = _Recursion(recording, motion, Euclidean() if landmark is None else landmark)
    covariances = np.empty((len(recording), POSE_SIZE, POSE_SIZE))
    with threadpool_limits(limits=1):
        for k, frame in enumerate(recording.frames):
            if k:
                dt = frame.timestamp - recording.frames[k - 1].timestamp
                bound.predict(poses[k - 1], poses[k], dt, frame.odometry if use_odometry else None)
            bound.see(k, frame.observation, right_row)
            covariances[k] = bound.pose_covariance
    return Bound(covariances)


class _Recursion:
    """The covariance of the best estimator, with the true camera and map as its state."""

    def __init__(self, recording: Recording, motion: ConstantVelocity, landmark: LandmarkModel) -> None:
        assert recording.landmarks is not None
        self._rig, self._noise, self._motion = recording.camera, recording.noise, motion
        self._truth = recording.landmarks
        self._last_seen = np.full(len(self._truth.ids), -1)
        for k, frame in enumerate(recording.frames):
            self._last_seen[self._place(frame.observation.ids)] = k
        start = recording.start
        told, P = start_belief(
            start.position, start.orientation, start.linear_velocity, start.angular_velocity, start.covariance
        )
        first = recording.frames[0].truth
        assert first is not None
        camera = CameraState(first.position, first.orientation, told.linear_velocity, told.angular_velocity)
        self._state = JointState.without_map(camera, P, landmark)

    @property
    def pose_covariance(self) -> FloatArray:
        """Of the pose, (6, 6)."""
        return symmetric.full(self._state.P[:POSE_SIZE, :POSE_SIZE])

    def predict(self, before: Pose, now: Pose, dt: float, odometry: BodyVelocity | None) -> None:
        """Move along the truth: Eq. 6 with the impulses that really were, so that it leads from pose to pose."""
        linear = (now.position - before.position) / dt
        angular = rotations.log(rotations.matrix(before.orientation).T @ rotations.matrix(now.orientation)) / dt
        step = self._motion.predict(CameraState(before.position, before.orientation, linear, angular), dt, None)
        self._state.transform_camera(step.F, step.G @ step.Q @ step.G.T)
        self._state.camera = CameraState(now.position, now.orientation, linear, angular)
        if odometry is not None:
            measured = self._motion.odometry_measurement(self._state.camera, dt, odometry)
            if measured is not None:
                kalman.update(self._state.P, kalman.of_camera(measured))

    def see(self, k: int, observation: StereoObservation, right_row: bool) -> None:
        """Sightings of frame k, of known landmarks and of new ones; then forget those that were seen the last time."""
        state = self._state
        points_w = self._truth.positions[self._place(observation.ids)]
        points_c = (points_w - state.camera.position) @ state.camera.R_wc
        # A point behind the camera is not what was measured: the id is wrong.
        sound = points_c[:, 2] > 0
        ids, R = observation.ids[sound], _noise_of_uvd(observation, self._noise, right_row)[sound]
        uvd = self._rig.project(points_c[sound])
        known = np.isin(ids, state.ids)
        order = np.argsort(state.ids)
        index = order[np.searchsorted(state.ids, ids[known], sorter=order)]
        stage = Stage(uvd[known], _AS_MEASURED, R[known])
        kalman.update(state.P, linearise(self._rig, state, index, stage))
        new = ~known
        if new.any():
            camera = state.camera
            started = state.model.initialise(self._rig, camera.position, camera.R_wc, uvd[new])
            state.augment(ids[new], started, R[new])
        state.remove(self._last_seen[self._place(state.ids)] <= k)

    def _place(self, ids: IntArray) -> IntArray:
        """Where these landmarks are in the true map."""
        return np.searchsorted(self._truth.ids, ids)


def _noise_of_uvd(observation: StereoObservation, noise: StereoNoise, right_row: bool) -> FloatArray:
    """Covariance of the best (u, v, d) that each sighting gives, (M, 3, 3): with the right row, v is an average."""
    R = observation.covariances(noise)
    if not right_row or observation.v_right is None:
        return R
    both = stacked_stage(observation, R)
    information = both.T.T @ np.linalg.solve(both.R, np.broadcast_to(both.T, (len(R), *both.T.shape)))
    best: FloatArray = np.linalg.inv(information)
    return best


def _every_landmark_is_known(recording: Recording) -> bool:
    if recording.landmarks is None:
        return False
    seen = [frame.observation.ids for frame in recording.frames]
    known: BoolArray = np.isin(np.concatenate(seen), recording.landmarks.ids)
    return bool(known.all())
