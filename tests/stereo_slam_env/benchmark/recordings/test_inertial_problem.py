"""Smooth drives and flights with an inertial unit: one path, one W, the same bits again."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from filters import Strapdown
from filters.motions.motion_model import CameraState
from stereo_slam_env import evaluate, run
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_drive, inertial_flight
from stereo_slam_env.benchmark.scenarios.streams import stream_digest
from stereo_slam_env.recording.archive import load_recording, save_recording

PROBLEMS = pytest.mark.parametrize("problem", [inertial_drive, inertial_flight])


@PROBLEMS
def test_samples_lead_from_frame_to_frame(problem) -> None:
    """From the true state, over steps of .1 s: what is left is the unit's biases, noise and scale."""
    recording, motion = problem(0, frames=20, landmarks=5), Strapdown()
    gravity = []
    for before, frame in zip(recording.frames, recording.frames[1:], strict=False):
        values = {variable.name: variable.value for variable in motion.variables}
        pose, velocity = before.truth, before.truth_velocity
        state = CameraState(pose.position, pose.orientation, velocity.linear, velocity.angular, values)
        moved = motion.predict(state, 0.1, frame.inertial).state
        assert np.linalg.norm(moved.position - frame.truth.position) < 0.02
        assert np.abs(moved.orientation @ frame.truth.orientation) == pytest.approx(1.0, abs=1e-5)
        gravity.append(moved.linear_velocity - frame.truth_velocity.linear)
    assert np.abs(np.mean(gravity, axis=0)).max() < 0.15  # m/s: .1 s of bias and of a W that is not quite level


@PROBLEMS
def test_points_and_odometry_are_of_that_path(problem) -> None:
    recording = problem(1, frames=12, landmarks=30)
    for before, frame in zip(recording.frames, recording.frames[1:], strict=False):
        seen = frame.observation
        points_c = (recording.landmarks.positions[seen.ids] - frame.truth.position) @ frame.truth.R_wc
        assert np.abs(recording.camera.project(points_c) - seen.uvd).max() < 6.0
        turn = before.truth.R_wc.T @ (frame.truth.position - before.truth.position) / 0.1
        assert np.abs(frame.odometry.linear - turn).max() < 1.0
    assert len(seen) == 30
    seen = [frame.observation.ids for frame in recording.frames]
    ended = [len(np.setdiff1d(*two)) for two in itertools.pairwise(seen)]
    assert 1.0 < np.mean(ended) < 10.0  # of 30: a tenth, and those that leave the view


def test_an_inertial_recording_is_saved_loaded_and_replayed_to_the_same_bits(tmp_path) -> None:
    recording = inertial_flight(2, frames=15, landmarks=12, imu="bmi088")
    save_recording(tmp_path / "flight.npz", recording)
    loaded = load_recording(tmp_path / "flight.npz")
    again = inertial_flight(2, frames=15, landmarks=12, imu="bmi088")
    assert stream_digest(loaded) == stream_digest(recording) == stream_digest(again)
    ends = []
    for one in (recording, loaded):
        *_, last = run("inertial", one)
        ends.append(np.concatenate([last.slam.pose.position, last.slam.pose.covariance.ravel()]))
    np.testing.assert_array_equal(*ends)


def test_few_landmarks_want_an_inertial_unit() -> None:
    """8 tracks on three drives of 12 s: less than .7 of the error of vision alone."""
    drives, alone = [inertial_drive(seed, frames=120, landmarks=8) for seed in range(3)], {"use_odometry": False}
    inertial, vision = (
        [evaluate(name, drive, gate=None, **alone).figures.position_rmse_m for drive in drives]
        for name in ("inertial", "right-invariant")
    )
    assert np.mean(inertial) < 0.7 * np.mean(vision)


@pytest.mark.slow
def test_wheels_and_samples_together_are_better_than_each() -> None:
    """8 tracks on 8 drives of 12 s; and the fusion is consistent: mean NEES/6 within .7 to 1.4 (8 correlated runs)."""
    runs = {
        (name, wheels): [
            evaluate(name, inertial_drive(s, frames=120, landmarks=8), gate=None, use_odometry=wheels).figures
            for s in range(8)
        ]
        for name, wheels in (("inertial", False), ("inertial", True), ("right-invariant", True))
    }
    samples, both, wheels = ([run.position_rmse_m for run in each] for each in runs.values())
    assert np.mean(both) < 0.55 * np.mean(samples)  # came out: .098 m, .217 m, and .128 m with wheels
    assert np.mean(both) < 0.87 * np.mean(wheels)
    assert 0.7 < np.mean([run.pose_anees / 6.0 for run in runs["inertial", True]]) < 1.4


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"imu": "bmi08"}, r"^imu has no data sheet 'bmi08'"),
        ({"noise": "none"}, r"^noise must be one of pixels, "),
        ({"frames": 1}, r"^frames must be an integer >= 2, got 1$"),
        ({"landmarks": 1.5}, r"^landmarks must be an integer >= 2, got 1.5$"),
    ],
)
def test_what_is_wrong_is_named(option: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        inertial_drive(0, **option)
