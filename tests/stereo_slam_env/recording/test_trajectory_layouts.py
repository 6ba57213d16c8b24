"""Layouts of trajectories that people bring: columns by name or number, bags, published samples (5 s)."""

from importlib.util import find_spec

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters.geometry import rotations
from stereo_slam_env.recording.trajectory_files import load_trajectory

from ..real_data import real_data

needs_rosbags = pytest.mark.skipif(find_spec("rosbags") is None, reason="needs rosbags (extra bags)")
POSES = np.array([[0.5, 1.0, 2.0, 3.0, 0.5, 0.5, 0.5, 0.5], [0.6, 1.5, 2.5, 3.5, 0.0, 0.6, 0.0, 0.8]])
MATRICES = np.concatenate([Rotation.from_quat(POSES[:, 4:]).as_matrix(), POSES[:, 1:4, None]], axis=2).reshape(2, 12)
UPPER = [(i, j) for i in range(3) for j in range(i, 3)]
COVARIANCE = np.array([[4.0, 0.1, 0.2], [0.1, 3.0, 0.3], [0.2, 0.3, 2.0]]), np.diag([7.0, 8.0, 9.0])
"""Of the position and of the rotation."""


def written(path, rows, header="", mark=" "):
    path.write_text(header + "".join(mark.join(f"{x:.17g}" for x in row) + "\n" for row in rows))
    return path


def blocks(first, second):
    return [*(first[i, j] for i, j in UPPER), *(second[i, j] for i, j in UPPER)]


def nanoseconds(rows):
    return [[1.5e18 + round(1e9 * row[0]), *row[1:4], row[7], *row[4:7]] for row in rows]


@pytest.mark.parametrize(
    ("name", "rows", "header", "mark"),
    [
        ("tum", POSES, "", " "),
        ("tum with tabs", POSES, "# made by hand\n", "\t"),
        ("tum with commas", POSES, "", ","),
        ("names in another order", POSES[:, [5, 6, 7, 4, 0, 3, 2, 1]], "qy;qz;qw;qx;time;z;y;x\n", ";"),
        ("numbers of KITTI with times", np.column_stack([POSES[:, 0], MATRICES]), "", " "),
        ("poses alone", POSES[:, 1:], "", " "),
        ("kitti", MATRICES, "", " "),
    ],
)
def test_poses_are_found_whatever_the_columns(tmp_path, name, rows, header, mark):
    found = load_trajectory(written(tmp_path / "est.txt", rows, header, mark))
    np.testing.assert_allclose(found.positions, POSES[:, 1:4])
    np.testing.assert_allclose(
        rotations.matrix(found.orientations).reshape(2, 9), MATRICES.reshape(2, 3, 4)[..., :3].reshape(2, 9), atol=1e-12
    )
    assert (found.timestamps is None) == (name in ("kitti", "poses alone"))
    if found.timestamps is not None:
        np.testing.assert_allclose(found.timestamps, POSES[:, 0])
    assert (found.covariances, found.gauge, found.notes) == (None, None, ())


EUROC = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]\n"
)


