"""Stereo images in a ROS bag: ROS 1 `.bag`, ROS 2 `.db3` or `.mcap` and their folder, through `rosbags` (extra `bags`).

The pair of cameras is found by their CameraInfo: the right one has P = K [I | -b, 0, 0]; where there is none and the
rig is given, by their names. Whether images are rectified is stated by "rect" in the name of their topic, and measured
where D, K, R and P of CameraInfo allow for both (`rectified_or_raw`). Images belong together by the stamps of their
headers, or, where these are none, by the times of the log. Inertial samples and odometry: see `bag_motion`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from filters import BodyVelocity, InertialSamples, Start, StereoCamera
from filters.contract.extras import require_module
from filters.contract.validation import plain
from filters.geometry.arrays import FloatArray, IntArray
from stereo_slam_env.datasets.bag_images import (
    calibration_of_topics,
    cameras_of,
    first_infos,
    grey_of,
    grey_of_compressed,
    shift_of_messages,
    size_of_message,
)
from stereo_slam_env.datasets.bag_motion import BagMotion, Clock, StatedTruth, motion_of_bag, truth_of_bag
from stereo_slam_env.datasets.image_files import BrokenPair
from stereo_slam_env.datasets.restated import as_they_are, sample_of_pairs
from stereo_slam_env.datasets.sequence import Choice, Faults
from stereo_slam_env.recording.inertial import joined
from stereo_slam_env.recording.recording import NO_REFERENCE, GreyImage, StereoPair
from stereo_slam_env.recording.trajectory_bags import opened_bag
from stereo_slam_env.recording.trajectory_layouts import message_times, require_rate
from stereo_slam_env.sensing.lenses import Rectification
from stereo_slam_env.sensing.rig_files import Calibration
from stereo_slam_env.sensing.rigs import Rig, calibration_of, imu_shift_of

NAME = "ros_bag"
FILES = (("metadata.yaml", "*.db3"), ("metadata.yaml", "*.mcap"))
SUFFIXES = (".bag", ".db3", ".mcap")
LARGEST_SHIFT_NS = 5_000_000
"""Images of one pair have stamps no further apart."""
LARGEST_LOG_SHIFT_NS = 100_000_000
"""Images of one pair are logged no further apart, nor by more than half the time between two."""
MOST_WAITING = 64
"""Images of one camera that are read before the one that is due: their log is that much out of order at most."""
_SAMPLE = 16
"""So many images of a camera tell how many bits its values have."""

log = logging.getLogger(__name__)


def open_sequence(
    path: Path,
    choice: Choice,
    *,
    left: str | None = None,
    right: str | None = None,
    rig: Rig | None = None,
    imu: str | None = None,
    odometry: str | None = None,
) -> BagSequence:
    """Open a bag.

    Parameters
    ----------
    path : Path
        A file, or the folder of a ROS 2 bag.
    choice : Choice
        Frames to use, see `open_image_sequence`, also for what is raised; frame k is pair k of the bag.
    left, right : str, optional
        Topics of the images; None: those of the only pair of cameras that CameraInfo shows, or, with `rig`, of the
        only two that are called so (`cam0`, `cam1`; `left`, `right`).
    rig : str, StereoCamera or mapping, optional
        In place of what CameraInfo says, see `sensing.rigs.camera_of`; needed where there is none.
    imu, odometry : str, optional
        Topics of inertial samples and of wheels, see `motion_of_bag`.

    Raises
    ------
    ValueError
        The bag is damaged, or holds no stereo images or several: the message lists its topics.
    ImportError
        `rosbags` is missing.
    """
    require_module("rosbags", "bags")
    with opened_bag(path) as reader:
        topics = {c.topic: c.msgtype for c in reader.connections}
        infos = first_infos(reader)
        eyes = cameras_of(path, topics, infos, left, right, by_name=rig is not None)
        streams = _stream(reader, eyes[0]), _stream(reader, eyes[1])
        times, pairs, notes = _pairs(path, eyes, streams)
        sizes = tuple(stream.size(path) for stream in streams)
        if rig is not None:
            calibration, more = calibration_of(rig), tuple[str, ...]()
        else:
            calibration, more = calibration_of_topics(reader, path, eyes, infos, (sizes[0], sizes[1]))
        shift = shift_of_messages((one for stream in streams for one in stream.sample), f"{path}: an image")
        selected = _chosen(len(pairs), path, choice)
        sequence = BagSequence(path, eyes, calibration, times[selected], pairs[selected], choice, shift)
        calibration, rows = as_they_are(
            calibration, lambda: sample_of_pairs(sequence.raw_pairs(), len(sequence)), " and ".join(map(plain, eyes))
        )
        for note in (*notes, *more):
            log.warning("%s", note)
        sequence.take(calibration, [*notes, *more, *rows])
        origin = int(times[selected][0])
        seconds = 1e-9 * (times[selected] - origin).astype(np.float64)
        clock = Clock(origin, seconds, None if rig is None else imu_shift_of(rig))
        sequence.motion = motion_of_bag(reader, path, eyes[0], clock, sequence.R_left, imu, odometry)
        sequence.source = {**sequence.source, **sequence.motion.source}
        sequence.stated_truth = truth_of_bag(reader, path, eyes[0])
    return sequence


class BagSequence:
    """An `ImageSequence` of two topics of a bag; images are read pair by pair."""

    start, truth_from = Start(), NO_REFERENCE
    motion = BagMotion([], None, np.zeros((0, 6, 6)), {}, {})
    stated_truth: StatedTruth | None = None
    """True poses and velocities that the bag has beside its images."""

    def __init__(
        self,
        path: Path,
        eyes: tuple[str, str],
        calibration: Calibration,
        times: IntArray,
        pairs: IntArray,
        choice: Choice,
        shift: int,
    ) -> None:
        """`times` (K,) ns; `pairs` (K, 2): which message of its topic each image is."""
        first = choice.first or 0
        self._pairs, self._shift = pairs, shift
        self._seconds = 1e-9 * (times - times[0])
        require_rate(self._seconds, f"{path}, {plain(eyes[0])}")
        self._path, self._eyes, self._on_broken = path, eyes, choice.on_broken
        self.name = path.stem
        self.source: Mapping[str, Any] = {
            "reader": NAME,
            "path": str(path.resolve()),
            "topics": list(eyes),
            "first": first,
            "last": first + len(self._pairs) - 1,
            "on_broken": choice.on_broken,
            "epoch_s": 1e-9 * int(times[0]),
        }
        self._skipped: Mapping[str, int] = {}
        self.take(calibration, [])

    def take(self, calibration: Calibration, notes: list[str]) -> None:
        """Read the images by a calibration; `notes` are kept in `source`."""
        self._rectify = calibration if isinstance(calibration, Rectification) and calibration.needed else None
        self.camera = calibration if isinstance(calibration, StereoCamera) else calibration.camera
        if notes:
            self.source = {**self.source, "notes": notes}

    @property
    def skipped(self) -> Mapping[str, int]:
        """Reason -> number of pairs left out, known once all pairs were read."""
        return dict(self._skipped)

    @property
    def R_left(self) -> FloatArray:
        """(3, 3): from the left camera as it is mounted to the rectified one."""
        return np.eye(3) if self._rectify is None else self._rectify.R_left

    @property
    def not_read(self) -> Mapping[str, str]:
        """Topics of inertial units and odometries that the pairs do not have, and their kinds."""
        return self.motion.not_read

    def __len__(self) -> int:
        """Number of pairs; where broken ones are skipped, those are still counted."""
        return len(self._pairs)

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order; may be called again. A `BrokenPair` unless those are skipped."""
        used = -1  # the last pair that was good
        for number, left, right in self._images():
            if self._rectify is not None:
                left, right = self._rectify(left, right)
            yield StereoPair(float(self._seconds[number]), left, right, None, *self._step(used, number))
            used = number

    def raw_pairs(self) -> Iterator[StereoPair]:
        """The pairs as they were taken, without what was measured between them."""
        for number, left, right in self._images():
            yield StereoPair(float(self._seconds[number]), left, right)

    def _images(self) -> Iterator[tuple[int, GreyImage, GreyImage]]:
        """Numbers of the pairs and their images; of each camera one message is in memory, unless the log is unordered.

        Two readers, since both topics may stand anywhere in the bag.
        """
        faults = Faults(self._on_broken)
        with opened_bag(self._path) as one, opened_bag(self._path) as other:
            due = [
                _due(reader, self._path, topic, column)
                for reader, topic, column in zip((one, other), self._eyes, self._pairs.T, strict=True)
            ]
            for number, both in enumerate(zip(*due, strict=True)):
                try:
                    left, right = (
                        self._image(one, topic, *message) for topic, message in zip(self._eyes, both, strict=True)
                    )
                except BrokenPair as fault:
                    faults.meet(fault)
                else:
                    yield number, left, right
        self._skipped = dict(faults.counts)

    def _step(self, begin: int, end: int) -> tuple[BodyVelocity | None, InertialSamples | None]:
        """Odometry and inertial samples from pair `begin` to pair `end`; nothing before the first."""
        if begin < 0:
            return None, None
        t = self._seconds
        steps = self.motion.inertial[begin + 1 : end + 1]
        samples = joined(steps, np.diff(t[begin : end + 1])) if steps else None
        return self.motion.step(t[begin], t[end]), samples

    def _image(self, reader: Any, topic: str, kind: str, raw: bytes) -> GreyImage:
        size = self.camera.width, self.camera.height
        try:
            message = reader.deserialize(raw, kind)
        except Exception as error:  # of a message that is not what its type says
            raise BrokenPair(
                "image damaged", f"{self._path}: an image of {topic} is damaged: record it again"
            ) from error
        if kind.endswith("CompressedImage"):
            return grey_of_compressed(message, size, self._path / topic.strip("/"), self._shift)
        return grey_of(message, size, f"{self._path}: an image of {topic}", self._shift)


