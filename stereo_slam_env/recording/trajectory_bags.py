"""Poses of a topic of a ROS bag: ROS 1 `.bag`, ROS 2 `.db3` and `.mcap`, through `rosbags` (extra `bags`)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.foreign_text import first_line, plain
from filters.extras import require_module
from filters.motions.model import POSE_SIZE
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_layouts import about_fixed_axes, known_of_ros

_ENDINGS = (".bag", ".db3", ".mcap")
_TYPES = {
    "geometry_msgs/msg/PoseStamped": False,
    "geometry_msgs/msg/PoseWithCovarianceStamped": True,
    "nav_msgs/msg/Odometry": True,
}
"""Messages that hold a pose; whether a covariance stands beside it."""


def bag_and_topic(path: str | Path) -> tuple[Path, str | None] | None:
    """The bag and the topic that `FILE` or `FILE:/topic` names, None where no topic is; None of what is no bag."""
    name, _, topic = str(path).rpartition(":")
    for file, wanted in ((str(path), None), (name, topic)):
        if file and (file.endswith(_ENDINGS) or (Path(file) / "metadata.yaml").is_file()):
            return Path(file), wanted
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
        found = {c.topic: c.msgtype for c in reader.connections if c.msgtype in _TYPES}
        listed = ", ".join(plain(name) for name in sorted(found)) or "none"
        alike = [name for name in found if topic is None or name.strip("/") == topic.strip("/")]
        if len(alike) != 1:
            asked = f"no poses on {topic}" if topic else "poses on several topics, or on none"
            raise ValueError(f"{path} has {asked}: ask for one by {path}:TOPIC (topics with poses: {listed})")
        (wanted,) = alike
        rows, doubts = _rows(reader, wanted)
    if not rows:
        raise ValueError(f"{path} has no message on {wanted}: ask for another topic ({listed})")
    table = np.array(rows)
    table = table[np.argsort(table[:, 0], kind="stable")]
    covariances, notes = None, []
    if _TYPES[found[wanted]]:
        covariances = np.array(doubts).reshape(-1, POSE_SIZE, POSE_SIZE)[
            np.argsort(np.array(rows)[:, 0], kind="stable")
        ]
        if why := known_of_ros(covariances):
            covariances, notes = None, [why]
    kept = np.concatenate([[True], np.diff(table[:, 0]) > 0])
    if repeated := int(np.count_nonzero(~kept)):
        notes.append(f"{repeated} of {len(kept)} messages repeat the time of the one before: the first counts")
    table, covariances = table[kept], None if covariances is None else covariances[kept]
    if covariances is not None:
        covariances = about_fixed_axes(table[:, 4:8], covariances)
    name = f"{path.stem}:{plain(wanted)}"
    try:
        return Trajectory(
            table[:, 1:4], table[:, 4:8], table[:, 0], covariances, name=name, gauge=None, notes=tuple(notes)
        )
    except ValueError as error:
        raise ValueError(f"{path}, {wanted}: {error}") from error


@contextmanager
def opened_bag(path: Path) -> Iterator[Any]:
    """The reader of a bag; whatever it or a message raises is damage, in one line."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except ValueError:
        raise
    except Exception as error:  # of any library that it unpacks with
        raise ValueError(f"{path} is damaged, or no bag ({first_line(error)}): copy it again") from error


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
