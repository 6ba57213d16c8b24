"""Smooth vehicle and the inertial unit on it: samples, truth and odometry are of one motion (15 s, with compiling)."""

from __future__ import annotations

from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from filters.geometry import rotations
from stereo_slam_env import evaluate, record, run
from stereo_slam_env.envs import restore, snapshot
from stereo_slam_env.recording.archive import load_recording, save_recording

DRIVE = "StereoSlam/Drive-v0"
SMOOTH = {"route": "right-turn", "policy": "route", "rig": "qvga", "vehicle": "smooth", "max_landmarks": 30}


@pytest.fixture(scope="module")
def drive():
    return record(DRIVE, seed=3, imu="adis16448", odometry_sigma_linear=0.0, odometry_sigma_angular=0.0, **SMOOTH)


def steps(recording):
    return zip(recording.frames, recording.frames[1:], strict=False)


def test_odometry_is_that_of_the_step(drive) -> None:
    for before, frame in steps(drive):
        turn = frame.odometry.angular * 0.1
        np.testing.assert_allclose(before.truth.R_wc @ rotations.exp(turn), frame.truth.R_wc, atol=1e-9)
        way = before.truth.R_wc @ rotations.exp(0.5 * turn) @ frame.odometry.linear * 0.1
        np.testing.assert_allclose(before.truth.position + way, frame.truth.position, atol=1e-9)


def test_the_velocity_is_continuous(drive) -> None:
    """No sample is farther than 3 m/s^2 from gravity and the one before: a jump of .1 m/s in 5 ms would be 20."""
    forces = np.concatenate([frame.inertial.specific_forces for frame in drive.frames[1:]])
    assert np.abs(np.diff(forces, axis=0)).max() < 3.0
    assert abs(np.linalg.norm(forces.mean(axis=0)) - 9.81) < 0.4


def test_it_follows_the_kinematic_car() -> None:
    """67 ms behind it: less than .4 m at 4 m/s, in place and, at the end of a bend, in direction."""
    arguments = {**SMOOTH, "roughness": 0.0}
    smooth, steps_of = (record(DRIVE, seed=3, **{**arguments, "vehicle": kind}) for kind in ("smooth", "kinematic"))
    for one, other in zip(smooth.frames, steps_of.frames, strict=True):
        assert np.linalg.norm(one.truth.position - other.truth.position) < 0.4
    turned = rotations.log(smooth.frames[-1].truth.R_wc.T @ steps_of.frames[-1].truth.R_wc)
    assert np.linalg.norm(turned) < 0.03


def test_environment_with_samples() -> None:
    """Gymnasium's checks; the key in its space; the observation is the frame's samples in single precision."""
    with closing(gym.make(DRIVE, disable_env_checker=True, imu="car", **SMOOTH)) as env:
        check_env(env.unwrapped, skip_render_check=True)
        observation, _ = env.reset(seed=2)
        assert observation["imu"].shape == (20, 6)
        assert not observation["imu"].any()
        observation, *_ = env.step(np.zeros(2, dtype=np.float32))
        frame = env.unwrapped.frame
        samples = np.hstack([frame.inertial.angular_rates, frame.inertial.specific_forces]).astype(np.float32)
        np.testing.assert_array_equal(observation["imu"], samples)
        taken = snapshot(env)
        ahead = [env.step(np.zeros(2, dtype=np.float32))[0]["imu"] for _ in range(3)]
        restore(env, taken)
        again = [env.step(np.zeros(2, dtype=np.float32))[0]["imu"] for _ in range(3)]
        np.testing.assert_array_equal(ahead, again)


def test_recorded_saved_and_filtered(tmp_path) -> None:
    recording = record(DRIVE, seed=5, imu="bmi088", **SMOOTH)
    save_recording(tmp_path / "drive.npz", recording)
    *_, first = run("inertial", recording)
    *_, again = run("inertial", load_recording(tmp_path / "drive.npz"))
    np.testing.assert_array_equal(first.slam.pose.covariance, again.slam.pose.covariance)
    assert evaluate("inertial", recording).figures.position_rmse_m < 0.3


def test_a_filter_with_samples_in_the_loop() -> None:
    """The belief of one environment and of a row of many: the same bits."""
    arguments = {"imu": "adis16448", **SMOOTH}
    belief = {"filter": "inertial"}
    vector = gym.make_vec(DRIVE, num_envs=2, belief=belief, **arguments)
    vector.reset(seed=[7, 8])
    for _ in range(4):
        vector.step(np.zeros((2, 2), dtype=np.float32))
    poses = [slam.pose.position for slam in vector.unwrapped.filters]
    for b, seed in enumerate((7, 8)):
        *_, last = run("inertial", record(DRIVE, seed=seed, frames=5, **arguments), gate=None)
        assert np.abs(last.slam.pose.position - poses[b]).max() < 0.05
        assert np.linalg.norm(poses[b]) > 1.0
    vector.close()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"id": "StereoSlam/DriveGaze-v0", "vehicle": "smooth"},
            r"^vehicle must be 'kinematic' and imu None with a head",
        ),
        ({"imu": "bmi08", "vehicle": "smooth"}, r"^imu has no data sheet 'bmi08'"),
        ({"imu": "car"}, r"^imu must be None with vehicle='kinematic', whose velocity jumps: use vehicle='smooth'$"),
        ({"vehicle": "flying"}, r"^vehicle must be "),
        ({"vehicle": "smooth", "roughness": -1.0}, r"^roughness must be "),
    ],
)
def test_what_is_wrong_is_named(given: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        gym.make(**{"id": DRIVE, **given})
