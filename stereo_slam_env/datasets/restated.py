"""Calibrations and poses in doubt: sequences with others than their own, and whether images are rectified or raw.

Rectified images stand beside the calibration of the raw cameras, and raw ones beside that of rectified images; names of
topics say either. Under the right reading a corner has one row in both images.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from filters import InertialSamples, Pose, Start, StereoCamera
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.datasets.image_files import BrokenPair, read_grey
from stereo_slam_env.datasets.layouts import reference_for
from stereo_slam_env.frontend.rectification_errors import FEWEST, RowOffsets, row_offsets
from stereo_slam_env.recording.recording import GreyImage, ImageSequence, Reference, StereoPair, Velocity
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import load_trajectory
from stereo_slam_env.sensing.imu import GRAVITY
from stereo_slam_env.sensing.lenses import Rectification
from stereo_slam_env.sensing.rig_files import Calibration

LARGEST_GAP = 0.1
"""True poses are interpolated between rows that are no further apart, s."""
_SAME_TIME = 1e-6
"""Of two times since 1970, s: their last digit is a quarter of that."""


class Recalibrated:
    """A sequence whose images are rectified by another calibration; its poses are those of the turned left camera."""

    def __init__(self, sequence: ImageSequence, calibration: Calibration, said: str) -> None:
        self._sequence = sequence
        self.camera = calibration if isinstance(calibration, StereoCamera) else calibration.camera
        stored = sequence.camera.width, sequence.camera.height
        if stored != (self.camera.width, self.camera.height):
            taken = f"{self.camera.width}x{self.camera.height}"
            raise ValueError(f"rig {said} is of images {taken}, those of {sequence.name} are {stored[0]}x{stored[1]}")
        self.name, self.start, self.truth_from = sequence.name, sequence.start, sequence.truth_from
        found, notes = as_they_are(calibration, lambda: sample_of_pairs(sequence.pairs(), len(sequence)), sequence.name)
        self._rectify = found if isinstance(found, Rectification) and found.needed else None
        self.source: Mapping[str, Any] = {**sequence.source, "rig": said, **({"notes": list(notes)} if notes else {})}

    @property
    def R_left(self) -> FloatArray:
        """(3, 3): from the left camera as it is mounted to that of the pairs."""
        return np.eye(3) if self._rectify is None else self._rectify.R_left

    @property
    def gravity(self) -> FloatArray | None:
        """Acceleration of a body that falls, in W, m/s^2, where the sequence says it."""
        gravity = getattr(self._sequence, "gravity", None)
        return None if gravity is None else np.asarray(self.R_left @ gravity)

    @property
    def skipped(self) -> Mapping[str, int]:
        """Pairs that the sequence left out."""
        return self._sequence.skipped

    def __len__(self) -> int:
        return len(self._sequence)

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order; may be called again."""
        for pair in self._sequence.pairs():
            if self._rectify is None:
                yield pair
                continue
            left, right = self._rectify(pair.left, pair.right)
            R, velocity = self._rectify.R_left, pair.velocity
            yield replace(
                pair,
                left=left,
                right=right,
                truth=turned(pair.truth, R),
                odometry=None,
                inertial=_of_turned_camera(pair.inertial, R),
                velocity=velocity and Velocity(R @ velocity.linear, R @ velocity.angular),
            )


def _of_turned_camera(samples: InertialSamples | None, R_left: FloatArray) -> InertialSamples | None:
    """The samples, with the place of their unit in the frame of the rectified left camera."""
    if samples is None:
        return None
    T_ci = Pose(np.zeros(3), rotations.from_matrix(R_left)) @ Pose(samples.unit.position, samples.unit.orientation)
    return replace(samples, unit=replace(samples.unit, position=T_ci.position, orientation=T_ci.orientation))


def turned(pose: Pose | None, R_left: FloatArray) -> Pose | None:
    """Pose of the rectified left camera, in a world that is turned likewise, from that of the camera as mounted."""
    if pose is None:
        return None
    R_wc = R_left @ pose.R_wc @ R_left.T
    return Pose(R_left @ pose.position, Rotation.from_matrix(R_wc).as_quat())


