"""A recording of images on disk as an `ImageSequence`, its rig, and what is done about pairs that cannot be used."""

from __future__ import annotations

import logging
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, InertialSamples, Pose, Start, StereoCamera
from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.datasets.image_files import BrokenPair, image_size, read_grey, shift_of_files
from stereo_slam_env.datasets.restated import TrueMotion, pose_at
from stereo_slam_env.recording.inertial import joined
from stereo_slam_env.recording.recording import Reference, StereoPair
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_layouts import require_rate
from stereo_slam_env.sensing.lenses import Rectification, Rectify
from stereo_slam_env.sensing.projections import camera_position, rectified_rig, require_principal_point


def rig_of(path: Path, P: tuple[FloatArray, FloatArray]) -> Callable[[Path], StereoCamera]:
    """Gives the rig of the projection matrices `P`, see `rectified_rig`, for the size of the image in a file."""

    def of_image(image: Path) -> StereoCamera:
        size = image_size(image)
        require_principal_point(path, P[0], size)
        return rectified_rig(path, *P, size)

    return of_image


def of_left_camera(poses: Sequence[Pose | None], P_left: FloatArray) -> list[Pose | None]:
    """Poses of the left camera from those of the reference camera that `P_left` = K [I | t] projects from."""
    offset = camera_position(P_left)
    if not offset.any():
        return list(poses)
    return [pose and Pose(pose.position + pose.R_wc @ offset, pose.orientation) for pose in poses]


