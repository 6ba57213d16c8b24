"""Covariances in the conventions of ROS: drawn errors have them, and our own readers take them back (8 s)."""

from dataclasses import replace

import numpy as np
import pytest

import stereo_slam_env as sse
from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.cli import app as cli
from stereo_slam_env.evaluation.ros_covariances import OPTICAL_TO_BASE, ros_covariances, write_ros_yaml
from stereo_slam_env.files.yaml_files import parse_yaml

VARIANCES = 1e-6 * np.array(
    [
        [1.0, 2.0, 4.0, 0.10, 0.20, 0.05],
        [4.0, 2.0, 9.0, 0.02, 0.04, 0.01],
        [1.0, 1.0, 1.0, 0.01, 0.01, 0.01],
        [2.0, 2.0, 2.0, 0.30, 0.60, 0.30],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.1, 0.1, 0.4, 0.001, 0.004, 0.001],
    ]
)
DRAWS = 40_000


def path(count=150):
    """A camera that drives along its z axis, turns left and right, and climbs."""
    poses = [Pose([1.0, 2.0, 3.0], rotations.exp_quaternion([0.3, -0.5, 0.2]))]
    for k in range(1, count):
        turn = 0.1 * np.array([0.05, 0.4 * np.sin(k / 20.0), 0.1])
        poses.append(poses[-1] @ Pose([0.02, -0.03, 0.6], rotations.exp_quaternion(turn)))
    positions, orientations = np.array([T.position for T in poses]), np.array([T.orientation for T in poses])
    return sse.Trajectory(positions, orientations, 5.0 + 0.1 * np.arange(count), gauge=None, name="odometry")


@pytest.fixture(scope="module")
def claimed():
    return sse.claim(path(), sse.DriftModel(VARIANCES))


def assert_sampled(errors, covariance):
    """The sample covariance of errors (N, 6) is the one claimed, within five standard errors of each entry."""
    variances = np.diag(covariance)
    band = 5.0 * np.sqrt((covariance**2 + np.outer(variances, variances)) / len(errors))
    assert (np.abs(errors.T @ errors / len(errors) - covariance) < band).all()


def turned_by(R, phi):
    """R Exp(phi) for each phi (N, 3)."""
    return R @ np.array([rotations.exp(angle) for angle in phi])


def logs(R):
    return np.array([rotations.log(one) for one in R])


@pytest.mark.parametrize("optical", [False, True])
def test_errors_of_poses_in_the_world_have_the_36_numbers(claimed, optical):
    """Errors are drawn in the body, as the model has them; ROS has positions and rotations in the fixed frame."""
    rng, k = np.random.default_rng(0), 120
    xi = rng.multivariate_normal(np.zeros(6), claimed.covariances[k], DRAWS)
    R = rotations.matrix(claimed.orientations[k])
    rotation = logs(turned_by(R, xi[:, 3:]) @ R.T)
    axes = OPTICAL_TO_BASE if optical else np.eye(3)
    errors = np.column_stack([xi[:, :3] @ R.T @ axes.T, rotation @ axes.T])
    assert_sampled(errors, ros_covariances(claimed, optical=optical).poses[k])


@pytest.mark.parametrize("optical", [False, True])
def test_errors_of_velocities_have_the_36_numbers(optical):
    """On a path whose steps all turn by half a radian, so that the axes before and after a step differ."""
    step, poses = Pose([0.1, -0.2, 0.6], rotations.exp_quaternion([0.2, 0.4, -0.2])), [Pose()]
    for _ in range(12):
        poses.append(poses[-1] @ step)
    positions, orientations = np.array([T.position for T in poses]), np.array([T.orientation for T in poses])
    circle = sse.Trajectory(positions, orientations, 0.1 * np.arange(13), gauge=None)
    model = sse.DriftModel(VARIANCES)
    xi = np.random.default_rng(1).multivariate_normal(
        np.zeros(6), model.covariances(circle, np.array([4]), np.array([5]))[0], DRAWS
    )
    true_turns = turned_by(step.R_wc, xi[:, 3:])
    axes = OPTICAL_TO_BASE if optical else np.eye(3)
    errors = np.column_stack([xi[:, :3] @ step.R_wc.T @ axes.T, logs(true_turns @ step.R_wc.T) @ axes.T]) / 0.1
    assert_sampled(errors, ros_covariances(sse.claim(circle, model), optical=optical).twist)


def test_an_optical_frame_has_x_right_y_down_z_forward():
    right, down, forward = np.eye(3) @ OPTICAL_TO_BASE.T
    np.testing.assert_array_equal([forward, right, down], [[1, 0, 0], [0, -1, 0], [0, 0, -1]])


def test_our_reader_of_ros_covariances_takes_them_back(claimed, tmp_path):
    rows = np.column_stack(
        [claimed.timestamps, claimed.positions, claimed.orientations, ros_covariances(claimed).poses.reshape(-1, 36)]
    )
    np.savetxt(tmp_path / "ros.txt", rows, fmt="%.17g")
    again = sse.load_trajectory(tmp_path / "ros.txt")
    assert len(again) == len(claimed)
    np.testing.assert_allclose(again.pose_covariances, claimed.pose_covariances, rtol=0.0, atol=1e-12)
    scale = np.abs(claimed.pose_covariances).max()
    assert scale > 1e-4


