"""State files of OpenVINS: columns, its quaternions and errors, the deviations beside it (< 1 s)."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.recording.trajectory_files import load_trajectory

HEADER = "# timestamp(s) q p v bg ba cam_imu_dt num_cam cam0_k cam0_d cam0_rot cam0_trans ... etc\n"
TIMES = 1403636580.5 + 0.05 * np.arange(6)
R_WB = Rotation.from_rotvec(np.linspace([0.1, -0.2, 0.3], [1.0, 0.5, -0.4], 6))
OTHERS = np.arange(72.0).reshape(6, 12) / 10.0 + 0.1
"""Position, velocity and biases."""
SIGMAS = np.arange(1.0, 16.0) / 100.0


def jpl(R_GtoI):
    """Quaternion xyzw of JPL: R = (2 w^2 - 1) I - 2 w [v]x + 2 v v^T."""
    x, y, z, w = R_GtoI.as_quat()
    return np.array([-x, -y, -z, w])


def written(folder, times=TIMES, name="estimate", cameras=1):
    calibration = [0.0, cameras, *[1.0] * 15 * cameras]
    quaternions = [jpl(R.inv()) for R in R_WB]
    rows = np.column_stack([TIMES, quaternions, OTHERS, np.tile(calibration, (6, 1))])
    np.savetxt(folder / f"state_{name}.txt", rows, fmt="%.6f", header=HEADER[2:-1])
    deviations = np.column_stack([times, np.tile([*SIGMAS, 0.0, cameras], (len(times), 1))])
    np.savetxt(folder / "state_deviation.txt", deviations, fmt="%.6f", header=HEADER[2:-1])
    return folder / f"state_{name}.txt"


def test_jpl_is_read_as_it_is_defined():
    """The definition itself, of Trawny and Roumeliotis, eq. 78: what `jpl` writes above stands for R_GtoI."""
    q = jpl(R_WB[2].inv())
    v, w = q[:3], q[3]
    cross = np.cross(v, np.eye(3)).T  # [v]x
    R = (2 * w**2 - 1) * np.eye(3) - 2 * w * cross + 2 * np.outer(v, v)
    np.testing.assert_allclose(R, R_WB[2].inv().as_matrix(), atol=1e-12)


@pytest.mark.parametrize("cameras", [0, 1, 2])
def test_poses_velocities_and_biases_are_read_with_their_deviations(tmp_path, cameras):
    found = load_trajectory(written(tmp_path, cameras=cameras))
    np.testing.assert_allclose(found.timestamps, TIMES)
    np.testing.assert_allclose(Rotation.from_quat(found.orientations).as_matrix(), R_WB.as_matrix(), atol=1e-5)
    np.testing.assert_allclose(found.positions, OTHERS[:, :3])
    variances = np.diagonal(found.covariances, axis1=1, axis2=2)
    np.testing.assert_allclose(variances[3], SIGMAS[[3, 4, 5, 0, 1, 2]] ** 2)
    for k, name in enumerate(("velocity", "gyro-bias", "accelerometer-bias")):
        np.testing.assert_allclose(found.states[name].values, OTHERS[:, 3 + 3 * k : 6 + 3 * k])
        np.testing.assert_allclose(found.states[name].covariances[2], np.diag(SIGMAS[6 + 3 * k : 9 + 3 * k] ** 2))
    assert found.gauge == "gravity_yaw"
    assert "diagonal" in found.notes[0]


def test_an_error_is_that_of_its_update(tmp_path):
    """R_GtoI = Exp(-theta) R^_GtoI, by which `JPLQuat::update` turns an estimate: theta is the error of the pose."""
    found = load_trajectory(written(tmp_path))
    theta = np.array([1e-3, -2e-3, 3e-3])
    truth = [(Rotation.from_rotvec(-theta) * R.inv()).inv().as_quat() for R in R_WB]
    errors = found.errors(found.positions, np.array(truth))
    np.testing.assert_allclose(errors[:, 3:], np.tile(theta, (6, 1)), atol=3e-6)


def test_deviations_of_other_times_leave_poses_without_a_claim_out(tmp_path):
    found = load_trajectory(written(tmp_path, TIMES[1:4]))
    np.testing.assert_allclose(found.timestamps, TIMES[1:4])
    np.testing.assert_allclose(found.states["velocity"].values, OTHERS[1:4, 3:6])
    assert "3 of 6 rows have no deviations in state_deviation.txt" in found.notes


def test_deviations_that_six_decimals_do_not_hold_are_said_to_be_rough(tmp_path):
    path = written(tmp_path)
    assert not any("rounded" in note for note in load_trajectory(path).notes)
    deviations = tmp_path / "state_deviation.txt"
    deviations.write_text(deviations.read_text().replace("0.120000", "0.000009"))
    assert any("deviations below 1e-05 in state_deviation.txt are rounded" in n for n in load_trajectory(path).notes)


def test_without_deviations_nothing_is_claimed(tmp_path):
    path = written(tmp_path)
    (tmp_path / "state_deviation.txt").unlink()
    found = load_trajectory(path)
    assert (found.covariances, found.states["gyro-bias"].covariances, found.gauge) == (None, None, None)


def test_a_truth_takes_no_deviations_of_an_estimate(tmp_path):
    assert load_trajectory(written(tmp_path, name="groundtruth")).covariances is None


def test_names_of_the_launch_files_are_known(tmp_path):
    path = written(tmp_path)
    path.rename(tmp_path / "ov.txt")
    (tmp_path / "state_deviation.txt").rename(tmp_path / "ov_std.txt")
    assert load_trajectory(tmp_path / "ov.txt").covariances is not None


@pytest.mark.parametrize("fault", ["other", "negative", "itself"])
def test_faults_are_named_in_a_line(tmp_path, fault):
    path = written(tmp_path, TIMES + 0.01 if fault == "other" else TIMES)
    deviations = tmp_path / "state_deviation.txt"
    if fault == "negative":
        deviations.write_text(deviations.read_text().replace(" 0.02", " -0.02"))
    reason = {
        "other": "state_deviation.txt has no time of the estimate",
        "negative": "state_deviation.txt has a negative deviation in row 0",
        "itself": "has deviations alone: give the file of the estimate",
    }[fault]
    with pytest.raises(ValueError, match=reason):
        load_trajectory(deviations if fault == "itself" else path)