OnBroken = Literal["raise", "skip"]
_ORTHONORMAL = 1e-2
"""Largest entry of R R^T - I of a pose that is believed to be one; files have as few as six digits."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Choice:
    """Frames `first` to `last`, both included (None: no limit), and whether broken pairs raise or are skipped."""

    first: int | None = None
    last: int | None = None
    on_broken: OnBroken = "raise"

    def __post_init__(self) -> None:
        for name, value in (("first", self.first), ("last", self.last)):
            if value is not None and (type(value) is not int or value < 0):
                raise ValueError(f"{name} must be a frame number >= 0, got {value!r}")
        if self.on_broken not in ("raise", "skip"):
            raise ValueError(f"on_broken must be 'raise' or 'skip', got {self.on_broken!r}")


@dataclass
class Faults:
    """Broken pairs: each raises, or is logged and counted (reason -> number of pairs)."""

    on_broken: OnBroken
    counts: Counter[str] = field(default_factory=Counter)

    def meet(self, fault: BrokenPair) -> None:
        """Raise `fault`, or log and count it."""
        if self.on_broken == "raise":
            raise fault
        self.counts[fault.reason] += 1
        log.warning("pair skipped: %s", fault)


@dataclass(frozen=True, eq=False)
class ImageFiles:
    """Files of a recording of images, and what is known of each frame."""

    folders: tuple[Path, Path]  # of the left and of the right images, for messages
    images: tuple[Mapping[int, Path], Mapping[int, Path]]  # left and right ones by frame number
    seconds: FloatArray  # (K,): time of frame k in row k, s; NaN where it cannot be read
    times_file: Path  # for messages
    # Pose of the left camera of frame k in row k, in any world; None where the row is no pose.
    truth: Sequence[Pose | None] | None = None
    truth_file: Path = Path()  # for messages
    # Of the step to frame k from the one before; frames beyond its end have none.
    odometry: Sequence[BodyVelocity | None] = ()
    inertial: Sequence[InertialSamples | None] = ()

    def frame(self, number: int) -> FramePair:
        """Data of a pair; a `BrokenPair` where an image, its time or its pose is missing or no use."""
        left, right = self.images
        for side, folder, images in zip(("left", "right"), self.folders, self.images, strict=True):
            if number not in images:
                raise BrokenPair(
                    f"{side} image missing",
                    f"{folder} has no image of frame {number} ({len(left)} left images, "
                    f"{len(right)} right images, {len(self.seconds)} times in {self.times_file.name}): "
                    "copy it again, choose others with first and last, or skip broken pairs",
                )
        if number >= len(self.seconds):
            raise BrokenPair(
                "no time stamp",
                f"{self.times_file} has {len(self.seconds)} times where {self.folders[0].name} has {len(left)} "
                f"images (frame {number} has none): complete it, or skip broken pairs",
            )
        if not np.isfinite(self.seconds[number]):
            message = f"{self.times_file} has NaN or infinity as the time of frame {number}: correct the row"
            raise BrokenPair("no time stamp", message)
        pose, row = None, f"{self.truth_file} has NaN, infinity or no rotation in row {number}: correct the row"
        if self.truth is not None:
            if number >= len(self.truth):
                row = f"{self.truth_file} has {len(self.truth)} poses and none for frame {number}: complete it"
            elif (pose := self.truth[number]) is not None:
                row = ""
            if row:
                raise BrokenPair("no true pose", f"{row}, or skip broken pairs")
        step = self.odometry[number] if number < len(self.odometry) else None
        samples = self.inertial[number] if number < len(self.inertial) else None
        return FramePair(number, float(self.seconds[number]), left[number], right[number], pose, step, samples)


@dataclass(frozen=True, eq=False)
class FramePair:
    """Data of a pair before its images are read; `number` is that of the frame in the recording."""

    number: int
    timestamp: float
    left: Path
    right: Path
    truth: Pose | None
    odometry: BodyVelocity | None
    inertial: InertialSamples | None


def usable_pairs(files: ImageFiles, choice: Choice, faults: Faults) -> list[FramePair]:
    """The chosen frames that have all they need, in time order; the others are met by `faults`."""
    folder, first, last = files.folders[0], choice.first, choice.last
    numbers = {*files.images[0], *files.images[1], *range(len(files.seconds))}
    if not numbers:
        raise ValueError(f"{folder} has no images: check that the recording was unpacked there")
    low, high = first or 0, max(numbers) if last is None else last
    numbers_chosen = sorted(number for number in numbers if low <= number <= high)
    if not numbers_chosen:
        frames_words = f"its frames are {min(numbers)} to {max(numbers)}"
        raise ValueError(f"first={first}, last={last} select no frame of {folder}: {frames_words}")
    pairs = []
    for number in numbers_chosen:
        try:
            pairs.append(files.frame(number))
        except BrokenPair as fault:
            faults.meet(fault)
    increasing = _longest_increase([pair.timestamp for pair in pairs])
    for at, pair in enumerate(pairs):
        if at not in increasing:
            disagree = [k for k, p in enumerate(pairs) if k != at and (p.timestamp - pair.timestamp) * (k - at) <= 0.0]
            other = pairs[min(disagree, key=lambda k: abs(k - at))]
            message = (
                f"{files.times_file}: times must increase, frame {pair.number} has {pair.timestamp:.9g} s next to "
                f"{other.timestamp:.9g} s of frame {other.number}: correct it, or skip broken pairs"
            )
            faults.meet(BrokenPair("time stamp does not increase", message))
    if not increasing:
        raise ValueError(f"{folder} has no usable pair among its {len(numbers_chosen)} frames: check the files in it")
    return [pair for at, pair in enumerate(pairs) if at in increasing]


def _longest_increase(values: list[float]) -> set[int]:
    """Indices of a longest strictly increasing subsequence: one wild time costs one pair, not all that follow."""
    tails: list[float] = []
    ends: list[int] = []
    previous: list[int] = []
    for i, value in enumerate(values):
        at = bisect_left(tails, value)
        tails[at : at + 1] = [value]
        ends[at : at + 1] = [i]
        previous.append(ends[at - 1] if at else -1)
    longest, i = set(), ends[-1] if ends else -1
    while i >= 0:
        longest.add(i)
        i = previous[i]
    return longest


def poses_of_rows(rows: FloatArray) -> list[Pose | None]:
    """Poses of (K, 12) rows that hold the upper 3x4 part of T_world_cam; None where a row is not finite or no pose."""
    matrices = rows.reshape(-1, 3, 4)
    R = np.nan_to_num(matrices[:, :, :3], nan=0.0, posinf=0.0, neginf=0.0)
    defect = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    good = np.isfinite(rows).all(axis=1) & (defect < _ORTHONORMAL) & (np.linalg.det(R) > 0)
    R[~good] = np.eye(3)
    return known_poses(matrices[:, :, 3], Rotation.from_matrix(R), good)


def known_poses(positions: FloatArray, orientations: Rotation, known: BoolArray) -> list[Pose | None]:
    """K poses of positions (K, 3), m, and K rotations; None where they are not `known` (K,)."""
    quaternions = orientations.as_quat().reshape(-1, 4)
    return [Pose(r.copy(), q) if ok else None for r, q, ok in zip(positions, quaternions, known, strict=True)]


def poses_at(
    trajectory: Trajectory, times: FloatArray, T_bc: Pose, table: Path, choice: Choice
) -> tuple[list[Pose | None], Choice]:
    """True poses of the left camera at the times of the frames, s, and the choice without frames before and after."""
    poses = [pose_at(trajectory, time, T_bc) for time in times.tolist()]
    covered = [k for k, pose in enumerate(poses) if pose is not None]
    if not covered:
        raise ValueError(f"{table} covers none of the images: it is of another recording, or use_truth=False")
    last = covered[-1] if choice.last is None else min(choice.last, covered[-1])
    return poses, Choice(max(choice.first or 0, covered[0]), last, choice.on_broken)


class RecordedSequence:
    """An `ImageSequence` of files; images are read pair by pair.

    W is the left camera at the first pair that is used, and truth is told in it. Without a choice of the first frame
    the pairs begin where the truth has settled. Where that pair has no true pose, no
    pair has one: it could not be told in W. `camera` gives the rectified rig for an image file of the left camera,
    `rectify` makes rectified images, left and right, of those on disk, and `source` says reader, path and settings.
    """

    gravity: tuple[float, float, float] | None = None
    """Acceleration of a body that falls, in W, m/s^2, where the recording says it."""
    motion: tuple[TrueMotion, Pose] | None = None
    """Velocities of a body in the world of the truth, and the pose of the left camera in it, where they are known."""

    def __init__(
        self,
        name: str,
        files: ImageFiles,
        choice: Choice,
        camera: Callable[[Path], StereoCamera],
        source: Mapping[str, Any],
        truth_from: Reference,
        rectify: Rectify | None = None,
    ) -> None:
        self._found_at_opening = faults = Faults(choice.on_broken)
        frames = tuple(usable_pairs(files, choice, faults))
        require_rate(np.array([frame.timestamp for frame in frames]), str(files.times_file))
        if choice.first is None:
            frames = tuple(pair for pair in frames if truth_from.has_settled(pair.timestamp))
        self._frames = frames
        self.name, self.camera, self.start, self.truth_from = name, camera(frames[0].left), Start(), truth_from
        self.source = {**source, **vars(replace(choice, first=frames[0].number, last=frames[-1].number))}
        self._skipped = dict(faults.counts)
        self._rectify, self._shift = rectify, shift_of_files(files.images)

    @property
    def skipped(self) -> Mapping[str, int]:
        """Reason -> number of pairs left out; what is wrong with images is known once all pairs were read."""
        return dict(self._skipped)

    @property
    def R_left(self) -> FloatArray:
        """(3, 3): from the left camera as it is mounted to that of the pairs."""
        return self._rectify.R_left if isinstance(self._rectify, Rectification) else np.eye(3)

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        """Numbers of the pairs in the recording."""
        return tuple(frame.number for frame in self._frames)

    def __len__(self) -> int:
        """Number of pairs; where broken ones are skipped, those with broken images are still counted."""
        return len(self._frames)

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order; may be called again. A `BrokenPair` unless those are skipped."""
        faults = Faults(self._found_at_opening.on_broken, self._found_at_opening.counts.copy())
        origin: Pose | None = None
        before: FramePair | None = None
        left_out: list[FramePair] = []
        for frame in self._frames:
            try:
                size = self.camera.width, self.camera.height
                left, right = (read_grey(path, size, self._shift) for path in (frame.left, frame.right))
            except BrokenPair as fault:
                faults.meet(fault)
                self._skipped = dict(faults.counts)
                left_out.append(frame)
                continue
            if self._rectify is not None:
                left, right = self._rectify(left, right)
            if before is None:
                origin = frame.truth
            truth = _seen_from(origin, frame.truth)
            odometry = inertial = velocity = biases = None
            if before is not None:
                odometry = _mean_velocity(before, [*left_out, frame])
                inertial = _samples_since(before, [*left_out, frame])
            if self.motion is not None and origin is not None:
                motion, T_bc = self.motion
                velocity, biases = motion.of_camera(frame.timestamp, frame.truth, T_bc, origin)
            yield StereoPair(frame.timestamp, left, right, truth, odometry, inertial, velocity, biases)
            before, left_out = frame, []
        self._skipped = dict(faults.counts)


