"""The pose of one frame in another, through a tree of transforms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.recording.trajectory_transforms import links_of, listed, poses_between

TIMES = np.linspace(0.0, 10.0, 101)


def row(t, matrix):
    return [t, *matrix[:3, 3], *Rotation.from_matrix(matrix[:3, :3]).as_quat()]


def transform(x, yaw):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.1, -0.2, yaw]).as_matrix(), [x, 0.5 * x, -0.3]
    return T


def told():
    """Links map -> odom, once a second, odom -> base, ten times, and base -> camera, static; in no order."""
    rows = [("odom", "base", False, row(t, transform(t, 0.2 * t))) for t in TIMES]
    rows += [("map", "odom", False, row(t, transform(0.1 * t, 0.0))) for t in TIMES[::10]]
    rows.append(("base", "camera", True, row(0.0, transform(0.4, 0.3))))
    return [rows[k] for k in np.random.default_rng(0).permutation(len(rows))]


def test_a_chain_is_the_product_of_its_transforms_at_the_times_of_its_fastest_link():
    found = poses_between(links_of(told()), "map.camera")
    right = [row(t, transform(0.1 * t, 0.0) @ transform(t, 0.2 * t) @ transform(0.4, 0.3)) for t in TIMES]
    np.testing.assert_allclose(found[:, :4], np.array(right)[:, :4], atol=1e-12)
    between = Rotation.from_quat(found[:, 4:]).inv() * Rotation.from_quat(np.array(right)[:, 4:])
    assert between.magnitude().max() < 1e-7


def test_poses_are_those_of_the_time_that_all_links_know():
    late = [one for one in told() if one[1] != "odom" or one[3][0] >= 3.0]
    assert poses_between(links_of(late), "map.base")[[0, -1], 0].tolist() == [3.0, 10.0]


@pytest.mark.parametrize(
    ("pair", "reason"),
    [
        ("base.map", "no chain of transforms for base.map: ask for PARENT.CHILD"),
        ("", "ask for PARENT.CHILD"),
        ("base.camera", "is static"),
    ],
)
def test_what_is_no_pair_of_frames_is_refused_with_those_that_are(pair, reason):
    links = links_of(told())
    with pytest.raises(ValueError, match=reason) as refused:
        poses_between(links, pair)
    assert "map.base" in str(refused.value)
    assert "map.base" in listed(links)


def test_a_frame_with_two_parents_stops_only_the_chains_over_it():
    rows = [("odom", "base", False, row(t, np.eye(4))) for t in (0.0, 1.0)]
    rows += [("world", "box", False, row(0.0, np.eye(4))), ("base", "box", False, row(1.0, np.eye(4)))]
    links = links_of(rows)
    assert len(poses_between(links, "odom.base")) == 2
    with pytest.raises(ValueError, match="box has the parents base and world, which is no tree"):
        poses_between(links, "world.box")


def test_frames_in_a_ring_end():
    ring = [("a", "b", False, row(0.0, np.eye(4))), ("b", "a", False, row(0.0, np.eye(4)))]
    with pytest.raises(ValueError, match="no chain"):
        poses_between(links_of(ring), "c.d")
    assert len(poses_between(links_of(ring), "a.b")) == 1
