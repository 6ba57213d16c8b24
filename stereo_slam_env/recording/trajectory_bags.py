"""Poses of a topic of a ROS bag: ROS 1 `.bag`, ROS 2 `.db3` and `.mcap`, through `rosbags` (extra `bags`).

A topic of transforms is asked for with the two frames, as evo has it: `FILE:/tf:map.base_link`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.extras import require_module
from filters.contract.foreign_text import first_line, plain
from filters.geometry.arrays import FloatArray
from filters.motions.model import POSE_SIZE
from stereo_slam_env.files.opening import require_regular
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_layouts import claim_of_ros
from stereo_slam_env.recording.trajectory_transforms import Link, links_of, listed, poses_between

_ENDINGS = (".bag", ".db3", ".mcap")
_TYPES = {
    "geometry_msgs/msg/PoseStamped": False,
    "geometry_msgs/msg/PoseWithCovarianceStamped": True,
    "nav_msgs/msg/Odometry": True,
}
"""Messages that hold a pose; whether a covariance stands beside it."""
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_STATIC = "tf_static"
_NOT_ROS = (("protobuf",), ("flatbuffer",), ("jsonschema",), ("ros1msg",))
"""Encodings of schemas in MCAP files that the library does not look for."""


def bag_and_topic(path: str | Path) -> tuple[Path, str | None] | None:
    """The bag and the topic that `FILE` or `FILE:/topic` names, None where no topic is; None of what is no bag."""
    parts = str(path).split(":")
    for count in range(len(parts), 0, -1):
        file, topic = ":".join(parts[:count]), ":".join(parts[count:])
        if file and (file.endswith(_ENDINGS) or (Path(file) / "metadata.yaml").is_file()):
            return Path(file), topic or None
    return None


def read_bag(path: Path, topic: str | None) -> Trajectory:
    """The poses of a topic; None: of the only topic that has any.

    Raises
    ------
    ValueError
        The bag is missing or damaged, or has no such topic: one line that names it.
    ImportError
        `rosbags` is missing.
    """
    require_module("rosbags", "bags")
    if not (path.is_file() or path.is_dir()):
        raise ValueError(f"{path} does not exist, or is no file: give a bag, or a trajectory as text")
    with opened_bag(path) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        name, _, pair = (topic or "").partition(":")
        asked = [c for c in types if topic and c.strip("/") == name.strip("/")]
        moving = transforms_of(reader) if pair or _TRANSFORMS in types.values() else {}
        if pair or [types[c] for c in asked] == [_TRANSFORMS]:
            return _of_transforms(path, name, pair, moving)
        with_poses = sorted(c for c, kind in types.items() if kind in _TYPES)
        offered = ", ".join(map(plain, with_poses)) or "none"
        offered += f"; transforms as /tf:PARENT.CHILD: {listed(moving)}" if moving else ""
        alike = [c for c in (asked if topic else with_poses) if c in with_poses]
        if len(alike) != 1:
            said = "poses on several topics" if alike else f"no poses on {topic}" if topic else "no topic of poses"
            raise ValueError(f"{path} has {said}: ask for one by {path}:TOPIC (topics with poses: {offered})")
        (wanted,) = alike
        rows, doubts = _rows(reader, wanted)
    if not rows:
        raise ValueError(f"{path} has no message on {wanted}: ask for another topic ({offered})")
    table = np.array(rows)
    order = np.argsort(table[:, 0], kind="stable")
    kept = order[np.concatenate([[True], np.diff(table[order, 0]) > 0])]
    claim: dict[str, Any] = {}
    if _TYPES[types[wanted]]:
        claim = claim_of_ros(table[kept, 4:8], np.array(doubts).reshape(-1, POSE_SIZE, POSE_SIZE)[kept])
    notes = [*claim.pop("notes", [])]
    if repeated := len(table) - len(kept):
        notes.append(f"{repeated} of {len(table)} messages repeat the time of the one before: the first counts")
    return _trajectory(path, wanted, table[kept], notes=tuple(notes), **claim)


def _of_transforms(path: Path, topic: str, pair: str, links: dict[str, Link]) -> Trajectory:
    """The poses of one frame in another."""
    try:
        table = poses_between(links, pair)
    except ValueError as error:
        raise ValueError(f"{path}, {topic}: {error}") from error
    return _trajectory(path, pair, table)


def _trajectory(path: Path, what: str, table: FloatArray, **about: Any) -> Trajectory:
    name = f"{path.stem}:{plain(what)}"
    try:
        return Trajectory(table[:, 1:4], table[:, 4:8], table[:, 0], name=name, gauge=None, **about)
    except ValueError as error:
        raise ValueError(f"{path}, {what}: {error}") from error


@contextmanager
def opened_bag(path: Path) -> Iterator[Any]:
    """The reader of a bag; whatever it or a message raises is damage, in one line."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    inside = path if path.is_dir() else None
    try:
        for file in [path] if inside is None else sorted(path.iterdir()):
            if not file.is_dir():
                require_regular(file, inside=inside)  # the library would wait for a pipe
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except ValueError:
        raise
    except Exception as error:  # of any library that it unpacks with
        if isinstance(error, KeyError) and error.args[:1] in _NOT_ROS:
            said = f"its schemas are {error.args[0]}, not ROS: convert it to messages of ROS 2"
            raise ValueError(f"{path} is an MCAP file that is not read: {said}") from error
        raise ValueError(
            f"{path} is damaged, or no bag ({first_line(error)}): copy it again, or repair it with the tools of ROS"
        ) from error


def _rows(reader: Any, topic: str) -> tuple[list[list[float]], list[Any]]:
    """Time and pose of each message, and its covariance where there is one."""
    rows, doubts = [], []
    for connection, _, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
        message = reader.deserialize(raw, connection.msgtype)
        stamp, pose = message.header.stamp, message.pose
        if _TYPES[connection.msgtype]:
            doubts.append(pose.covariance)
            pose = pose.pose
        p, q = pose.position, pose.orientation
        rows.append([stamp.sec + 1e-9 * stamp.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    return rows, doubts


def transforms_of(reader: Any) -> dict[str, Link]:
    """All transforms of a bag, whatever their topics are called, by the frame that they are of."""

    def told() -> Iterator[tuple[str, str, bool, list[float]]]:
        chosen = [c for c in reader.connections if c.msgtype == _TRANSFORMS]
        for connection, _, raw in reader.messages(chosen) if chosen else ():  # of no connections it gives all messages
            is_static = connection.topic.endswith(_STATIC)
            for one in reader.deserialize(raw, connection.msgtype).transforms:
                stamp, p, q = one.header.stamp, one.transform.translation, one.transform.rotation
                row = [stamp.sec + 1e-9 * stamp.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w]
                yield one.header.frame_id.strip("/"), one.child_frame_id.strip("/"), is_static, row

    return links_of(told())