def _seen_from(origin: Pose | None, pose: Pose | None) -> Pose | None:
    if origin is None or pose is None:
        return None
    return Pose(origin.to_camera(pose.position), rotations.between(origin.orientation, pose.orientation))


def _mean_velocity(before: FramePair, frames: Sequence[FramePair]) -> BodyVelocity | None:
    """Mean over the steps from `before` to the last of `frames`; None where a step between is unknown."""
    if len(frames) == 1 and frames[0].number == before.number + 1:
        return frames[0].odometry
    every = [before, *frames]
    steps = [frame.odometry for frame in frames if frame.odometry is not None]
    if len(steps) < len(frames) or (np.diff([frame.number for frame in every]) != 1).any():
        return None
    shares = np.diff([frame.timestamp for frame in every]) / (frames[-1].timestamp - before.timestamp)
    return BodyVelocity(
        sum(share * step.linear for share, step in zip(shares, steps, strict=True)),
        sum(share * step.angular for share, step in zip(shares, steps, strict=True)),
        sum(share**2 * step.covariance for share, step in zip(shares, steps, strict=True)),
    )


def _samples_since(before: FramePair, frames: Sequence[FramePair]) -> InertialSamples | None:
    """Inertial samples from `before` to the last of `frames`; None where a step between is unknown."""
    every = [before, *frames]
    if (np.diff([frame.number for frame in every]) != 1).any():
        return None
    return joined([frame.inertial for frame in frames], np.diff([frame.timestamp for frame in every]))