def _due(reader: Any, path: Path, topic: str, wanted: IntArray) -> Iterator[tuple[str, bytes]]:
    """Types and contents of the messages `wanted` (K,) of a topic, by their place in it, in this order."""
    connections, needed, waiting = [c for c in reader.connections if c.topic == topic], set(wanted.tolist()), {}
    messages = enumerate(reader.messages(connections))
    for place in wanted.tolist():
        while place not in waiting:
            at, (connection, _, raw) = next(messages)
            if at in needed:
                waiting[at] = connection.msgtype, raw
            if len(waiting) > MOST_WAITING:
                raise ValueError(
                    f"{path}: more than {MOST_WAITING} images of {plain(topic)} are logged before one that is due, so "
                    "its stamps are out of order: record it again"
                )
        yield waiting.pop(place)


@dataclass
class _Stream:
    """Messages of a topic of images, as one pass over them shows."""

    stamps: IntArray
    """(K,): of the headers, ns."""
    logged: IntArray
    """(K,): times of the log, ns."""
    repeats: IntArray
    """Places of messages that repeat the one before, stamp and all."""
    sample: list[Any]
    """Some of them."""

    def size(self, path: Path) -> tuple[int, int]:
        """Width and height of the first image that can be read, px; zero: of none."""
        for message in self.sample:
            try:
                return size_of_message(message, path)
            except BrokenPair:  # met when it is read
                continue
        return 0, 0


