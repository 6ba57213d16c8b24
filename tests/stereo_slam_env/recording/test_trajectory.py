"""Trajectories: definitions of the pose error, change of world, files of every format (1 s)."""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import LeftInvariant, Pose, QuaternionError, RightInvariant, RotationVectorError, jacobian, nees
from filters.geometry import rotations
from filters.motions.motion_model import CameraState
from stereo_slam_env.recording.trajectory import Trajectory, pose_errors, tangent_jacobian
from stereo_slam_env.recording.trajectory_files import load_trajectory, save_trajectory

TANGENTS = {
    "position-rotation": RotationVectorError(),
    "position-quaternion": QuaternionError(),
    "right": LeftInvariant(),
    "left": RightInvariant(),
}
"""Each definition, and the filters' own of the same error: the left-invariant error is that of a perturbation on the
right."""
T_OTHER = Pose(np.array([4.0, -2.0, 7.0]), Rotation.from_rotvec([0.3, -1.1, 0.4]).as_quat())


def random_trajectory(tangent="position-rotation", count=30, seed=0):
    """Poses up to 50 m from the origin, claimed to some centimetres and degrees; and true ones at such errors."""
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(count, 3)) * 50.0
    orientations = Rotation.random(count, random_state=1).as_quat()
    factor = rng.normal(size=(count, 6, 6)) * 0.03
    covariances = factor @ factor.swapaxes(1, 2) + 1e-5 * np.eye(6)
    times = 1.6e9 + 0.1 * np.arange(count)
    made = Trajectory(positions, orientations, times, covariances, tangent, body="left_camera")
    truth = Rotation.from_quat(orientations) * Rotation.from_rotvec(0.05 * rng.normal(size=(count, 3)))
    return made, (positions + 0.1 * rng.normal(size=(count, 3)), truth.as_quat())


def nees_of(trajectory, truth):
    return nees(trajectory.errors(*truth), trajectory.covariances)


