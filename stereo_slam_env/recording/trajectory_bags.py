"""Poses of a topic of a ROS bag: ROS 1 `.bag`, ROS 2 `.db3` and `.mcap`, through `rosbags` (extra `bags`).

A topic of transforms is asked for with the two frames, as evo has it: `FILE:/tf:map.base_link`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from filters.contract.extras import require_module
from filters.contract.validation import first_line, plain
from filters.geometry import rotations
from filters.geometry.arrays import IntArray
from filters.motions.motion_model import POSE_SIZE
from stereo_slam_env.files.bags import open_bag
from stereo_slam_env.files.opening import require_regular
from stereo_slam_env.recording.state_beliefs import StateBelief
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_layouts import message_times, require_rate
from stereo_slam_env.recording.trajectory_transforms import Link, assembled, links_of, listed, poses_between

BIAS = "imu_bias"
"""Name of a topic beside that of an odometry: biases (AccelStamped), gyros angular, accelerometers linear."""
_ODOMETRY = "nav_msgs/msg/Odometry"
_ENDINGS = (".bag", ".db3", ".mcap")
_Parts = tuple[Any, Any, Any]
"""Position, orientation or None, and 36 covariances or None, of a message."""
_TYPES: Mapping[str, Callable[[Any], _Parts]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation, None),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (m.pose.pose.position, *_turn_and_doubt(m.pose)),
    _ODOMETRY: lambda m: (m.pose.pose.position, *_turn_and_doubt(m.pose)),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation, None),
    "geometry_msgs/msg/PointStamped": lambda m: (m.point, None, None),
}
"""Messages that hold one pose, or a position."""
_PATH = "nav_msgs/msg/Path"
"""A message that holds a whole path: the last one of a topic counts."""
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_STATIC = "tf_static"
_SHOWN = 12
"""Other topics that a message lists."""
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
        matching_topics = [c for c in types if topic and c.strip("/") == name.strip("/")]
        if pair or [types[c] for c in matching_topics] == [_TRANSFORMS]:
            return _of_transforms(path, name, pair, transforms_of(reader))
        with_poses = sorted(c for c, kind in types.items() if kind in _TYPES or kind == _PATH)
        alike = [c for c in (matching_topics if topic else with_poses) if c in with_poses]
        if len(alike) != 1:
            said = "poses on several topics" if alike else f"no poses on {topic}" if topic else "no topic of poses"
            raise ValueError(f"{path} has {said}: ask for one by {path}:TOPIC ({_offered(reader, types, with_poses)})")
        (matched_topic,) = alike
        logged, messages = _messages(reader, matched_topic)
        _, beside = _messages(reader, biases) if (biases := f"{matched_topic}/{BIAS}") in types else ((), [])
    if not messages:
        raise ValueError(f"{path} has no message on {plain(matched_topic)}: ask for another topic")
    if types[matched_topic] == _PATH:
        messages = messages[-1].poses
        logged = np.zeros(len(messages), dtype=np.int64)
        parts = [_TYPES["geometry_msgs/msg/PoseStamped"](message) for message in messages]
    else:
        parts = [_TYPES[types[matched_topic]](message) for message in messages]
    if not parts:
        raise ValueError(f"{path}, {plain(matched_topic)}: its last path is empty: ask for another topic")
    stamps = np.array([stamp_of(message) for message in messages], dtype=np.int64)
    times, kept_rows, notes = message_times(stamps, logged)
    order = np.flatnonzero(kept_rows)[np.argsort(times[kept_rows], kind="stable")]
    positions = np.array([[p.x, p.y, p.z] for p, _, _ in parts], dtype=np.float64)[order]
    orientations, covariances = None, None
    if parts[0][1] is not None:
        orientations = np.array([[q.x, q.y, q.z, q.w] for _, q, _ in parts], dtype=np.float64)[order]
    if parts[0][2] is not None:
        covariances = np.array([doubt for _, _, doubt in parts], dtype=np.float64)[order]
        covariances = covariances.reshape(-1, POSE_SIZE, POSE_SIZE)
    seconds = None
    if types[matched_topic] == _PATH and times is logged:  # its poses have no log of their own
        notes = ["its poses have no stamps: they belong to those of the other one by their order"]
    else:
        seconds = np.asarray(1e-9 * times[order], dtype=np.float64)
        require_rate(seconds, f"{path}, {plain(matched_topic)}")
    trajectory = assembled(
        f"{path}, {plain(matched_topic)}",
        positions,
        orientations,
        by_ros=True,
        timestamps=seconds,
        covariances=covariances,
        name=f"{path.stem}:{plain(matched_topic)}",
        gauge=None,
        notes=notes,
    )
    if types[matched_topic] != _ODOMETRY or len(trajectory) != len(order):
        return trajectory
    return replace(trajectory, states=_states_of(trajectory, [messages[k] for k in order], beside))


def _states_of(trajectory: Trajectory, odometry: Sequence[Any], beside: Sequence[Any]) -> dict[str, StateBelief]:
    """Velocities by the twists, which are along the axes of the body, and biases of the same stamps beside them."""
    states = {}
    twists = np.array([vector_of(one.twist.twist.linear) for one in odometry])
    if trajectory.is_oriented and np.nan_to_num(twists).any():  # zeros throughout fill a place
        R = Rotation.from_quat(trajectory.orientations).as_matrix()
        P = np.array([one.twist.covariance for one in odometry]).reshape(-1, POSE_SIZE, POSE_SIZE)[:, :3, :3]
        claimed = np.isfinite(P).all() and bool((np.linalg.eigvalsh(P) > 0.0).all())
        values = rotations.turned(R, twists)
        states["velocity"] = StateBelief(values, R @ P @ R.swapaxes(1, 2) if claimed else None)
    if beside:
        by_stamp = {stamp_of(one): (vector_of(one.accel.angular), vector_of(one.accel.linear)) for one in beside}
        none = (3 * (np.nan,), 3 * (np.nan,))
        biases = np.array([by_stamp.get(stamp_of(one), none) for one in odometry])
        states |= {name: StateBelief(biases[:, k]) for k, name in enumerate(("gyro-bias", "accelerometer-bias"))}
    return states


def stamp_of(message: Any) -> int:
    """Time of the header of a message, ns."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def vector_of(of: Any) -> tuple[float, float, float]:
    """Three numbers of a vector or a point."""
    return of.x, of.y, of.z


