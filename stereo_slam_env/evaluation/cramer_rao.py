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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters.contract.inputs import Start, StereoObservation
from filters.contract.noise import StereoNoise
from filters.contract.validation import unchecked
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.camera import StereoCamera
from filters.geometry.poses import Pose
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.rectified_pair import Stacked
from filters.motions.constant_velocity import ConstantVelocity
from filters.motions.motion_model import POSE_SIZE, CameraState, MotionModel
from stereo_slam_env.recording.recording import Frame, LandmarkTruth, Recording

if TYPE_CHECKING:
    from filters.engine.batch import FilterBatch

_IDLE = 0.1
"""s, of steps of a drive that has ended."""


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
    arguments: dict[str, Any] = {"use_odometry": use_odometry, "right_row": right_row, "landmark": landmark}
    (bound,) = cramer_rao_bounds([recording], motion, progress=progress, **arguments)
    return bound


def cramer_rao_bounds(
    recordings: Sequence[Recording],
    motion: ConstantVelocity,
    *,
    use_odometry: bool = False,
    progress: Callable[[int, int], None] | None = None,
    **given: Any,
) -> list[Bound | None]:
    """Bounds of recordings of one camera in one engine: the bits of `cramer_rao_bound`, in less time.

    Arguments are those of `cramer_rao_bound`. A `ValueError` says that the cameras differ.
    """
    given["use_odometry"] = use_odometry
    drives = [_Drive(recording, motion, given) if _has_whole_truth(recording) else None for recording in recordings]
    bounded = [drive for drive in drives if drive is not None]
    if bounded:
        with threadpool_limits(limits=1):
            _run_together(bounded, progress)
    return [None if drive is None else Bound(drive.covariances) for drive in drives]


def _has_whole_truth(recording: Recording) -> bool:
    frames, truth = recording.frames, recording.landmarks
    if truth is None or not frames or any(frame.truth is None for frame in frames):
        return False
    return bool(np.isin(np.concatenate([frame.observation.ids for frame in frames]), truth.ids).all())


def _run_together(drives: Sequence[_Drive], progress: Callable[[int, int], None] | None) -> None:
    longest = max(len(drive.covariances) for drive in drives)
    batch = ReferenceBelief.together([drive.belief for drive in drives])
    for k in range(longest):
        if k > 0:
            batch.predict([drive.set_out(k) for drive in drives])
        batch.update([drive.arrive(k) for drive in drives])
        for drive, covariance in zip(drives, batch.pose_covariances, strict=True):
            drive.note(k, covariance)
        if progress is not None:
            progress(k + 1, longest)


