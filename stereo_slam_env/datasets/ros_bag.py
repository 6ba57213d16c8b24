"""Stereo images in a ROS bag: ROS 1 `.bag`, ROS 2 `.db3` or `.mcap` and their folder, through `rosbags` (extra `bags`).

The pair of cameras is found by their CameraInfo: the right one has P = K [I | -b, 0, 0]; where there is none and the
rig is given, by their names. Images of a topic with "rect" in its name are taken as rectified; others are rectified by
D, K, R and P of CameraInfo, where that is needed. Images belong together by the stamps of their headers. Inertial
samples and odometry: see `bag_motion`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from filters import BodyVelocity, InertialSamples, Start, StereoCamera
from filters.contract.extras import require_module
from filters.contract.foreign_text import plain
from filters.geometry.arrays import IntArray
from stereo_slam_env.datasets.bag_motion import BagMotion, motion_of_bag
from stereo_slam_env.datasets.image_files import MAX_PIXELS, BrokenPair, decoded_grey
from stereo_slam_env.datasets.sequence import Choice, Faults
from stereo_slam_env.recording.inertial import joined
from stereo_slam_env.recording.recording import NO_REFERENCE, GreyImage, StereoPair
from stereo_slam_env.recording.trajectory_bags import opened_bag
from stereo_slam_env.sensing.lenses import Rectification
from stereo_slam_env.sensing.rig_files import Calibration, calibration_of_infos
from stereo_slam_env.sensing.rigs import Rig, calibration_of

NAME = "ros_bag"
FILES = (("metadata.yaml", "*.db3"), ("metadata.yaml", "*.mcap"))
SUFFIXES = (".bag", ".db3", ".mcap")
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO = "sensor_msgs/msg/CameraInfo"
LARGEST_SHIFT_NS = 5_000_000
"""Images of one pair have stamps no further apart."""
_CHANNELS = {"mono8": 1, "8UC1": 1, "bgr8": 3, "rgb8": 3, "8UC3": 3, "bgra8": 4, "rgba8": 4, "mono16": 2, "16UC1": 2}
"""Bytes of a pixel."""
_BAYER = ("bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8")


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
        infos = _infos(reader)
        eyes = _cameras(path, topics, infos, left, right, by_name=rig is not None)
        pairs = _chosen(_pairs(path, eyes, [_stamps(reader, topic) for topic in eyes]), path, choice)
        calibration = calibration_of(rig) if rig is not None else _calibration(path, eyes, infos)
        turn = calibration.R_left if isinstance(calibration, Rectification) and calibration.needed else np.eye(3)
        times = 1e-9 * np.asarray(pairs[:, 0], dtype=np.float64)
        motion = motion_of_bag(reader, path, eyes[0], times, turn, imu, odometry)
    return BagSequence(path, eyes, calibration, pairs, choice, motion)


class BagSequence:
    """An `ImageSequence` of two topics of a bag; images are read pair by pair."""

    start, truth_from = Start(), NO_REFERENCE

    def __init__(
        self,
        path: Path,
        eyes: tuple[str, str],
        calibration: Calibration,
        pairs: IntArray,
        choice: Choice,
        motion: BagMotion,
    ) -> None:
        first = choice.first or 0
        self._pairs, self._motion = pairs, motion
        self._seconds = 1e-9 * (pairs[:, 0] - pairs[0, 0])
        self._path, self._eyes, self._on_broken = path, eyes, choice.on_broken
        self._rectify = calibration if isinstance(calibration, Rectification) and calibration.needed else None
        self.name = path.stem
        self.camera = calibration if isinstance(calibration, StereoCamera) else calibration.camera
        self.source: Mapping[str, Any] = {
            "reader": NAME,
            "path": str(path.resolve()),
            "topics": list(eyes),
            "first": first,
            "last": first + len(self._pairs) - 1,
            "on_broken": choice.on_broken,
            "epoch_s": 1e-9 * int(self._pairs[0, 0]),
            **motion.source,
        }
        self._skipped: Mapping[str, int] = {}

    @property
    def skipped(self) -> Mapping[str, int]:
        """Reason -> number of pairs left out, known once all pairs were read."""
        return dict(self._skipped)

    @property
    def R_left(self) -> Any:
        """(3, 3): from the left camera as it is mounted to the rectified one."""
        return np.eye(3) if self._rectify is None else self._rectify.R_left

    def __len__(self) -> int:
        """Number of pairs; where broken ones are skipped, those are still counted."""
        return len(self._pairs)

    def pairs(self) -> Iterator[StereoPair]:
        """The pairs in time order; may be called again. A `BrokenPair` unless those are skipped."""
        faults = Faults(self._on_broken)
        wanted = [set(column.tolist()) for column in self._pairs.T]
        waiting: tuple[dict[int, Any], dict[int, Any]] = ({}, {})
        number, used = 0, -1  # the pair at hand, and the last one that was good
        with opened_bag(self._path) as reader:
            chosen = [c for c in reader.connections if c.topic in self._eyes]
            for connection, _, raw in reader.messages(chosen):
                eye, stamp = self._eyes.index(connection.topic), _stamp(raw)
                if stamp not in wanted[eye]:
                    continue
                waiting[eye][stamp] = (connection.msgtype, raw)
                while number < len(self._pairs) and all(
                    int(self._pairs[number, eye]) in waiting[eye] for eye in (0, 1)
                ):
                    times = [int(time) for time in self._pairs[number]]
                    both = [waiting[eye].pop(times[eye]) for eye in (0, 1)]
                    try:
                        images = [self._image(reader, topic, *one) for topic, one in zip(self._eyes, both, strict=True)]
                    except BrokenPair as fault:
                        faults.meet(fault)
                    else:
                        left, right = images if self._rectify is None else self._rectify(images[0], images[1])
                        yield StereoPair(float(self._seconds[number]), left, right, None, *self._step(used, number))
                        used = number
                    number += 1
        self._skipped = dict(faults.counts)

    def _step(self, begin: int, end: int) -> tuple[BodyVelocity | None, InertialSamples | None]:
        """Odometry and inertial samples from pair `begin` to pair `end`; nothing before the first."""
        if begin < 0:
            return None, None
        epoch, t = float(self.source["epoch_s"]), self._seconds
        steps = self._motion.inertial[begin + 1 : end + 1]
        samples = joined(steps, np.diff(t[begin : end + 1])) if steps else None
        return self._motion.step(epoch + t[begin], epoch + t[end]), samples

    def _image(self, reader: Any, topic: str, kind: str, raw: bytes) -> GreyImage:
        size = self.camera.width, self.camera.height
        try:
            message = reader.deserialize(raw, kind)
        except Exception as error:  # of a message that is not what its type says
            raise BrokenPair(
                "image damaged", f"{self._path}: an image of {topic} is damaged: record it again"
            ) from error
        if kind.endswith("CompressedImage"):
            return decoded_grey(self._path / topic.strip("/"), bytes(message.data), size)
        return grey_of(message, size, f"{self._path}: an image of {topic}")


def grey_of(message: Any, size: tuple[int, int], what: str) -> GreyImage:
    """Grey values (H, W) of a `sensor_msgs/Image`; a `BrokenPair` that begins with `what` says why it is none."""
    import cv2

    encoding, found = str(message.encoding), (int(message.width), int(message.height))
    channels = 1 if encoding in _BAYER else _CHANNELS.get(encoding)
    if channels is None:
        known = ", ".join([*_CHANNELS, *_BAYER])
        raise BrokenPair("image unreadable", f"{what} has the encoding {plain(encoding)!r}: known are {known}")
    if found != size:
        said = f"{what} is {found[0]}x{found[1]} where CameraInfo says {size[0]}x{size[1]}: calibrate for these images"
        raise BrokenPair("image of another size", said)
    step, data = int(message.step), np.asarray(message.data, dtype=np.uint8)
    if found[0] * found[1] > MAX_PIXELS or step < found[0] * channels or data.size < step * found[1]:
        raise BrokenPair("image damaged", f"{what} has {data.size} bytes, too few for its size: record it again")
    rows = data[: step * found[1]].reshape(found[1], step)[:, : found[0] * channels]
    if encoding in _BAYER:
        pattern = {"rggb": "BayerBG2GRAY", "bggr": "BayerRG2GRAY", "gbrg": "BayerGR2GRAY", "grbg": "BayerGB2GRAY"}
        return np.asarray(
            cv2.cvtColor(np.ascontiguousarray(rows), getattr(cv2, f"COLOR_{pattern[encoding[6:10]]}")), np.uint8
        )
    if channels == 1:
        return np.ascontiguousarray(rows)
    if channels == 2:  # the high byte: grey values of 16 bits are told apart by 8
        return np.ascontiguousarray(rows[:, 0 if message.is_bigendian else 1 :: 2])
    code = cv2.COLOR_RGB2GRAY if encoding.startswith("rgb") else cv2.COLOR_BGR2GRAY
    colours = rows.reshape(found[1], found[0], channels)[..., :3]
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(colours), code), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class _Info:
    """First CameraInfo of a topic."""

    topic: str
    message: Any

    @property
    def shift(self) -> float:
        """Fourth number of P, -fx b of a right camera, px m."""
        return float(self.message.P[3] if hasattr(self.message, "P") else self.message.p[3])


def _infos(reader: Any) -> dict[str, _Info]:
    """CameraInfo by the name space of its topic."""
    found: dict[str, _Info] = {}
    connections = [c for c in reader.connections if c.msgtype == INFO]
    for connection in connections:
        for _, _, raw in reader.messages([connection]):
            found[connection.topic.rpartition("/")[0]] = _Info(connection.topic, reader.deserialize(raw, INFO))
            break
    return found


def _info_of(infos: Mapping[str, _Info], topic: str) -> _Info | None:
    parts = topic.split("/")
    return next((infos[name] for n in range(len(parts) - 1, 0, -1) if (name := "/".join(parts[:n])) in infos), None)


def _cameras(
    path: Path,
    topics: Mapping[str, str],
    infos: Mapping[str, _Info],
    left: str | None,
    right: str | None,
    *,
    by_name: bool,
) -> tuple[str, str]:
    """Topics of the left and of the right images: by CameraInfo, or else, if that will do, by their names."""
    images = sorted(topic for topic, kind in topics.items() if kind in IMAGES)
    if not images:
        raise ValueError(
            f"{path} holds no images, on none of its {len(topics)} topics: give one with a stereo pair (poses alone "
            "are judged by `stereo-slam evaluate`)"
        )
    listed = ", ".join(map(plain, images))
    for asked in (left, right):
        if asked is not None and asked not in images:
            raise ValueError(f"{path} has no images on {asked!r}; topics with images: {listed}")
    if left is not None and right is not None:
        return left, right
    of_eye: tuple[list[str], list[str]] = ([], [])
    for topic in images:
        info = _info_of(infos, topic)
        if info is not None and not any(word in topic for word in ("depth", "disparity", "mask")):
            of_eye[info.shift < 0].append(topic)
    lefts = [left] if left is not None else of_eye[0]
    rights = [right] if right is not None else of_eye[1]
    best = [(a, b) for b in rights for a in lefts if _alike(a, b)]
    if not best and by_name:
        called = [(a, b) for a in images for b in images if _called_left_and_right(a, b)]
        best = [(a, b) for a, b in called if left in (None, a) and right in (None, b)]
    best = [pair for pair in best if "rect" in pair[0]] or best
    best = [pair for pair in best if topics[pair[0]].endswith("/Image")] or best
    if len(best) != 1:
        why = f"{len(best)} pairs of cameras: name the topics (--image-topics LEFT,RIGHT)"
        if not best:
            why = "no pair of cameras whose CameraInfo makes them one rig (P[3] of the right one is -f b): give a rig"
        shifts = {topic: _info_of(infos, topic) for topic in images}
        listed = ", ".join(
            f"{plain(topic)} with {'no CameraInfo' if info is None else f'P[3] = {info.shift:g}'}"
            for topic, info in shifts.items()
        )
        raise ValueError(f"{path} holds {why}; images: {listed}")
    return best[0]


def _alike(left: str, right: str) -> bool:
    """Whether two topics differ as left and right do: in one part of their names, or by a digit or word in it."""
    a, b = left.split("/"), right.split("/")
    return len(a) == len(b) and sum(one != other for one, other in zip(a, b, strict=True)) == 1


def _called_left_and_right(a: str, b: str) -> bool:
    """Whether two topics are `left` and `right`, or one digit apart as `cam0` and `cam1`, or `infra1` and `infra2`."""
    if a.replace("left", "right") == b != a:
        return True
    other = [(x, y) for x, y in zip(a, b, strict=False) if x != y]
    return len(a) == len(b) and other in ([("0", "1")], [("1", "2")])


def _calibration(path: Path, eyes: tuple[str, str], infos: Mapping[str, _Info]) -> Calibration:
    both = [_info_of(infos, topic) for topic in eyes]
    if both[0] is None or both[1] is None:
        raise ValueError(f"{path} has no CameraInfo of {' and '.join(map(plain, eyes))}: give the calibration as rig")
    rectified = all("rect" in topic.rpartition("/")[2] or "/image_rect" in topic for topic in eyes)
    where = f"{path}, {plain(both[1].topic)}"
    return calibration_of_infos((both[0].message, both[1].message), where, rectified=rectified)


def _stamp(raw: bytes) -> int:
    """Stamp of a header, ns: after four bytes (ROS 1: a number; ROS 2: the encapsulation) come seconds, nanoseconds."""
    seconds, nanoseconds = np.frombuffer(raw[4:12], dtype="<u4")
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _stamps(reader: Any, topic: str) -> IntArray:
    chosen = [c for c in reader.connections if c.topic == topic]
    return np.unique(np.array([_stamp(raw) for _, _, raw in reader.messages(chosen) if len(raw) >= 12], dtype=np.int64))


def _chosen(pairs: IntArray, path: Path, choice: Choice) -> IntArray:
    first, last = choice.first or 0, len(pairs) - 1 if choice.last is None else choice.last
    if not len(chosen := pairs[first : last + 1]):
        raise ValueError(f"first={choice.first}, last={choice.last} select no frame of {path}: it has {len(pairs)}")
    return chosen


def _pairs(path: Path, eyes: tuple[str, str], stamps: list[IntArray]) -> IntArray:
    """(K, 2): stamps of the images that belong together, ns."""
    left, right = stamps
    if left.size and right.size:
        after = np.clip(np.searchsorted(right, left), 0, len(right) - 1)
        before = np.maximum(after - 1, 0)
        nearest = np.where(np.abs(right[after] - left) < np.abs(right[before] - left), after, before)
        pairs = np.column_stack([left, right[nearest]])
        pairs = pairs[np.abs(pairs[:, 0] - pairs[:, 1]) <= LARGEST_SHIFT_NS]
        _, once = np.unique(pairs[:, 1], return_index=True)
        if once.size:
            return np.asarray(pairs[once], dtype=np.int64)
    raise ValueError(
        f"{path} has {left.size} images on {plain(eyes[0])}, {right.size} on {plain(eyes[1])}, and none are taken "
        f"within {LARGEST_SHIFT_NS // 1_000_000} ms: are the cameras synchronised?"
    )
