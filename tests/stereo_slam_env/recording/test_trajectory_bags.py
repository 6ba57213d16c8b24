"""Poses on topics of bags, of every type that is read; others are listed with their types (2 s)."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import load_trajectory

pytest.importorskip("rosbags", reason="the extra bags is not installed")

COUNT, EPOCH = 12, 1_700_000_000
TIMES = EPOCH + 0.25 + np.arange(COUNT)
POSITIONS = np.column_stack([np.arange(COUNT), np.sin(np.arange(COUNT)), np.zeros(COUNT)])
HALF = 0.05 * np.arange(COUNT)
ORIENTATIONS = np.column_stack([np.zeros((COUNT, 2)), np.sin(HALF), np.cos(HALF)])


def write_bag(path: Path, count: int = COUNT, only: str = "") -> Path:
    """One topic a type of message; in its transforms `box` changes its parent, and `base` does not."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)

    def made(kind: str, *fields: Any) -> Any:
        return store.types[kind](*fields)

    def header(time: float, frame: str = "map") -> Any:
        stamp = made("builtin_interfaces/msg/Time", int(time), round(1e9 * (time % 1.0)))
        return made("std_msgs/msg/Header", stamp, frame)

    def point(k: int, kind: str = "Point") -> Any:
        return made(f"geometry_msgs/msg/{kind}", *POSITIONS[k])

    def turn(k: int) -> Any:
        return made("geometry_msgs/msg/Quaternion", *ORIENTATIONS[k])

    def pose(k: int) -> Any:
        return made("geometry_msgs/msg/Pose", point(k), turn(k))

    def stamped(k: int, time: float) -> Any:
        return made("geometry_msgs/msg/PoseStamped", header(time), pose(k))

    def transform(k: int, parent: str, child: str) -> Any:
        moved = made("geometry_msgs/msg/Transform", point(k, "Vector3"), turn(k))
        return made("geometry_msgs/msg/TransformStamped", header(TIMES[k], parent), child, moved)

    def path_of(count: int, stamps: bool) -> Any:
        poses = [stamped(k, TIMES[k] if stamps else 0) for k in range(count)]
        return made("nav_msgs/msg/Path", header(TIMES[count - 1]), poses)

    doubt, still = np.diag(np.arange(1.0, 7.0)).ravel(), made("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    at_rest = made("geometry_msgs/msg/Twist", still, still)

    def claimed(k: int) -> Any:
        return made("geometry_msgs/msg/PoseWithCovariance", pose(k), doubt)

    with Writer(path, version=9) as writer:
        topics: dict[str, Any] = {}

        def put(topic: str, kind: str, k: int, message: Any) -> None:
            if only not in topic:
                return
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], int(TIMES[k]) * 10**9, store.serialize_cdr(message, kind))

        for k in range(count):
            put("/pose", "geometry_msgs/msg/PoseStamped", k, stamped(k, TIMES[k]))
            at = made("geometry_msgs/msg/PointStamped", header(TIMES[k]), point(k))
            put("/point", "geometry_msgs/msg/PointStamped", k, at)
            put("/vicon", "geometry_msgs/msg/TransformStamped", k, transform(k, "map", "body"))
            links = [transform(k, "map", "base"), transform(k, "shelf" if k < 4 else "robot", "box")]
            put("/tf", "tf2_msgs/msg/TFMessage", k, made("tf2_msgs/msg/TFMessage", links))
            told = made("geometry_msgs/msg/PoseWithCovarianceStamped", header(TIMES[k]), claimed(k))
            put("/claimed", "geometry_msgs/msg/PoseWithCovarianceStamped", k, told)
            twist = made("geometry_msgs/msg/TwistWithCovariance", at_rest, np.zeros(36))
            odometry = made("nav_msgs/msg/Odometry", header(TIMES[k]), "base", claimed(k), twist)
            put("/odom", "nav_msgs/msg/Odometry", k, odometry)
            array = made("geometry_msgs/msg/PoseArray", header(TIMES[k]), [pose(k)])
            put("/array", "geometry_msgs/msg/PoseArray", k, array)
            put("/path", "nav_msgs/msg/Path", k, path_of(k + 1, True))
            put("/bare_path", "nav_msgs/msg/Path", k, path_of(k + 1, False))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "all")


TOPICS = ["/pose", "/point", "/vicon", "/path", "/bare_path", "/tf:map.base", "/claimed", "/odom"]


@pytest.mark.parametrize("topic", TOPICS)
def test_poses_are_those_of_the_topic(bag: Path, topic: str) -> None:
    found = load_trajectory(f"{bag}:{topic}")
    assert isinstance(found, Trajectory)
    np.testing.assert_allclose(found.positions, POSITIONS, atol=1e-12)
    if topic == "/point":
        assert not found.is_oriented
    else:
        np.testing.assert_allclose(found.orientations, ORIENTATIONS, atol=1e-12)
    assert (found.covariances is None) == (topic not in ("/claimed", "/odom"))
    if found.covariances is not None:  # of rotations about the axes of the world
        R = Rotation.from_quat(ORIENTATIONS[5]).as_matrix()
        np.testing.assert_allclose(found.covariances[5, :3, :3], np.diag([1.0, 2.0, 3.0]), atol=1e-12)
        np.testing.assert_allclose(found.covariances[5, 3:, 3:], R.T @ np.diag([4.0, 5.0, 6.0]) @ R, atol=1e-12)
    if topic == "/bare_path":
        assert found.timestamps is None
        assert "have no stamps" in found.notes[0]
    else:
        np.testing.assert_allclose(found.timestamps, TIMES, rtol=0, atol=1e-6)


@pytest.mark.parametrize("topic", ["/array", "/nothing"])
def test_a_topic_without_poses_is_refused_with_all_topics_and_types(bag: Path, topic: str) -> None:
    with pytest.raises(ValueError, match=r"several topics: ask for one by "):
        load_trajectory(bag)
    with pytest.raises(ValueError, match=rf"all has no poses on {topic}: ask for one by ") as error:
        load_trajectory(f"{bag}:{topic}")
    assert "topics with poses: /bare_path, /claimed, /odom, /path, /point, /pose, /vicon; " in str(error.value)
    assert "others: /array (geometry_msgs/msg/PoseArray)" in str(error.value)


def test_a_chain_with_two_parents_is_named(bag: Path) -> None:
    with pytest.raises(ValueError, match=r"map\.box \(box has the parents robot and shelf, which is no tree\)"):
        load_trajectory(f"{bag}:/tf:map.box")


def test_a_short_bag_of_one_topic_needs_no_name_of_it(tmp_path: Path) -> None:
    short = write_bag(tmp_path / "short", 2, "/pose")
    np.testing.assert_allclose(load_trajectory(short).positions, POSITIONS[:2], atol=1e-12)
    with pytest.raises(ValueError, match=r"no poses on /none: .*\(topics with poses: /pose\)"):
        load_trajectory(f"{short}:/none")