@pytest.mark.parametrize("others", [(), (9.0, 9.0, 9.0)])
@pytest.mark.parametrize("named", [True, False])
def test_euroc_and_tum_vi_have_nanoseconds_and_the_scalar_part_first(tmp_path, named, others):
    others = others if named or not others else (9.0,) * 9
    if not named and not others:
        pytest.skip("eight numbers without names are those of TUM")
    header = ",".join(EUROC.strip().split(",")[: 8 + len(others)]) + "\n" if named else ""
    rows = [[*row, *others] for row in nanoseconds(POSES)]
    found = load_trajectory(written(tmp_path / "data.csv", rows, header, ","))
    np.testing.assert_allclose(found.timestamps, 1.5e9 + POSES[:, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.orientations, POSES[:, 4:])
    np.testing.assert_allclose(found.positions, POSES[:, 1:4])


@pytest.mark.parametrize("named", [True, False])
def test_openvins_has_the_rotation_block_first(tmp_path, named):
    position, rotation = COVARIANCE
    header = "# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 Pt11 Pt12 Pt13 Pt22 Pt23 Pt33\n"
    rows = [[*row, *blocks(rotation, position)] for row in POSES]
    found = load_trajectory(written(tmp_path / "est.txt", rows, header if named else ""))
    assert found.tangent == "position-rotation"
    np.testing.assert_array_equal(
        found.covariances[1], np.block([[position, np.zeros((3, 3))], [np.zeros((3, 3)), rotation]])
    )


CNSPY = "t,tx,ty,tz,qx,qy,qz,qw,pxx,pxy,pxz,pyy,pyz,pzz,qrr,qrp,qry,qpp,qpy,qyy,est_err_type,err_representation\n"


@pytest.mark.parametrize("error", ["type1", "type2", "type4"])
def test_cnspy_says_what_its_errors_are(tmp_path, error):
    position, rotation = COVARIANCE
    rows = [",".join(map(str, [*row, *blocks(position, rotation), error, "theta_q"])) for row in POSES]
    (tmp_path / "est.csv").write_text(CNSPY + "\n".join(rows))
    if error == "type4":
        with pytest.raises(ValueError, match=r"errors \(type4, theta_q\) that are not read: give one of type1"):
            load_trajectory(tmp_path / "est.csv")
        return
    found = load_trajectory(tmp_path / "est.csv")
    R = Rotation.from_quat(POSES[1, 4:]).as_matrix() if error == "type2" else np.eye(3)
    np.testing.assert_allclose(found.covariances[1, 3:, 3:], R.T @ rotation @ R, atol=1e-12)
    np.testing.assert_array_equal(found.covariances[1, :3, :3], position)


def test_36_covariances_of_ros_are_about_the_axes_of_the_world(tmp_path):
    position, rotation = COVARIANCE
    full = np.block([[position, 0.5 * np.eye(3)], [0.5 * np.eye(3), rotation]])
    names = ["%time", "field.header.seq", *(f"field.pose.pose.position.{a}" for a in "xyz")]
    names += [f"field.pose.pose.orientation.{a}" for a in "xyzw"]
    names += [f"field.pose.covariance{i}" for i in range(36)] + [f"field.twist.covariance{i}" for i in range(36)]
    rows = [[row[0], k, *row[1:], *full.ravel(), *np.full(36, 5.0)] for k, row in enumerate(POSES)]
    found = load_trajectory(written(tmp_path / "odom.csv", rows, ",".join(names) + "\n", ","))
    T = np.block([[np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), Rotation.from_quat(POSES[1, 4:]).as_matrix().T]])
    np.testing.assert_allclose(found.covariances[1], T @ full @ T.T, atol=1e-12)
    assert "about the axes of the world" in found.notes[0]
    bare = load_trajectory(written(tmp_path / "odom.txt", [[*row, *full.ravel()] for row in POSES]))
    np.testing.assert_array_equal(bare.covariances, found.covariances)
    nothing = load_trajectory(written(tmp_path / "none.txt", [[*row, *np.zeros(36)] for row in POSES]))
    assert nothing.covariances is None
    assert "not known" in nothing.notes[-1]


def test_repeated_times_are_left_out_and_counted(tmp_path):
    rows = POSES[[0, 0, 1, 1, 1]].copy()
    rows[[1, 3], 1] = 77.0
    found = load_trajectory(written(tmp_path / "est.tum", rows))
    np.testing.assert_array_equal(found.timestamps, POSES[:, 0])
    assert found.positions[:, 0].tolist() == [1.0, 1.5]
    assert found.notes == ("3 of 5 rows repeat the time of the row before: the first counts",)


def test_rows_of_kitti_may_be_numbered_with_some_missing(tmp_path):
    found = load_trajectory(written(tmp_path / "est.txt", np.column_stack([[4, 9], MATRICES])))
    assert found.frame_numbers.tolist() == [4, 9]
    assert found.rows(slice(1, None)).frame_numbers.tolist() == [9]