class _Drive:
    """A recording with its reference belief, which idles in the last frame while longer drives go on."""

    def __init__(self, recording: Recording, motion: MotionModel, given: Mapping[str, Any]) -> None:
        self._frames, truth = recording.frames, recording.landmarks
        start = recording.frames[0].truth
        assert truth is not None
        assert start is not None
        self.belief = ReferenceBelief(recording.camera, recording.noise, motion, recording.start, start, **given)
        self.covariances = np.empty((len(recording), POSE_SIZE, POSE_SIZE))
        self._landmarks = truth
        self._last_seen = np.full(len(truth.ids), -1)
        for k, frame in enumerate(self._frames):
            self._last_seen[np.searchsorted(truth.ids, frame.observation.ids)] = k

    def _frame(self, k: int) -> Frame:
        return self._frames[min(k, len(self._frames) - 1)]

    def set_out(self, k: int) -> float:
        """The time step to frame k, before the prediction over it."""
        dt = self._frame(k).timestamp - self._frame(k - 1).timestamp if k < len(self._frames) else _IDLE
        self.belief.set_out(self._frame(k), dt)
        return dt

    def arrive(self, k: int) -> StereoObservation:
        """Information of frame k, after the prediction."""
        return self.belief.arrive(self._frame(k), self._landmarks)

    def note(self, k: int, covariance: FloatArray) -> None:
        """Note the covariance after frame k, and marginalise out what is never seen again."""
        if k < len(self._frames):
            self.covariances[k] = covariance
            self.belief.forget(self._landmarks.ids[self._last_seen == k])


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
        self._step: tuple[float, FloatArray, FloatArray] | None = None
        parametrisation = Euclidean() if landmark is None else landmark
        self._slam = StereoEKF(
            camera, noise, motion=motion, landmark=parametrisation, error="so3", gate=None, drop_unseen=False
        )
        self._start = replace(start, position=truth.position, orientation=truth.orientation)
        self._slam.reset(self._start)
        self._noises: dict[bool, FloatArray] = {}

    @classmethod
    def together(cls, beliefs: Sequence[ReferenceBelief]) -> FilterBatch:
        """The filters of beliefs that have not begun, from now on in one engine; a `ValueError` where they differ."""
        from filters.engine.batch import FilterBatch  # trajectories are judged where Numba is absent

        batch = FilterBatch(iter([belief._slam for belief in beliefs]).__next__, len(beliefs))
        batch.reset([belief._start for belief in beliefs])
        return batch

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
        if not math.isnan(self._time):
            self._slam.predict(self.set_out(frame, frame.timestamp - self._time))
        self._slam.update(self.arrive(frame, landmarks))
        self._time = frame.timestamp

    def set_out(self, frame: Frame, dt: float) -> float:
        """Before the prediction to the next frame, dt s later, which is returned.

        Eq. 6 with the impulses that really were, so that it leads from true pose to true pose.
        """
        assert frame.truth is not None
        before, truth = self._slam.camera_state, frame.truth
        linear = (truth.position - before.position) / dt
        angular = rotations.log(rotations.matrix(before.orientation).T @ rotations.matrix(truth.orientation)) / dt
        self._slam.move_to(CameraState(before.position, before.orientation, linear, angular))
        self._step = dt, linear, angular
        return dt

    def arrive(self, frame: Frame, landmarks: LandmarkTruth) -> StereoObservation:
        """After the prediction, if there is one: what the update to the frame is given.

        What was measured does not matter, only which landmarks, and how well.
        """
        if self._step is not None:
            self._move_to(frame, *self._step)
        observation = frame.observation
        in_map = _are_in(observation.ids, landmarks.ids)
        if not in_map.all():
            observation = observation.select(in_map)
        pose = self._slam.camera_state
        points_w = landmarks.positions[np.searchsorted(landmarks.ids, observation.ids)]
        points_c = Pose(pose.position, pose.orientation).to_camera(points_w)
        # A point behind the camera is not what was measured: the id is wrong.
        sound = points_c[:, 2] > 0
        uvd, R = self._rig.project(points_c[sound]), self._noise_of(observation)[sound]
        return unchecked(StereoObservation, ids=observation.ids[sound], uvd=uvd, v_right=None, R=R, bodies=None)

    def _move_to(self, frame: Frame, dt: float, linear: FloatArray, angular: FloatArray) -> None:
        """Move to the true pose, and learn as much as the odometry of the step says."""
        assert frame.truth is not None
        camera = CameraState(frame.truth.position, frame.truth.orientation, linear, angular)
        self._slam.move_to(camera)
        if frame.odometry is None or not self._use_odometry:
            return
        measured = self._motion.odometry_measurement(camera, dt, frame.odometry)
        if measured is not None:  # nothing is to be learnt from it here but how much there is to learn
            H = {"pose": measured.H[:, :POSE_SIZE], "velocity": measured.H[:, POSE_SIZE:]}
            self._slam.correct(0.0 * measured.innovation, H, measured.R)

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
        own_ids = self.ids
        self.forget(own_ids[~_are_in(own_ids, np.sort(ids))])

    def forget(self, ids: IntArray) -> None:
        """Marginalise landmarks out; others are ignored."""
        if len(ids):
            self._slam.forget(ids)


def _are_in(ids: IntArray, known: IntArray) -> BoolArray:
    """Mask of ids that are among some sorted ones."""
    if not len(known):
        return np.zeros(len(ids), dtype=np.bool_)
    members: BoolArray = known[np.minimum(np.searchsorted(known, ids), len(known) - 1)] == ids
    return members


def _noise_of_uvd(observation: StereoObservation, noise: StereoNoise, right_row: bool) -> FloatArray:
    """Covariance of the best (u, v, d) that each sighting gives, (M, 3, 3): with the right row, v is an average."""
    R = observation.covariances(noise)
    if not right_row or observation.v_right is None:
        return R
    (both,) = Stacked().stages(observation, R)
    information = both.T.T @ np.linalg.solve(both.R, np.broadcast_to(both.T, (len(R), *both.T.shape)))
    best: FloatArray = np.linalg.inv(information)
    return best
