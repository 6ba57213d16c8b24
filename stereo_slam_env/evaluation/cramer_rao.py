"""Posterior Cramer-Rao bound along the true trajectory: the smallest error covariance that any filter can have.

The recursion of Tichavsky, Muravchik and Nehorai (IEEE Trans. Signal Processing 46(5), 1998) is, in covariance form,
that of an extended Kalman filter whose Jacobians are taken at the truth and whose estimates are never needed. So it is
the filters' own algebra with the true camera in the state (`ReferenceBelief`), after the fact over a recording
(`cramer_rao_bound`) or frame by frame. Every sighting counts with the noise it really has. A landmark enters at its
first sighting with what that says and no prior, and leaves after its last one: marginalising what is never measured
again loses nothing. What is bounded, and how far it is to be trusted, is in docs/metrics.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from filters.contract.noise import StereoNoise
from filters.contract.observation import StereoObservation
from filters.contract.odometry import BodyVelocity
from filters.contract.start import Start
from filters.contract.validation import unchecked
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.model import LandmarkModel
from filters.measurements.rectified_pair import Stacked
from filters.motions.constant_velocity import ConstantVelocity
from filters.motions.model import POSE_SIZE, CameraState, MotionModel
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Recording


@dataclass(frozen=True, eq=False)
class Bound:
    """Lower bound of the error covariance of any unbiased filter, frame by frame."""

    pose: FloatArray  # (K, 6, 6): of position in W, m, and rotation in the camera frame, rad, after the frame's update


def cramer_rao_bound(
    recording: Recording,
    motion: ConstantVelocity,
    *,
    use_odometry: bool = False,
    right_row: bool = True,
    landmark: LandmarkModel | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Bound | None:
    """Posterior Cramer-Rao bound along the true trajectory of a recording; None where the truth is not complete.

    Costs about as much as a filter run. `motion` is the motion model that the estimator knows; `use_odometry` and
    `right_row` say whether it is given the odometry, and the row of the right image where that was measured. `landmark`
    is the parametrisation to calculate in, None: XYZ; the result does not depend on it. `progress` is called with
    (frames done, frames).
    """
    poses = [frame.truth for frame in recording.frames if frame.truth is not None]
    start, truth = recording.start, recording.landmarks
    if truth is None or not poses or len(poses) < len(recording):
        return None
    if not np.isin(np.concatenate([frame.observation.ids for frame in recording.frames]), truth.ids).all():
        return None
    best = ReferenceBelief(
        recording.camera,
        recording.noise,
        motion,
        start,
        poses[0],
        landmark=landmark,
        right_row=right_row,
        use_odometry=use_odometry,
    )
    last_seen = np.full(len(truth.ids), -1)
    for k, frame in enumerate(recording.frames):
        last_seen[np.searchsorted(truth.ids, frame.observation.ids)] = k
    covariances = np.empty((len(recording), POSE_SIZE, POSE_SIZE))
    with threadpool_limits(limits=1):
        for k, frame in enumerate(recording.frames):
            best.step(frame, truth)
            best.keep(truth.ids[last_seen > k])
            covariances[k] = best.pose_covariance
            if progress is not None:
                progress(k + 1, len(recording))
    return Bound(covariances)


class ReferenceBelief:
    """The covariance of the best estimator, with the true camera and map as its state.

    `noise` is what the noise of measurements that bring none of their own really is. Of the start the estimator is told
    the velocity and covariance of `start`, while its pose is the `truth`. Other arguments as of `cramer_rao_bound`.
    """

    def __init__(
        self,
        camera: StereoCamera,
        noise: StereoNoise,
        motion: MotionModel,
        start: Start,
        truth: Pose,
        *,
        landmark: LandmarkModel | None = None,
        right_row: bool = True,
        use_odometry: bool = True,
    ) -> None:
        self._rig, self._noise, self._motion, self._right_row = camera, noise, motion, right_row
        self._use_odometry, self._time = use_odometry, math.nan
        parametrisation = Euclidean() if landmark is None else landmark
        self._slam = StereoEKF(
            camera, noise, motion=motion, landmark=parametrisation, error="so3", gate=None, drop_unseen=False
        )
        self._slam.reset(replace(start, position=truth.position, orientation=truth.orientation))
        self._noises: dict[bool, FloatArray] = {}

    @property
    def ids(self) -> IntArray:
        """Landmarks in the map, ascending."""
        return np.sort(self._slam.ids)

    @property
    def pose_covariance(self) -> FloatArray:
        """Covariance of the pose, (6, 6), as in `PoseBelief`."""
        return self._slam.pose.covariance

    def joint_covariance(self) -> FloatArray:
        """Covariance of the pose and the landmark positions, in the order of `ids`."""
        return self._slam.joint_covariance()

    def step(self, frame: Frame, landmarks: LandmarkTruth) -> None:
        """Use the next frame, which has a true pose: predict (not for the first one), then see its sightings.

        Sightings of landmarks that are not in the true map are left out.
        """
        assert frame.truth is not None
        if not math.isnan(self._time):
            self.predict(frame.truth, frame.timestamp - self._time, frame.odometry if self._use_odometry else None)
        self._time, seen = frame.timestamp, frame.observation
        known = _are_in(seen.ids, landmarks.ids)
        if not known.all():
            seen = seen.select(known)
        self.see(seen, landmarks.positions[np.searchsorted(landmarks.ids, seen.ids)])

    def predict(self, truth: Pose, dt: float, odometry: BodyVelocity | None = None) -> None:
        """Move to the true pose: Eq. 6 with the impulses that really were, so that it leads from pose to pose."""
        before = self._slam.pose
        linear = (truth.position - before.position) / dt
        angular = rotations.log(rotations.matrix(before.orientation).T @ rotations.matrix(truth.orientation)) / dt
        self._slam.move_to(CameraState(before.position, before.orientation, linear, angular))
        self._slam.predict(dt)
        camera = CameraState(truth.position, truth.orientation, linear, angular)
        self._slam.move_to(camera)
        if odometry is not None:
            measured = self._motion.odometry_measurement(camera, dt, odometry)
            if measured is not None:  # nothing is to be learnt from it here but how much there is to learn
                H = {"pose": measured.H[:, :POSE_SIZE], "velocity": measured.H[:, POSE_SIZE:]}
                self._slam.correct(0.0 * measured.innovation, H, measured.R)

    def see(self, observation: StereoObservation, points_w: FloatArray) -> None:
        """Sightings of known landmarks and of new ones, which truly are at `points_w` (M, 3), m in W.

        What was measured does not matter, only which landmarks, and how well.
        """
        pose = self._slam.pose
        points_c = Pose(pose.position, pose.orientation).to_camera(points_w)
        # A point behind the camera is not what was measured: the id is wrong.
        sound = points_c[:, 2] > 0
        uvd, R = self._rig.project(points_c[sound]), self._noise_of(observation)[sound]
        self._slam.update(unchecked(StereoObservation, ids=observation.ids[sound], uvd=uvd, v_right=None, R=R))

    def _noise_of(self, observation: StereoObservation) -> FloatArray:
        """Covariance of the best (u, v, d) of each sighting, (M, 3, 3); calculated once where it is that of all."""
        if observation.R is not None or not len(observation):
            return _noise_of_uvd(observation, self._noise, self._right_row)
        with_right = observation.v_right is not None
        if with_right not in self._noises:
            first = observation.select([0])
            self._noises[with_right] = _noise_of_uvd(first, self._noise, self._right_row)[0]
        return self._noises[with_right][None].repeat(len(observation), axis=0)

    def keep(self, ids: IntArray) -> None:
        """Marginalise all other landmarks out; those never measured again take nothing with them."""
        there = self.ids
        gone = there[~_are_in(there, np.sort(ids))]
        if len(gone):
            self._slam.forget(gone)


def _are_in(ids: IntArray, known: IntArray) -> BoolArray:
    """Which ids are among some that are sorted."""
    if not len(known):
        return np.zeros(len(ids), dtype=np.bool_)
    found: BoolArray = known[np.minimum(np.searchsorted(known, ids), len(known) - 1)] == ids
    return found


def _noise_of_uvd(observation: StereoObservation, noise: StereoNoise, right_row: bool) -> FloatArray:
    """Covariance of the best (u, v, d) that each sighting gives, (M, 3, 3): with the right row, v is an average."""
    R = observation.covariances(noise)
    if not right_row or observation.v_right is None:
        return R
    (both,) = Stacked().stages(observation, R)
    information = both.T.T @ np.linalg.solve(both.R, np.broadcast_to(both.T, (len(R), *both.T.shape)))
    best: FloatArray = np.linalg.inv(information)
    return best
