"""Filters in the loop of B rows, one for each, in lock-step where they can, and the `Belief` they leave."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from filters.checks.consistency import blind_pose_error, nees
from filters.contract.inputs import BodyVelocity, Start
from filters.contract.outputs import PoseBelief, UpdateReport
from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import first_line, type_name
from filters.engine.batch import (
    FilterBatch,
    RelativeLandmarks,
    Reports,
    WorldLandmarks,
    goes_in_a_batch,
    world_landmarks,
)
from filters.engine.frame_arrays import Observations, Odometry
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.poses import Pose
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.envs.rows import World
from stereo_slam_env.loop import FilterLoop
from stereo_slam_env.simulator.state import Kept


@dataclass(frozen=True, eq=False)
class Belief:
    """Pose and map of a filter after a frame; properties must be read before the filter goes on."""

    slam: StereoFilter
    """The filter."""
    report: UpdateReport
    """Of the frame."""
    pose: PoseBelief
    """Estimated pose."""
    ids: IntArray
    """(N,): landmarks in front of their anchors, at a finite distance; ascending."""
    points_w: FloatArray
    """(N, 3): their positions in W, m."""
    points_c: FloatArray
    """(N, 3): their positions in the camera frame, m."""
    map_size: int
    """Number of all landmarks, wherever they are."""

    @classmethod
    def of(cls, slam: StereoFilter, report: UpdateReport) -> Belief:
        """The current belief of a filter; an `ArithmeticError` where its pose is not finite."""
        pose, landmarks = slam.pose, slam.landmarks
        for name, value in vars(pose).items():
            if not np.isfinite(value).all():
                raise ArithmeticError(f"the filter returned NaN or infinity in its {name} of the pose")
        located = np.isfinite(landmarks.positions).all(axis=1) & np.isfinite(landmarks.covariances).all(axis=(1, 2))
        located &= landmarks.inverse_distance > 0
        points_w = landmarks.positions[located]
        points_c = (points_w - pose.position) @ rotations.matrix(pose.orientation)
        return cls(slam, report, pose, landmarks.ids[located], points_w, points_c, len(landmarks.ids))

    def __len__(self) -> int:
        return len(self.ids)

    @cached_property
    def joint_covariance(self) -> FloatArray:
        """Joint covariance of pose and positions (W), (6 + 3 N, 6 + 3 N), as `StereoFilter.joint_covariance`."""
        return self.slam.joint_covariance(self.ids)

    @cached_property
    def relative_covariances(self) -> FloatArray:
        """Covariances of `points_c`, (N, 3, 3) m^2.

        p_c = R_wc^T (p_w - r), so the errors of pose and landmark, and their correlation, all count.
        """
        R_cw = rotations.matrix(self.pose.orientation).T
        J = np.empty((len(self), 3, POSE_SIZE + 3))
        J[:, :, POSITION], J[:, :, POSE_SIZE:] = -R_cw, R_cw
        J[:, :, ROTATION] = rotations.skew(self.points_c)
        relative: FloatArray = J @ self.slam.pose_landmark_covariances(self.ids) @ J.transpose(0, 2, 1)
        return relative

    def nees(self, truth: Pose) -> FloatArray:
        """NEES of position, rotation, and both, (3,), in the filter's own error definition.

        Infinite where the covariance is not positive definite.
        """
        error, covariance = blind_pose_error(self.slam, truth.position, truth.orientation)
        blocks = np.stack([covariance[POSITION, POSITION], covariance[ROTATION, ROTATION]])
        values = np.append(nees(error.reshape(2, 3), blocks), nees(error[None], covariance[None]))
        return np.where(np.isnan(values), np.inf, values)


class FilterRows(Kept, ABC):
    """A filter for each row, all of one recipe."""

    changes: ClassVar[tuple[str, ...]] = (
        "poses",
        "pose_covariances",
        "nis",
        "nis_dof",
        "frames",
        "_now",
        "_maps",
        "_reports",
    )

    def __init__(self, count: int, name: str) -> None:
        self.poses = np.zeros((count, 7))
        """(B, 7): position (W, m) and orientation (xyzw) of every filter."""
        self.pose_covariances = np.zeros((count, 6, 6))
        """(B, 6, 6), of the poses, as in `PoseBelief`."""
        self.nis = np.zeros(count)
        """(B,), of the last frame of each filter."""
        self.nis_dof = np.zeros(count, dtype=np.int64)
        """(B,), of `nis`."""
        self.frames: IntArray = np.full(count, -1)
        """(B,): number of the last frame of each filter."""
        self._name, self._now = name, 0
        self._maps: RelativeLandmarks | None = None

    def use_frames(self, world: World, which: BoolArray, fresh: BoolArray) -> None:
        """Let some filters (B,) use the frames of their rows, the `fresh` ones (B,) from a new start.

        A `RuntimeError` names the filter, the frame and the cause where one fails, or its pose is not finite.
        """
        self.frames[which] += 1
        self.frames[fresh] = 0
        self._now, self._maps = int(which.argmax()), None
        try:
            for b in np.flatnonzero(fresh).tolist():
                self._now = b
                self._reset(b, world.start(b))
            self._use(world, which)
            self.poses, self.pose_covariances = poses, P = self._read_poses()
            for name, values in (("position", poses[:, :3]), ("orientation", poses[:, 3:]), ("covariance", P)):
                finite = np.isfinite(values).reshape(len(P), -1).all(axis=1)
                if not finite.all():
                    self._now = int(finite.argmin())
                    raise ArithmeticError(f"the filter returned NaN or infinity in its {name} of the pose")
        except Exception as error:  # a third-party filter may raise anything; the episode cannot go on without it
            what = f"{type_name(error)}: {first_line(error, empty='no message')}"
            row = "" if len(self.frames) == 1 else f" of environment {self._now}"
            raise RuntimeError(
                f"filter {self._name!r} failed in frame {self.frames[self._now]}{row}: {what}"
            ) from error

    @property
    @abstractmethod
    def filters(self) -> FilterBatch | list[StereoFilter]:
        """All filters."""

    @abstractmethod
    def report(self, b: int) -> UpdateReport:
        """Report of the last update of a filter."""

    @abstractmethod
    def _read_poses(self) -> tuple[FloatArray, FloatArray]: ...

    @property
    @abstractmethod
    def map_sizes(self) -> IntArray:
        """Number of landmarks in each map, (B,)."""

    @property
    def maps(self) -> RelativeLandmarks:
        """The maps as the cameras see them, read once a frame."""
        if self._maps is None:
            self._maps = self._read_maps()
        return self._maps

    @abstractmethod
    def _read_maps(self) -> RelativeLandmarks: ...

    def world_maps(self) -> WorldLandmarks:
        """The maps in W, read anew."""
        return world_landmarks(self.filters)

    def belief(self, b: int) -> Belief:
        """Pose and map of a filter."""
        return Belief.of(self.filters[b], self.report(b))

    @abstractmethod
    def _reset(self, b: int, start: Start) -> None: ...

    @abstractmethod
    def _use(self, world: World, which: BoolArray) -> None:
        """Let some filters use their frames."""


def filter_rows(
    make: Callable[[], StereoFilter], name: str, count: int, threads: int, *, use_odometry: bool
) -> FilterRows:
    """Filters of one recipe.

    Parameters
    ----------
    make : callable
        Makes one.
    name : str
        Of the recipe.
    count, threads : int
        Number of filters, and threads over which they are spread.
    use_odometry : bool
        Whether they are given the odometry.
    """
    first = make()
    if goes_in_a_batch(first) and first.options.motion.takes is BodyVelocity:  # samples come with whole frames
        return _Lockstep(make, name, count, threads, use_odometry=use_odometry)
    return _OneByOne([first, *(make() for _ in range(count - 1))], name, use_odometry=use_odometry)


class _Lockstep(FilterRows):
    """Filters of the engine, all in one call."""

    changes = (*FilterRows.changes, "_batch", "_times")

    def __init__(
        self,
        make: Callable[[], StereoFilter],
        name: str,
        count: int,
        threads: int,
        *,
        use_odometry: bool,
    ) -> None:
        super().__init__(count, name)
        self._batch = FilterBatch(make, count, threads)  # type: ignore[arg-type]
        self._use_odometry, self._times = use_odometry, np.zeros(count)
        self._reports: list[Reports | None] = [None] * count

    @property
    def filters(self) -> FilterBatch:
        return self._batch

    def report(self, b: int) -> UpdateReport:
        reports = self._reports[b]
        if reports is None:
            raise RuntimeError("there is no belief yet: reset the environment first")
        return reports[b]

    def _read_poses(self) -> tuple[FloatArray, FloatArray]:
        return self._batch.poses, self._batch.pose_covariances

    @property
    def map_sizes(self) -> IntArray:
        counts: IntArray = self._batch.engine.storage.counts[:, 0].copy()
        return counts

    def _read_maps(self) -> RelativeLandmarks:
        return self._batch.relative_landmarks()

    def world_maps(self) -> WorldLandmarks:
        return self._batch.world_landmarks()

    def _reset(self, b: int, start: Start) -> None:
        self._batch[b].reset(start)

    def _use(self, world: World, which: BoolArray) -> None:
        measured = world.measured(which)
        moved = which & (self.frames > 0)
        values, covariances, has_odometry = measured.odometry
        fused = moved & has_odometry & self._use_odometry
        if moved.any() and not fused.any():
            self._batch[0].options.motion.check_odometry(None)
        dt = np.where(moved, measured.times - self._times, 0.0)
        # Of its noise `coloured-noise` takes the white part.
        R = np.repeat(self._batch.R, np.diff(measured.offsets), axis=0) if measured.R is None else measured.R
        right = which & measured.with_right
        observations = Observations(which, measured.offsets, measured.ids, measured.uvd, R, right, measured.v_right)
        outcome = self._batch.engine.step(dt, observations, Odometry.of_velocities(fused, values, covariances))
        self._times[which] = measured.times[which]
        self.nis[which], self.nis_dof[which] = outcome.nis[which], outcome.dof[which]
        reports = Reports(measured.offsets, measured.ids, outcome)
        for b in np.flatnonzero(which).tolist():
            self._reports[b] = reports


class _OneByOne(FilterRows):
    """Any filters, by what all of them have in common."""

    changes = (*FilterRows.changes, "_loops")

    def __init__(self, slams: list[StereoFilter], name: str, *, use_odometry: bool) -> None:
        super().__init__(len(slams), name)
        self._loops = [FilterLoop(slam, use_odometry=use_odometry) for slam in slams]
        self._reports: list[UpdateReport | None] = [None] * len(slams)

    @property
    def filters(self) -> list[StereoFilter]:
        return [loop.slam for loop in self._loops]

    def report(self, b: int) -> UpdateReport:
        report = self._reports[b]
        if report is None:
            raise RuntimeError("there is no belief yet: reset the environment first")
        return report

    def _read_poses(self) -> tuple[FloatArray, FloatArray]:
        poses = [loop.slam.pose for loop in self._loops]
        values = np.array([np.append(pose.position, pose.orientation) for pose in poses])
        return values, np.array([pose.covariance for pose in poses])

    @property
    def map_sizes(self) -> IntArray:
        return np.array([len(loop.slam.landmarks.ids) for loop in self._loops])

    def _read_maps(self) -> RelativeLandmarks:
        beliefs = [self.belief(b) for b in range(len(self._loops))]
        offsets = np.concatenate([[0], np.cumsum([len(belief) for belief in beliefs])])
        ids, points_c = (np.concatenate([getattr(belief, name) for belief in beliefs]) for name in ("ids", "points_c"))
        covariances = np.concatenate([belief.relative_covariances for belief in beliefs])
        return RelativeLandmarks(offsets, ids, points_c, covariances, np.ones(len(ids), dtype=np.bool_))

    def _reset(self, b: int, start: Start) -> None:
        self._loops[b].reset(start)

    def _use(self, world: World, which: BoolArray) -> None:
        for b in np.flatnonzero(which).tolist():
            self._now = b
            report = self._reports[b] = self._loops[b].step(world.frame(b)).report
            self.nis[b], self.nis_dof[b] = report.nis, report.nis_dof