@pytest.mark.parametrize("tangent", TANGENTS)
def test_an_error_is_that_of_the_filters_of_that_definition(tangent):
    """Its covariance, too, is that of the belief in other coordinates."""
    trajectory, (positions, orientations) = random_trajectory(tangent)
    errors = trajectory.errors(positions, orientations)
    J = tangent_jacobian(tangent, trajectory.positions, trajectory.orientations)
    for row in range(len(trajectory)):
        pose = trajectory.pose(row)
        camera = CameraState(pose.position, pose.orientation, np.zeros(3), np.zeros(3), {})
        error, covariance = TANGENTS[tangent].pose_error(
            camera, trajectory.covariances[row], positions[row], orientations[row]
        )
        np.testing.assert_allclose(errors[row], error, rtol=0, atol=1e-12)
        np.testing.assert_allclose(J[row] @ trajectory.covariances[row] @ J[row].T, covariance, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("tangent", TANGENTS)
def test_the_jacobian_of_a_definition_is_the_numerical_one(tangent):
    trajectory, _ = random_trajectory(tangent, count=3)
    J = tangent_jacobian(tangent, trajectory.positions, trajectory.orientations)
    for row in range(3):
        p, q = trajectory.positions[row], trajectory.orientations[row]

        def error(delta, p=p, q=q):
            turned = rotations.multiply(q, rotations.exp_quaternion(delta[3:]))
            return pose_errors(tangent, p[None], q[None], (p + delta[:3])[None], turned[None])[0]

        np.testing.assert_allclose(J[row], jacobian(error, 6), rtol=0, atol=1e-8)


@pytest.mark.parametrize("tangent", TANGENTS)
def test_a_change_of_world_changes_no_nees(tangent):
    trajectory, (positions, orientations) = random_trajectory(tangent)
    there = rotations.multiply(np.tile(T_OTHER.orientation, (len(positions), 1)), orientations)
    moved = nees_of(trajectory.moved(T_OTHER), (T_OTHER @ positions, there))
    np.testing.assert_allclose(moved, nees_of(trajectory, (positions, orientations)), rtol=1e-8)


@pytest.mark.parametrize("tangent", TANGENTS)
def test_another_frame_of_the_body_has_the_error_that_the_first_one_gives_it(tangent):
    """Small errors, so that the adjoint, which is of first order, is what they follow."""
    trajectory, _ = random_trajectory(tangent)
    small = 1e-5 * np.random.default_rng(3).normal(size=(len(trajectory), 6))
    shift, turn = small[:, :3], small[:, 3:]
    truth = replace(
        trajectory,
        positions=trajectory.positions + shift,
        orientations=rotations.multiply(trajectory.orientations, rotations.exp_quaternion(turn)),
    )
    here = nees_of(trajectory, (truth.positions, truth.orientations))
    there, moved = trajectory.of_body(T_OTHER), truth.of_body(T_OTHER)
    np.testing.assert_allclose(nees_of(there, (moved.positions, moved.orientations)), here, rtol=1e-3)
    np.testing.assert_allclose(there.pose(4).position, (trajectory.pose(4) @ T_OTHER).position)
    back = there.of_body(T_OTHER.inverse())
    np.testing.assert_allclose(back.covariances, trajectory.covariances, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("tangent", TANGENTS)
def test_what_is_written_with_covariances_is_read_with_the_same_nees(tmp_path, tangent):
    trajectory, truth = random_trajectory(tangent)
    save_trajectory(tmp_path / "est.square", trajectory)
    again = load_trajectory(tmp_path / "est.square")
    assert (again.tangent, again.gauge, again.body) == (tangent, "fixed", "left_camera")
    np.testing.assert_array_equal(again.positions, trajectory.positions)
    np.testing.assert_allclose(again.timestamps, trajectory.timestamps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(again.covariances, trajectory.covariances, rtol=1e-12, atol=1e-16)
    np.testing.assert_allclose(nees_of(again, truth), nees_of(trajectory, truth), rtol=1e-9)


def test_without_covariances_the_same_format_has_eight_columns(tmp_path):
    trajectory = Trajectory(np.arange(6.0).reshape(2, 3), np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)), np.array([0.0, 0.5]))
    save_trajectory(tmp_path / "truth.square", trajectory)
    assert "#%REPRESENTATION deterministic" in (tmp_path / "truth.square").read_text()
    assert load_trajectory(tmp_path / "truth.square").covariances is None


@pytest.mark.parametrize("ending", [".tum", ".kitti"])
def test_plain_formats_are_known_by_their_columns(tmp_path, ending):
    trajectory, _ = random_trajectory()
    save_trajectory(tmp_path / f"est{ending}", trajectory)
    again = load_trajectory(tmp_path / f"est{ending}")
    assert again.covariances is None
    assert (again.timestamps is None) == (ending == ".kitti")
    np.testing.assert_allclose(again.positions, trajectory.positions, rtol=0, atol=1e-9)
    turned = rotations.between(again.orientations, trajectory.orientations)
    np.testing.assert_allclose(turned, np.tile([0.0, 0.0, 0.0, 1.0], (len(again), 1)), rtol=0, atol=1e-8)


def test_the_order_of_the_tangent_is_what_the_header_says(tmp_path):
    trajectory, truth = random_trajectory("right")
    swapped = trajectory.covariances[:, [3, 4, 5, 0, 1, 2]][:, :, [3, 4, 5, 0, 1, 2]]
    other = Trajectory(trajectory.positions, trajectory.orientations, trajectory.timestamps, swapped, "right")
    save_trajectory(tmp_path / "est.square", other)
    text = (tmp_path / "est.square").read_text()
    (tmp_path / "est.square").write_text(text.replace("translation_rotation", "rotation_translation"))
    np.testing.assert_allclose(
        nees_of(load_trajectory(tmp_path / "est.square"), truth), nees_of(trajectory, truth), rtol=1e-9
    )


@pytest.mark.skipif(find_spec("smfeval") is None, reason="needs smfeval (extra dev)")
@pytest.mark.parametrize("tangent", TANGENTS)
def test_smfeval_reads_what_is_written(tmp_path, tangent):
    from smfeval.io import load_square

    trajectory, _ = random_trajectory(tangent)
    save_trajectory(tmp_path / "est.square", trajectory)
    header, steps = load_square(tmp_path / "est.square")
    assert header.tangent_convention.value == ("left_perturbation" if tangent == "left" else "right_perturbation")
    assert header.tangent_order.value == "translation_rotation"
    side = tangent if tangent == "left" else "right"
    J = tangent_jacobian(side, trajectory.positions, trajectory.orientations)
    wanted = J @ trajectory.pose_covariances @ J.swapaxes(1, 2)
    np.testing.assert_allclose([step.covariance for step in steps], wanted, rtol=1e-9, atol=1e-13)


SQUARE = "#%FORMAT SQUARE/0.3\n"


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("1 2\n4 5\n", "has 2 columns: a trajectory has 8"),
        ("", "has no rows: a trajectory has 8"),
        ("0 1 2 3 0 0 0 1" + 21 * " 1", "29 columns and no header: is the covariance of the right or the left"),
        ("0 1 2 3 0 0 0 2\n", "row 0 has length 2"),
        ("1 1 2 3 0 0 0 1\n0 1 2 3 0 0 0 1\n", "timestamps must ascend, row 1"),
        ("0 1 nan 3 0 0 0 1\n", "none of its 1 rows holds a pose"),
        ("0 1 2 3 0 0 0 x\n", "not a table of 8 numbers"),
        ("Dear reader,\nthis is a letter\n", "is no trajectory: its first row is 'Dear reader,'"),
        ("#%FORMAT TUM\n0 1 2 3 0 0 0 1\n", "without FORMAT SQUARE"),
        (f"{SQUARE}#%REPRESENTATION gaussian_se3\n0 1 2 3 0 0 0 1\n", "8 columns where its header has 29"),
        (f"{SQUARE}#%REPRESENTATION ensemble_se3\n0 1 2 3 0 0 0 1\n", "REPRESENTATION must be one of"),
        (
            f"{SQUARE}#%REPRESENTATION deterministic\n#%GAUGE so3\n0 1 2 3 0 0 0 1\n",
            "GAUGE must be one of fixed, .* 'so3'",
        ),
        (f"{SQUARE}{SQUARE}0 1 2 3 0 0 0 1\n", "two header lines FORMAT"),
    ],
)
def test_a_file_that_is_none_is_named_in_one_line(tmp_path, content, complaint):
    (tmp_path / "bad.txt").write_text(content)
    with pytest.raises(ValueError, match=rf"\A.*bad\.txt.*{complaint}.*\Z"):
        load_trajectory(tmp_path / "bad.txt")