def _offered(reader: Any, types: Mapping[str, str], with_poses: Sequence[str]) -> str:
    """Topics that could be asked for, and all others with their types."""
    offered = "topics with poses: " + (", ".join(map(plain, with_poses)) or "none")
    if _TRANSFORMS in types.values():
        offered += f"; transforms as /tf:PARENT.CHILD: {listed(transforms_of(reader))}"
    other_topics = [f"{plain(c)} ({plain(kind)})" for c, kind in sorted(types.items()) if c not in with_poses]
    return offered + (
        f"; others: {', '.join(other_topics[:_SHOWN])}" + (", ..." if other_topics[_SHOWN:] else "")
        if other_topics
        else ""
    )


def _of_transforms(path: Path, topic: str, pair: str, links: dict[str, Link]) -> Trajectory:
    """The poses of one frame in another."""
    try:
        table = poses_between(links, pair)
    except ValueError as error:
        raise ValueError(f"{path}, {topic}: {error}") from error
    what = f"{path}, {plain(pair)}"
    require_rate(table[:, 0], what)
    name = f"{path.stem}:{plain(pair)}"
    return assembled(what, table[:, 1:4], table[:, 4:8], timestamps=table[:, 0], name=name, gauge=None)


@contextmanager
def opened_bag(path: Path) -> Iterator[Any]:
    """The reader of a bag; whatever it or a message raises is damage, in one line."""
    inside = path if path.is_dir() else None
    try:
        for file in [path] if inside is None else sorted(path.iterdir()):
            if not file.is_dir():
                require_regular(file, inside=inside)  # the library would wait for a pipe
        with open_bag(path) as reader:
            yield reader
    except ValueError:
        raise
    except Exception as error:  # of any library that it unpacks with
        if isinstance(error, KeyError) and error.args[:1] in _NOT_ROS:
            message = f"its schemas are {error.args[0]}, not ROS: convert it to messages of ROS 2"
            raise ValueError(f"{path} is an MCAP file that is not read: {message}") from error
        raise ValueError(
            f"{path} is damaged, or no bag ({first_line(error)}): copy it again, or repair it with the tools of ROS"
        ) from error


def _turn_and_doubt(pose: Any) -> tuple[Any, Any]:
    return pose.pose.orientation, pose.covariance


def _messages(reader: Any, topic: str) -> tuple[IntArray, list[Any]]:
    """Times of the log (K,), ns, and the messages of a topic, in the order of the log."""
    logged, messages = [], []
    for connection, at, raw in reader.messages([c for c in reader.connections if c.topic == topic]):
        logged.append(at)
        messages.append(reader.deserialize(raw, connection.msgtype))
    return np.array(logged, dtype=np.int64), messages


def transforms_of(reader: Any) -> dict[str, Link]:
    """All transforms of a bag, whatever their topics are called, by the frame that they are of."""

    def told() -> Iterator[tuple[str, str, bool, list[float]]]:
        connections = [c for c in reader.connections if c.msgtype == _TRANSFORMS]
        for connection, _, raw in (
            reader.messages(connections) if connections else ()
        ):  # of no connections it gives all messages
            is_static = connection.topic.endswith(_STATIC)
            for one in reader.deserialize(raw, connection.msgtype).transforms:
                stamp, p, q = one.header.stamp, one.transform.translation, one.transform.rotation
                row = [stamp.sec + 1e-9 * stamp.nanosec, p.x, p.y, p.z, q.x, q.y, q.z, q.w]
                yield one.header.frame_id.strip("/"), one.child_frame_id.strip("/"), is_static, row

    return links_of(told())
