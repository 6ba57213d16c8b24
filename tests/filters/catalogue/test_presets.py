"""The named filters are choices of parts of the engine; "coloured-noise" chooses by what the noise states."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import stereo_slam_env as sse
from filters import ColouredNoise, LandmarkDrift, Pose, StereoNoise, jacobian, make_filter
from filters.engine.batch import goes_in_a_batch
from filters.geometry import rotations
from stereo_slam_env.recording.recording import Recording

DRIFT = LandmarkDrift(pixels=(1.1, 1.0, 0.3), gate_pixels=(0.4, 0.4, 0.2))


@pytest.fixture(scope="module")
def drive() -> Recording:
    return sse.make_recording("reference-turn", 0)[:20]


def estimates(drive: Recording, name: str, noise: StereoNoise, **options: Any) -> list[np.ndarray]:
    """Pose and covariance after the last frame."""
    slam = make_filter(name, camera=drive.camera, noise=noise, **options)
    *_, last = sse.run(slam, drive)
    return [last.pose.position, last.pose.orientation, last.pose.covariance]


def test_without_errors_that_last_it_is_the_right_invariant_filter_with_the_joint_test(drive: Recording) -> None:
    own = estimates(drive, "coloured-noise", drive.noise)
    for mine, theirs in zip(own, estimates(drive, "right-invariant", drive.noise, consensus=True), strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_what_the_noise_states_is_what_the_engine_is_told(drive: Recording) -> None:
    white = 0.1 * drive.noise.R
    own = estimates(drive, "coloured-noise", ColouredNoise(drive.noise.R, white, DRIFT, 0.004, 0.0, 0.05, 0.002, 0.001))
    told = {"drift": DRIFT, "gauge_walk": 0.004, "consensus": True}
    told["measurement"] = {"name": "calibrated", "offset_sigma": 0.05, "yaw_sigma": 0.002, "roll_sigma": 0.001}
    for mine, theirs in zip(own, estimates(drive, "right-invariant", StereoNoise(white), **told), strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_the_inertial_filter_knows_what_the_noise_states_too() -> None:
    drive = sse.record("StereoSlam/Drive-v0", seed=0, frames=8, vehicle="smooth", imu="bmi088", rig="qvga")
    noises = drive.noise, ColouredNoise(drive.noise.R, 0.1 * drive.noise.R, DRIFT, 0.004, 0.0, 0.05, 0.002, scale=0.01)
    for noise in noises:
        own = estimates(drive, "inertial", noise)
        told = estimates(drive, "coloured-noise", noise, motion="strapdown", consensus=False)
        for mine, theirs in zip(own, told, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    assert [goes_in_a_batch(make_filter("inertial", camera=drive.camera, noise=noise)) for noise in noises] == [
        True,
        False,
    ]


@pytest.mark.parametrize(
    ("doubt", "in_a_batch"), [({}, True), ({"scale": 0.01}, False), ({"misalignment": 0.01}, False)]
)
def test_it_runs_in_a_batch_unless_it_has_a_doubt_to_add_and_an_option_goes_before_the_noise(
    drive: Recording, doubt: dict[str, float], in_a_batch: bool
) -> None:
    noise = ColouredNoise(drive.noise.R, drift=DRIFT, gauge_walk=0.004, **doubt)
    slam = make_filter("coloured-noise", camera=drive.camera, noise=noise, gate=None, gauge_walk=0.0)
    assert goes_in_a_batch(slam) is in_a_batch
    assert (slam.options.gauge_walk, slam.options.drift, slam.options.consensus) == (0.0, DRIFT, False)
    assert not goes_in_a_batch(make_filter("coloured-noise-causal", camera=drive.camera, noise=noise))


def test_what_no_image_shows_of_the_rig_is_added_to_the_covariance_of_the_way(drive: Recording) -> None:
    """A scale and a turn of the camera in its body, against the way that differences say they make of it."""
    scale, turn = 0.01, 0.005
    slams = [
        list(sse.run("coloured-noise", drive, noise=noise))[-1].slam
        for noise in (drive.noise, ColouredNoise(drive.noise.R, misalignment=turn, scale=scale))
    ]
    plain, doubting = (slam.pose for slam in slams)
    start = Pose(drive.start.position, drive.start.orientation)
    moved = start.inverse() @ Pose(plain.position, plain.orientation)

    def changed(numbers: np.ndarray) -> np.ndarray:
        body = Pose(np.zeros(3), rotations.exp_quaternion(numbers[1:]))
        way = body.inverse() @ Pose((1.0 + numbers[0]) * moved.position, moved.orientation) @ body
        there = start @ way
        turned = rotations.log(rotations.matrix(plain.orientation).T @ there.R_wc)
        return np.concatenate([there.position - plain.position, turned])

    J = jacobian(changed, 4) * [scale, turn, turn, turn]
    np.testing.assert_allclose(doubting.covariance, plain.covariance + J @ J.T, atol=1e-9)
    slam = slams[1]
    joint, pairs = slam.joint_covariance(), slam.pose_landmark_covariances()
    np.testing.assert_array_equal(joint[:6, :6], doubting.covariance)
    np.testing.assert_array_equal(pairs[:, :6, :6], [doubting.covariance] * len(pairs))
    np.testing.assert_allclose(joint[:6, 6:9], pairs[0, :6, 6:], rtol=1e-9)
    # NEES is by the same covariance, in the coordinates of the filter's error.
    pose, error = slam.pose, slam.options.error
    judged = error.pose_error(slam.camera_state, pose.covariance, pose.position, pose.orientation)
    np.testing.assert_array_equal(slam.pose_error(pose.position, pose.orientation)[1], judged[1])
