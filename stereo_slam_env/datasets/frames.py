"""The frames of a recording of images that can be used, and what is done about those that cannot."""

from __future__ import annotations

import logging
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, Pose
from filters.validation import FloatArray
from stereo_slam_env.datasets.image_files import BrokenPair

_ORTHONORMAL = 1e-2
"""Largest entry of R R^T - I of a pose that is believed to be one; files have as few as six digits."""

OnBroken = Literal["raise", "skip"]

log = logging.getLogger(__name__)


@dataclass
class Faults:
    """Broken pairs: each raises, or is logged and counted.

    Parameters
    ----------
    on_broken : {"raise", "skip"}
        Which of the two.
    counts : Counter
        Faults met so far, reason -> number of pairs.

    Raises
    ------
    ValueError
        `on_broken` is something else.
    """

    on_broken: OnBroken
    counts: Counter[str] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        if self.on_broken not in ("raise", "skip"):
            raise ValueError(f"on_broken must be 'raise' or 'skip', got {self.on_broken!r}")

    def meet(self, fault: BrokenPair) -> None:
        """Raise `fault`, or log and count it."""
        if self.on_broken == "raise":
            raise fault
        self.counts[fault.reason] += 1
        log.warning("pair skipped: %s", fault)


@dataclass(frozen=True, eq=False)
class CameraFiles:
    """The images of one camera: frame number -> file, and the folder for messages."""

    folder: Path
    files: Mapping[int, Path]


@dataclass(frozen=True, eq=False)
class Times:
    """Time of frame k in row k, s (NaN where it cannot be read), and the file for messages."""

    path: Path
    seconds: FloatArray


@dataclass(frozen=True, eq=False)
class Truth:
    """Pose of the left camera of frame k in row k, in any world; None where the row is no pose."""

    path: Path
    poses: Sequence[Pose | None]


@dataclass(frozen=True, eq=False)
class FramePair:
    """Data of a pair before its images are read.

    Attributes
    ----------
    number : int
        Frame number in the recording.
    timestamp : float
        s.
    left, right : Path
        Images.
    truth : Pose, optional
        Of the left camera, in the world of the recording.
    odometry : BodyVelocity, optional
        Of the step from frame `number` - 1.
    """

    number: int
    timestamp: float
    left: Path
    right: Path
    truth: Pose | None = None
    odometry: BodyVelocity | None = None


def usable_pairs(
    cameras: tuple[CameraFiles, CameraFiles],
    times: Times,
    faults: Faults,
    *,
    truth: Truth | None = None,
    odometry: Sequence[BodyVelocity | None] = (),
    first: int | None = None,
    last: int | None = None,
) -> list[FramePair]:
    """The frames that have all they need, in time order.

    Parameters
    ----------
    cameras : (CameraFiles, CameraFiles)
        Left and right.
    times : Times
        One row a frame.
    faults : Faults
        Raises at the first broken frame, or counts it.
    truth : Truth, optional
        One row a frame.
    odometry : sequence of BodyVelocity or None, optional
        One a frame; frames beyond its end have none.
    first, last : int, optional
        Frame numbers to start and to end with, both included; nothing outside is looked at.

    Raises
    ------
    BrokenPair
        An image, a time or a pose is missing or no use, and `faults` raises.
    ValueError
        `first` and `last` select nothing, or nothing is left.
    """
    numbers = _selected(
        {*cameras[0].files, *cameras[1].files, *range(len(times.seconds))}, first, last, cameras[0].folder
    )
    pairs = []
    for number in numbers:
        try:
            _require_images(number, cameras, times)
            _require_time(number, cameras[0], times)
            pose = None if truth is None else _pose(number, truth)
        except BrokenPair as fault:
            faults.meet(fault)
            continue
        step = odometry[number] if number < len(odometry) else None
        left, right = (camera.files[number] for camera in cameras)
        pairs.append(FramePair(number, float(times.seconds[number]), left, right, pose, step))
    pairs = _in_time_order(pairs, times, faults)
    if not pairs:
        raise ValueError(
            f"{cameras[0].folder} has no usable pair among its {len(numbers)} frames: check the files in it"
        )
    return pairs