def _stream(reader: Any, topic: str) -> _Stream:
    connections = [c for c in reader.connections if c.topic == topic]
    every = max(1, sum(c.msgcount for c in connections) // _SAMPLE)
    stamps, logged, repeats, sample, before = [], [], [], list[Any](), b""
    for at, (connection, time, raw) in enumerate(reader.messages(connections)):
        stamps.append(_stamp(raw) if len(raw) >= 12 else 0)
        logged.append(time)
        if raw == before:
            repeats.append(at)
        if at % every == 0 and len(sample) < _SAMPLE:
            try:
                sample.append(reader.deserialize(raw, connection.msgtype))
            except Exception as error:  # of a message that is not what its type says; met when it is read
                log.debug("%s: %s", topic, error)
        before = raw
    times, log_times, places = (np.array(numbers, dtype=np.int64) for numbers in (stamps, logged, repeats))
    return _Stream(times, log_times, places, sample)


def _stamp(raw: bytes) -> int:
    """Stamp of a header, ns: after four bytes (ROS 1: a number; ROS 2: the encapsulation) come seconds, nanoseconds."""
    seconds, nanoseconds = np.frombuffer(raw[4:12], dtype="<u4")
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _chosen(count: int, path: Path, choice: Choice) -> slice:
    first, last = choice.first or 0, count - 1 if choice.last is None else choice.last
    if not first <= min(last, count - 1):
        raise ValueError(f"first={choice.first}, last={choice.last} select no frame of {path}: it has {count}")
    return slice(first, last + 1)


def _pairs(path: Path, eyes: tuple[str, str], streams: tuple[_Stream, _Stream]) -> tuple[IntArray, IntArray, list[str]]:
    """Times of the pairs (K,), ns, the places of their messages (K, 2), and notes."""
    times_by_stream = [message_times(stream.stamps, stream.logged) for stream in streams]
    by_log = any(times is stream.logged for (times, _, _), stream in zip(times_by_stream, streams, strict=True))
    notes = [
        f"{path}, {plain(eye)}: {note}"
        for eye, (_, _, more) in zip(eyes, times_by_stream, strict=True)
        for note in more
    ]
    of_eye, shift = [], LARGEST_SHIFT_NS
    for eye, stream, (times, kept_places, _) in zip(eyes, streams, times_by_stream, strict=True):
        times = stream.logged if by_log else times
        places = np.flatnonzero(kept_places & ~np.isin(np.arange(len(times)), stream.repeats))
        _, once = np.unique(times[places], return_index=True)
        if odd := len(places) - len(once):
            notes.append(f"{path}, {plain(eye)}: {odd} of {len(times)} images repeat a stamp: the first of each counts")
        of_eye.append((times[places[once]], places[once]))
    (left, left_places), (right, right_places) = of_eye
    if by_log and len(left) > 1:
        require_rate(1e-9 * (left - left[0]), f"{path}, {plain(eyes[0])}, times of the log")
        shift = min(LARGEST_LOG_SHIFT_NS, int(np.median(np.diff(left))) // 2)
    if left.size and right.size:
        after = np.clip(np.searchsorted(right, left), 0, len(right) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(np.abs(right[after] - left) < np.abs(right[before] - left), after, before)
        near = np.flatnonzero(np.abs(right[nearest] - left) <= shift)
        _, once = np.unique(nearest[near], return_index=True)
        if (at := near[once]).size:
            places = np.column_stack([left_places[at], right_places[nearest[at]]])
            return left[at], places, notes
    raise ValueError(
        f"{path} has {left.size} images on {plain(eyes[0])}, {right.size} on {plain(eyes[1])}, and none are taken "
        f"within {shift // 1_000_000} ms: are the cameras synchronised?"
    )