def test_what_cannot_be_written_is_refused(tmp_path):
    trajectory, _ = random_trajectory()
    with pytest.raises(ValueError, match=r"must end in \.tum, \.kitti, \.square"):
        save_trajectory(tmp_path / "est.csv", trajectory)
    with pytest.raises(ValueError, match=r"none\.tum does not exist"):
        load_trajectory(tmp_path / "none.tum")
    untimed = Trajectory(trajectory.positions, trajectory.orientations)
    with pytest.raises(ValueError, match=r"has no timestamps: write it as \.kitti"):
        save_trajectory(tmp_path / "est.tum", untimed)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"covariances": np.eye(6)}, "covariances must have the shape"),
        ({"tangent": "middle"}, "tangent must be one of"),
        ({"gauge": "so3"}, "gauge must be one of"),
        ({"frame_numbers": np.array([3, 3])}, "frame_numbers must be 2 ascending"),
        ({"positions": np.zeros((0, 3)), "orientations": np.zeros((0, 4))}, "at least one pose"),
        ({"orientations": np.zeros((2, 4))}, "unit quaternions"),
        ({"positions": np.array([[0.0] * 3, [1e300] * 3])}, r"positions must be in m, below 1e\+12: row 1 has"),
    ],
)
def test_an_impossible_trajectory_is_refused(change, complaint):
    usual = {"positions": np.zeros((2, 3)), "orientations": np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))}
    with pytest.raises(ValueError, match=complaint):
        Trajectory(**usual | change)