def poses_of_rows(rows: FloatArray) -> list[Pose | None]:
    """Poses of (K, 12) rows that hold the upper 3x4 part of T_world_cam; None where a row is not finite or no pose."""
    matrices = rows.reshape(-1, 3, 4)
    R = np.nan_to_num(matrices[:, :, :3], nan=0.0, posinf=0.0, neginf=0.0)
    defect = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    good = np.isfinite(rows).all(axis=1) & (defect < _ORTHONORMAL) & (np.linalg.det(R) > 0)
    R[~good] = np.eye(3)
    orientations = Rotation.from_matrix(R).as_quat().reshape(-1, 4)
    return [Pose(r.copy(), q) if ok else None for r, q, ok in zip(matrices[:, :, 3], orientations, good, strict=True)]


def _selected(numbers: set[int], first: int | None, last: int | None, folder: Path) -> list[int]:
    for name, value in (("first", first), ("last", last)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
            raise ValueError(f"{name} must be a frame number >= 0, got {value!r}")
    if not numbers:
        raise ValueError(f"{folder} has no images: check that the recording was unpacked there")
    low, high = 0 if first is None else first, max(numbers) if last is None else last
    chosen = sorted(number for number in numbers if low <= number <= high)
    if not chosen:
        raise ValueError(
            f"first={first}, last={last} select no frame of {folder}: its frames are {min(numbers)} to {max(numbers)}"
        )
    return chosen


def _require_images(number: int, cameras: tuple[CameraFiles, CameraFiles], times: Times) -> None:
    for name, camera in zip(("left", "right"), cameras, strict=True):
        if number not in camera.files:
            raise BrokenPair(
                f"{name} image missing",
                f"{camera.folder} has no image of frame {number} ({len(cameras[0].files)} left images, "
                f"{len(cameras[1].files)} right images, {len(times.seconds)} times in {times.path.name}): "
                "copy it again, choose others with first and last, or skip broken pairs",
            )


def _require_time(number: int, left: CameraFiles, times: Times) -> None:
    if number >= len(times.seconds):
        raise BrokenPair(
            "no time stamp",
            f"{times.path} has {len(times.seconds)} times where {left.folder.name} has {len(left.files)} images "
            f"(frame {number} has none): complete it, or skip broken pairs",
        )
    if not np.isfinite(times.seconds[number]):
        raise BrokenPair(
            "no time stamp", f"{times.path} has NaN or infinity as the time of frame {number}: correct the row"
        )


def _pose(number: int, truth: Truth) -> Pose:
    if number >= len(truth.poses):
        raise BrokenPair(
            "no true pose",
            f"{truth.path} has {len(truth.poses)} poses and none for frame {number}: complete it or remove the file",
        )
    pose = truth.poses[number]
    if pose is None:
        raise BrokenPair(
            "no true pose",
            f"{truth.path} has NaN, infinity or no rotation in row {number}: correct the row, or skip broken pairs",
        )
    return pose


def _in_time_order(pairs: list[FramePair], times: Times, faults: Faults) -> list[FramePair]:
    """As many pairs as possible whose time stamps increase; the others are faults."""
    kept = _longest_increase([pair.timestamp for pair in pairs])
    for at, pair in enumerate(pairs):
        if at not in kept:
            other = pairs[at - 1 if at else 1]
            message = (
                f"{times.path}: times must increase, frame {pair.number} has {pair.timestamp:.9g} s next to "
                f"{other.timestamp:.9g} s of frame {other.number}: correct it, or skip broken pairs"
            )
            faults.meet(BrokenPair("time stamp does not increase", message))
    return [pair for at, pair in enumerate(pairs) if at in kept]


def _longest_increase(values: list[float]) -> set[int]:
    """Indices of a longest strictly increasing subsequence."""
    tails: list[float] = []
    ends: list[int] = []
    previous: list[int] = []
    for i, value in enumerate(values):
        at = bisect_left(tails, value)
        tails[at : at + 1] = [value]
        ends[at : at + 1] = [i]
        previous.append(ends[at - 1] if at else -1)
    chosen, i = set(), ends[-1] if ends else -1
    while i >= 0:
        chosen.add(i)
        i = previous[i]
    return chosen