def test_the_file_is_yaml_with_all_digits(claimed, tmp_path):
    found = ros_covariances(claimed)
    write_ros_yaml(tmp_path / "ros.yaml", found)
    text = (tmp_path / "ros.yaml").read_text()
    content = parse_yaml(text)
    assert [entry["seconds"] for entry in content["pose_covariance"]] == [1.0, 10.0, pytest.approx(14.9)]
    for entry, row in zip(content["pose_covariance"], (10, 100, 149), strict=True):
        np.testing.assert_array_equal(np.array(entry["covariance"]).reshape(6, 6), found.poses[row])
        assert entry["metres"] == pytest.approx(row * np.linalg.norm([0.02, -0.03, 0.6]), rel=1e-4)
    twist = content["twist_covariance"]
    np.testing.assert_array_equal(np.array(twist["covariance"]).reshape(6, 6), found.twist)
    assert twist["seconds"] == pytest.approx(0.1)
    node = content["ekf_filter_node"]["ros__parameters"]
    assert node["odom0_config"] == 6 * [False] + 6 * [True] + 3 * [False]
    assert (node["odom0_differential"], node["odom0_relative"]) == (False, False)
    numbers = [*twist["covariance"], *(value for entry in content["pose_covariance"] for value in entry["covariance"])]
    assert {type(value) for value in numbers} == {float}  # 1e-06 without a point is a text in YAML 1.1


def test_whole_powers_of_ten_are_numbers_in_yaml(claimed, tmp_path):
    write_ros_yaml(tmp_path / "ros.yaml", replace(ros_covariances(claimed), twist=1e-6 * np.eye(6)))
    content = parse_yaml((tmp_path / "ros.yaml").read_text())
    assert content["twist_covariance"]["covariance"] == (1e-6 * np.eye(6)).ravel().tolist()


def test_twists_with_independent_errors_of_a_drift_without_memory_add_up_to_the_pose():
    """White errors of poses and a lasting drift are what the sum of twists gets wrong; increments alone it has."""
    walk = VARIANCES.copy()
    walk[0], walk[-1] = 1e-18, 0.0
    alone = ros_covariances(sse.claim(path(), sse.DriftModel(walk)))
    assert alone.integrated == pytest.approx(np.sqrt(np.trace(alone.poses[-1, :3, :3])), rel=1e-6)
    white = walk.copy()
    white[0] = 1e-4
    more = ros_covariances(sse.claim(path(), sse.DriftModel(white)))
    assert more.integrated > 2.0 * np.sqrt(np.trace(more.poses[-1, :3, :3]))


def test_the_twist_is_of_steps_of_the_usual_length():
    """A gap of a second, and a message that comes early, are no steps."""
    plain = path()
    times = plain.timestamps.copy()
    times[60:] += 1.0
    times[30] -= 0.08
    model = sse.DriftModel(VARIANCES)
    with_gap = sse.claim(sse.Trajectory(plain.positions, plain.orientations, times), model)
    np.testing.assert_allclose(
        np.diag(ros_covariances(with_gap).twist), np.diag(ros_covariances(sse.claim(plain, model)).twist), rtol=0.02
    )


def test_what_claims_nothing_is_refused(claimed):
    with pytest.raises(ValueError, match="odometry needs times, covariances and two poses: use `claim`"):
        ros_covariances(path())
    with pytest.raises(ValueError, match="two poses"):
        ros_covariances(claimed.rows(slice(0, 1)))


def test_the_command_writes_both_files(tmp_path, capsys):
    sse.save_trajectory(tmp_path / "drive.tum", path())
    sse.DriftModel(VARIANCES).write(tmp_path / "model.json")

    def command(*options):
        arguments = ["claim", tmp_path / "drive.tum", tmp_path / "model.json", "--out", tmp_path / "a.square", *options]
        code = cli.main([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    code, out, err = command("--ros", tmp_path / "ros.yaml")
    assert code == 0, err
    assert "the body drives along its z axis" in out
    before = parse_yaml((tmp_path / "ros.yaml").read_text())
    code, out, _ = command("--ros", tmp_path / "ros.yaml", "--optical")
    assert (code, "drives along" in out) == (0, False)
    after = parse_yaml((tmp_path / "ros.yaml").read_text())
    variances = [np.diag(np.reshape(file["twist_covariance"]["covariance"], (6, 6))) for file in (before, after)]
    np.testing.assert_allclose(variances[1], variances[0][[2, 0, 1, 5, 3, 4]])
    for options, message in (
        (("--optical",), "--optical turns the axes of --ros"),
        (("--ros", tmp_path / "ros.txt"), "--ros must end in .yaml"),
    ):
        code, _, err = command(*options)
        assert code == 2
        assert message in err