class WithTruth:
    """A sequence with the true poses of a trajectory file, interpolated at its times.

    Pairs before the first true pose are left out, since W is the left camera at the first pair; later ones that have
    none go without.
    """

    start = Start()
    gravity: FloatArray | None = None
    """Acceleration of a body that falls, in W, m/s^2, where the motion says it; known once pairs are read."""

    def __init__(
        self,
        sequence: ImageSequence,
        path: str,
        body: Pose | None = None,
        stated: tuple[Trajectory, TrueMotion] | None = None,
    ) -> None:
        """`stated` is what is at `path`, where that was read, in a world with z up."""
        self._motion: TrueMotion | None = None if stated is None else stated[1]
        trajectory = load_trajectory(path) if stated is None else stated[0]
        if trajectory.timestamps is None:
            raise ValueError(f"{path} has no times, so that no pose belongs to an image: give a TUM file")
        turn = Pose(np.zeros(3), Rotation.from_matrix(getattr(sequence, "R_left", np.eye(3)).T).as_quat())
        self._sequence, self._truth, self._body = sequence, trajectory, turn if body is None else body @ turn
        self._epoch = float(sequence.source.get("epoch_s", 0.0))
        self.name, self.camera = sequence.name, sequence.camera
        self.not_read: Mapping[str, str] = getattr(sequence, "not_read", {})
        self.source: Mapping[str, Any] = {**sequence.source, "truth": path}
        where = "of the left camera" if body is None else "carried over to the left camera"
        self.truth_from: Reference = reference_for(trajectory.positions, f"The poses {where} in {Path(path).name}.")
        self._outside = 0

    @property
    def skipped(self) -> Mapping[str, int]:
        """Pairs that the sequence left out, and those before the first true pose."""
        outside = {"before the first true pose": self._outside} if self._outside else {}
        return {**self._sequence.skipped, **outside}

    def __len__(self) -> int:
        """Number of pairs, with those before the first true pose."""
        return len(self._sequence)

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order; may be called again. A `ValueError` where no pair has a true pose."""
        origin, outside = None, 0
        for pair in self._sequence.pairs():
            time, velocity, biases = pair.timestamp + self._epoch, None, None
            pose = pose_at(self._truth, time, self._body)
            if origin is None and pose is None:
                outside += 1
                continue
            first = origin is None
            origin = origin or pose
            truth = None if pose is None or origin is None else origin.inverse() @ pose
            if self._motion is not None and origin is not None:
                self.gravity = origin.R_wc.T @ [0.0, 0.0, -GRAVITY]
                velocity, biases = self._motion.of_camera(time, pose, self._body, origin)
            yield replace(
                pair,
                truth=truth,
                velocity=velocity,
                biases=biases,
                odometry=None if first else pair.odometry,
                inertial=None if first else pair.inertial,
            )
        self._outside = outside
        if origin is None:
            times = self._truth.timestamps
            assert times is not None
            raise ValueError(
                f"{self.source['truth']} covers none of the images: its times are {times[0]:.9g} to {times[-1]:.9g} s, "
                f"theirs begin at {self._epoch:.9g} s: give times of one clock"
            )


def pose_at(trajectory: Trajectory, time: float, T_bc: Pose | None = None) -> Pose | None:
    """The pose of the body, or of a frame C fixed to it, at a time, s; None outside, or in a gap."""
    times = trajectory.timestamps
    assert times is not None
    if (row := _row_at(times, time)) is None:
        return None
    before, share = row
    if share == 0.0:
        pose = trajectory.pose(before)
    else:
        both = slice(before, before + 2)
        position = _between(trajectory.positions, before, share)
        turn = Slerp([0.0, 1.0], Rotation.from_quat(trajectory.orientations[both]))
        pose = Pose(position, turn(share).as_quat())
    return pose if T_bc is None else pose @ T_bc


def _row_at(times: FloatArray, time: float) -> tuple[int, float] | None:
    """The row at a time, or before it, and its share of the way to the next; None outside, or in a gap."""
    after = int(np.searchsorted(times, time - _SAME_TIME))
    if after < len(times) and abs(times[after] - time) < _SAME_TIME:
        return after, 0.0
    if not 0 < after < len(times) or times[after] - times[after - 1] > LARGEST_GAP + _SAME_TIME:
        return None
    return after - 1, (time - times[after - 1]) / (times[after] - times[after - 1])


def _between(rows: FloatArray, before: int, share: float) -> FloatArray:
    """A row, or what lies between it and the next."""
    return np.asarray(rows[before] if share == 0.0 else (1.0 - share) * rows[before] + share * rows[before + 1])


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """True velocities of a body, and the biases of the inertial unit that it is."""

    times: FloatArray
    """(K,), increasing, s."""
    linear: FloatArray
    """(K, 3), in the world U of the true poses, m/s; NaN where it is not known."""
    angular: FloatArray
    """(K, 3), about the axes of the body, rad/s."""
    biases: FloatArray | None = None
    """(K, 6): of gyros, rad/s, and accelerometers, m/s^2."""

    def of_camera(
        self, time: float, T_uc: Pose | None, T_bc: Pose, origin: Pose
    ) -> tuple[Velocity | None, FloatArray | None]:
        """Velocity of a camera at `T_bc` in the body, told in W as the camera at `origin`, and the biases, at a time.

        None where they are not known.
        """
        if T_uc is None or (row := _row_at(self.times, time)) is None:
            return None, None
        R_cb = T_bc.R_wc.T
        linear, angular_c = _between(self.linear, *row), R_cb @ _between(self.angular, *row)
        linear = linear + T_uc.R_wc @ np.cross(angular_c, R_cb @ T_bc.position)
        velocity = Velocity(origin.R_wc.T @ linear, angular_c) if np.isfinite(linear).all() else None
        return velocity, None if self.biases is None else _between(self.biases, *row)


def rates_between(times: FloatArray, orientations: FloatArray) -> FloatArray:
    """Angular velocities (K, 3), rad/s, about the body's axes, by the attitudes (K, 4) before and after each time."""
    last = len(times) - 1
    before, after = (np.clip(np.arange(len(times)) + step, 0, last) for step in (-1, 1))
    R = Rotation.from_quat(orientations)
    return np.asarray((R[before].inv() * R[after]).as_rotvec() / (times[after] - times[before])[:, None])