@needs_rosbags
@pytest.mark.parametrize("name", ["a.bag", "a.db3", "a.mcap"])
def test_a_bag_that_is_none_is_refused_in_one_line(tmp_path, name):
    with pytest.raises(ValueError, match="does not exist"):
        load_trajectory(tmp_path / name)
    (tmp_path / name).write_bytes(b"no bag at all\n" * 9)
    with pytest.raises(ValueError, match=r"\A.*is damaged, or no bag.*\Z"):
        load_trajectory(tmp_path / name)


@pytest.mark.parametrize(
    ("path", "rows", "first"),
    [
        ("trajectories/cnspy_mc/ID1-pose-est-posorient-cov-run6.csv", 1499, 0.01),
        ("trajectories/euroc_v102/V102.txt", 803, 1403715529.112),
        ("trajectories/euroc_v102/V102_groundtruth.csv", 16702, 1403715524.907),
        ("trajectories/kitti_13_columns/09_estimate.txt", 1589, None),
        ("trajectories/openvins_mh04/mh04_openvins.txt", 1922, 1403638132.745),
        ("trajectories/smfeval_fast_lio2/est.smfeval", 310, 1710755138.356),
        ("trajectories/tum_fr2_desk/fr2_desk_groundtruth.txt", 20956, 1311868163.870),
        ("tumvi_gt/dataset-room1_512_16.csv", 16541, 1520530308.190),
        ("tartanair_v2_clip/pose_lcam_front.txt", 1360, None),
        pytest.param("bags/ROS_example.bag:S-PTAM", 5439, 1502792579.887, marks=needs_rosbags),
        pytest.param("bags/nav2_turtlebot.mcap:/amcl_pose", 135, 924.102, marks=needs_rosbags),
    ],
)
def test_published_samples_are_read(path, rows, first):
    found = load_trajectory(real_data("field") / path)
    assert len(found) == rows
    assert first is None or found.timestamps[0] == pytest.approx(first, abs=1e-3)


def test_rows_that_claim_nothing_are_left_out_and_counted(tmp_path):
    """All kinds of them: `test_pairs_of_files.py`."""
    lost = POSES.copy()
    lost[1, 4:] = 0.0
    left = load_trajectory(written(tmp_path / "null.tum", lost))
    assert len(left) == 1
    assert "1 of 2 rows claim nothing" in left.notes[0]


def test_a_covariance_that_grows_is_a_claim_however_large(tmp_path):
    doubts = [scale * np.eye(6) for scale in np.geomspace(400.0, 3000.0, len(POSES))]
    rows = [[*row, *doubt.ravel()] for row, doubt in zip(POSES, doubts, strict=True)]
    assert len(load_trajectory(written(tmp_path / "grows.txt", rows))) == len(POSES)


def test_one_triangle_of_a_covariance_is_mirrored(tmp_path):
    full = np.diag([4e-4] * 3 + [9e-6] * 3)
    full[0, 1] = full[1, 0] = 1e-4
    both, upper, lower = (
        load_trajectory(written(tmp_path / "est.txt", [[*row, *P.ravel()] for row in POSES])).covariances
        for P in (full, np.triu(full), np.tril(full))
    )
    np.testing.assert_array_equal(both, upper)
    np.testing.assert_array_equal(both, lower)


def test_matrices_of_4_by_4_and_a_byte_order_mark_are_read(tmp_path):
    T = np.tile(np.eye(4), (4, 1, 1))
    T[:, :3, 3] = np.arange(12).reshape(4, 3)
    bare = load_trajectory(written(tmp_path / "bare.txt", [pose.ravel() for pose in T]))
    numbered = load_trajectory(written(tmp_path / "numbered.txt", [[k, *pose.ravel()] for k, pose in enumerate(T)]))
    for read in (bare, numbered):
        np.testing.assert_array_equal(read.positions, T[:, :3, 3])
    path = written(tmp_path / "plain.tum", POSES)
    (tmp_path / "bom.tum").write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    np.testing.assert_array_equal(load_trajectory(tmp_path / "bom.tum").positions, load_trajectory(path).positions)
