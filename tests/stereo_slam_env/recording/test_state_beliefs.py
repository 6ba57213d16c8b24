"""Velocities and biases in text files and in trajectories that move (< 1 s)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import Pose
from stereo_slam_env.recording.state_beliefs import StateBelief
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import load_trajectory

EUROC = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    "v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], "
    "b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2]\n"
)
STATES = np.arange(1.0, 10.0)


def euroc(folder, header=EUROC, states=STATES, stamp=1.4e18):
    rows = [[stamp + 5e6 * k, k, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, *states] for k in range(4)]
    path = folder / "data.csv"
    path.write_text(header + "".join(",".join(f"{x:.17g}" for x in row) + "\n" for row in rows))
    return path


@pytest.mark.parametrize(("header", "stamp"), [(EUROC, 1.4e18), (EUROC, 0.0), ("", 1.4e18)])
def test_euroc_has_velocity_then_gyro_then_accelerometer_bias(tmp_path, header, stamp):
    found = load_trajectory(euroc(tmp_path, header, stamp=stamp))
    np.testing.assert_allclose(np.diff(found.timestamps), 0.005, rtol=1e-4)
    for k, name in enumerate(("velocity", "gyro-bias", "accelerometer-bias")):
        np.testing.assert_array_equal(found.states[name].values, np.tile(STATES[3 * k : 3 * k + 3], (4, 1)))
        assert found.states[name].covariances is None


def test_zeros_that_fill_a_place_are_no_biases(tmp_path):
    found = load_trajectory(euroc(tmp_path, states=[1.0, 2.0, 3.0, *[0.0] * 6]))
    assert set(found.states) == {"velocity"}
    assert "its gyro-bias is zero throughout, which fills a place: not read" in found.notes


def test_own_columns_have_deviations_behind_sigma(tmp_path):
    names = ["t", "tx", "ty", "tz", "qx", "qy", "qz", "qw", "sigma_vx", "sigma_vy", "sigma_vz", "vz", "vy", "vx"]
    rows = [[0.1 * k, k, 0, 0, 0, 0, 0, 1, 0.1, 0.2, 0.3, 7, 8, 9] for k in range(3)]
    (tmp_path / "est.csv").write_text("\n".join([",".join(names), *(",".join(map(str, row)) for row in rows)]))
    (velocity,) = load_trajectory(tmp_path / "est.csv").states.values()
    np.testing.assert_array_equal(velocity.values[1], [9.0, 8.0, 7.0])
    np.testing.assert_allclose(velocity.covariances[1], np.diag([0.01, 0.04, 0.09]))


def moving():
    states = {name: StateBelief(np.tile([1.0, 2.0, 3.0], (4, 1)), np.tile(np.diag([1.0, 4.0, 9.0]), (4, 1, 1)))
              for name in ("velocity", "gyro-bias")}  # fmt: skip
    return Trajectory(np.eye(4, 3), np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)), np.arange(4.0), states=states)


TURN = Rotation.from_rotvec([0.0, 0.0, np.pi / 2]).as_quat()


def test_a_world_that_turns_turns_velocities_and_no_biases():
    there = moving().moved(Pose([5.0, 0.0, 0.0], TURN), scale=2.0)
    np.testing.assert_allclose(there.states["velocity"].values[0], [-4.0, 2.0, 6.0], atol=1e-12)
    np.testing.assert_allclose(there.states["velocity"].covariances[0], np.diag([16.0, 4.0, 36.0]), atol=1e-12)
    np.testing.assert_array_equal(there.states["gyro-bias"].values, moving().states["gyro-bias"].values)


def test_covariances_turn_as_their_errors_do():
    """Along an axis that is turned by 30 degrees the deviation is that of the axis before."""
    R = Rotation.from_rotvec([0.0, 0.0, np.pi / 6])
    there = moving().moved(Pose([0.0, 0.0, 0.0], R.as_quat())).states["velocity"].covariances[0]
    for axis, variance in zip(R.as_matrix().T, (1.0, 4.0, 9.0), strict=True):
        assert axis @ there @ axis == pytest.approx(variance)


def test_another_body_turns_biases_and_loses_the_velocity_by_its_lever_arm():
    there = moving().of_body(Pose([0.0, 0.0, 0.0], TURN))
    np.testing.assert_allclose(there.states["gyro-bias"].values[0], [2.0, -1.0, 3.0], atol=1e-12)
    np.testing.assert_array_equal(there.states["velocity"].values, moving().states["velocity"].values)
    there = moving().of_body(Pose([0.1, 0.0, 0.0], TURN))
    assert set(there.states) == {"gyro-bias"}
    assert "its velocity is that of another point of the body" in there.notes[0]


def test_rows_have_their_states():
    part = moving().rows(np.array([2, 3]))
    assert part.states["velocity"].values.shape == (2, 3)
    assert part.states["velocity"].covariances.shape == (2, 3, 3)


@pytest.mark.parametrize(
    ("states", "reason"),
    [
        ({"speed": StateBelief(np.zeros((4, 3)))}, "states has no 'speed'"),
        ({"velocity": StateBelief(np.zeros((3, 3)))}, r"must have the shape \(4, 3\), got \(3, 3\)"),
        ({"velocity": StateBelief(np.zeros((4, 3)), np.zeros((4, 3)))}, r"must have the shape \(4, 3, 3\)"),
    ],
)
def test_states_of_another_shape_are_refused(states, reason):
    with pytest.raises(ValueError, match=reason):
        replace(moving(), states=states)