Images = Sequence[tuple[GreyImage, GreyImage]]
SAMPLE = 8
"""Pairs that are looked at."""
_EVERY = 5
"""They are so many pairs apart, in recordings that are long enough."""
_BETTER_BY, _SHARE = 0.15, 0.5
"""A reading that was not stated is taken where its rows agree better by so much, px, and to this share."""
_BEYOND_INFINITY = 0.1
"""Share of corners with disparities below -1 px that convicts a reading if the other one has none."""

log = logging.getLogger(__name__)


Read = TypeVar("Read", bound=Calibration)


def as_they_are(calibration: Read, sample: Callable[[], Images], what: str) -> tuple[Read, tuple[str, ...]]:
    """The calibration with its images read as raw or as rectified, and a note where that needs one.

    Parameters
    ----------
    calibration : StereoCamera or Rectification
        With the stated reading in `mapped`. A rig alone has no other reading.
    sample : callable
        Gives pairs of images as they were taken; called only where there is a choice.
    what : str
        Name of the images, for the note.
    """
    if not isinstance(calibration, Rectification) or not any(calibration.changes):
        return calibration, ()
    stated = calibration.mapped
    other_readings = [one for one in _NAMES if one != stated]
    if stated[0] == stated[1]:
        other_readings = [(not stated[0], not stated[1])]
    images = sample()
    rows = {one: _rows(replace(calibration, mapped=one), images) for one in (stated, *other_readings)}
    best = min(other_readings, key=lambda one: rows[one].spread)
    stated_rows, other = rows[stated], rows[best]
    if len(other.offset) < FEWEST and len(stated_rows.offset) < FEWEST:
        note = f"too few corners of {what} are in both images to tell whether these are rectified: read as stated, "
        return calibration, (_logged(note + _NAMES[stated], logging.INFO),)
    agree = f"rows agree to {other.spread:.2f} px {_HOW[best]}, to {stated_rows.spread:.2f} px {_HOW[stated]}"
    if _convicts(stated_rows, other):
        note = f"the images of {what} are {_NAMES[best]}, although their calibration or name says {_NAMES[stated]}: "
        return replace(calibration, mapped=best), (_logged(note + agree, logging.WARNING),)
    if min(stated_rows.spread, other.spread) > (1.0 - _SHARE) * max(stated_rows.spread, other.spread):
        note = f"the images of {what} are read as stated, {_NAMES[stated]}, which their rows do not decide: {agree}"
        return calibration, (_logged(note, logging.INFO),)
    return calibration, ()


def sample_of_pairs(pairs: Iterable[StereoPair], count: int) -> Images:
    """Images of some pairs of a sequence that has `count` of them; broken ones end it, and are met later."""
    taken: list[tuple[GreyImage, GreyImage]] = []
    try:
        for pair in islice(pairs, 0, SAMPLE * _EVERY, max(1, min(_EVERY, count // SAMPLE))):
            taken.append((pair.left, pair.right))
            if len(taken) == SAMPLE:
                break
    except BrokenPair:
        pass
    return taken


def sample_of_files(images: tuple[Mapping[int, Path], Mapping[int, Path]], size: tuple[int, int]) -> Images:
    """Some pairs of the files of both cameras by frame number; broken ones are left out, and met later."""
    numbers = sorted(images[0].keys() & images[1].keys())[: SAMPLE * _EVERY]
    taken = []
    for number in numbers[:: max(1, len(numbers) // SAMPLE)][:SAMPLE]:
        try:
            taken.append((read_grey(images[0][number], size), read_grey(images[1][number], size)))
        except BrokenPair:
            continue
    return taken


_NAMES = {(True, True): "raw", (False, False): "rectified", (True, False): "raw on the left alone"}
_NAMES[False, True] = "raw on the right alone"
_HOW = {(True, True): "after rectification", (False, False): "as they are"}
_HOW |= dict.fromkeys(((True, False), (False, True)), "after rectification of one")


def _rows(reading: Rectification, images: Images) -> RowOffsets:
    return row_offsets([reading(left, right) for left, right in images])


def _convicts(said: RowOffsets, other: RowOffsets) -> bool:
    """Whether the other reading is better than the stated one beyond doubt."""
    if len(other.offset) < FEWEST:
        return False
    if len(said.offset) < FEWEST:
        return len(other.offset) > 3 * len(said.offset) + FEWEST
    if said.beyond_infinity > _BEYOND_INFINITY and other.beyond_infinity == 0.0:
        return other.spread < said.spread
    return other.spread < _SHARE * said.spread and other.spread < said.spread - _BETTER_BY


def _logged(note: str, level: int) -> str:
    log.log(level, note)
    return note
