"""Noise of tracks is told from the tracks themselves: white errors, random walks and slides apart."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import stereo_slam_env as sse
from filters import ColouredNoise, Pose, StereoCamera, StereoNoise, StereoObservation
from stereo_slam_env.datasets import load
from stereo_slam_env.frontend.track_noise import (
    COMMON_WALK,
    COMMON_WALK_WITH_R,
    DISPARITY_OFFSET,
    LAGS,
    LASTING,
    LASTING_TIME,
    MISALIGNMENT,
    RIGHT_TURN,
    SCALE,
    TrackNoise,
    stated_noise,
    track_noise,
    with_measured_noise,
)
from stereo_slam_env.recording.archive import save_recording
from stereo_slam_env.recording.recording import GIVEN_TRUTH, SIMULATION, Frame, Recording, Reference

CAMERA = StereoCamera(700.0, 700.0, 600.0, 200.0, 0.5, 1200, 400)
FRAMES, TRACKS = 60, 80
TIME_CONSTANT = 10.0


def drive(white: float = 0.0, walk: float = 0.0, slide: float = 0.0, seed: int = 0, turn: float = 0.01) -> Recording:
    """A drive past points, each seen while it is ahead; errors of u and v in px, of one frame or of a step.

    It turns by up to `turn` rad a frame.
    """
    rng = np.random.default_rng(seed)
    heading, position, frames = Rotation.identity(), np.zeros(3), []
    points = rng.uniform([-15.0, -3.0, 8.0], [15.0, 3.0, 60.0], (TRACKS, 3))
    ids, last = np.arange(TRACKS), TRACKS
    error, rate = np.zeros((TRACKS, 2)), rng.normal(size=(TRACKS, 2))
    keep = np.exp(-1.0 / TIME_CONSTANT)
    for k in range(FRAMES):
        points_c = heading.inv().apply(points - position)
        gone = (points_c[:, 2] < 5.0) | ~CAMERA.in_view(CAMERA.project(np.maximum(points_c, [-99, -99, 5.0])))
        new = np.flatnonzero(gone)
        points[new] = position + heading.apply(rng.uniform([-8.0, -2.0, 30.0], [8.0, 2.0, 60.0], (len(new), 3)))
        ids[new] = np.arange(last, last + len(new))
        last += len(new)
        error[new] = 0.0
        uvd = CAMERA.project(heading.inv().apply(points - position))
        uvd[:, :2] += error + white * rng.normal(size=(TRACKS, 2))
        order = np.argsort(ids)
        truth = Pose(position, heading.as_quat())
        frames.append(Frame(0.1 * k, StereoObservation(ids[order], uvd[order]), truth=truth))
        rate = keep * rate + np.sqrt(1.0 - keep**2) * rng.normal(size=rate.shape)
        error += walk * rng.normal(size=error.shape) + slide * rate
        position = position + heading.apply([0.0, 0.0, 0.8])
        heading = heading * Rotation.from_rotvec([0.0, turn * np.sin(0.2 * k), 0.0])
    return Recording("drive", CAMERA, tuple(frames), StereoNoise.independent_pixels(2.0))


def test_white_errors_are_taken_back_in_the_next_frame() -> None:
    found = track_noise(drive(white=0.3))
    np.testing.assert_allclose(found.step[:2], np.sqrt(2.0) * 0.3, rtol=0.05)
    np.testing.assert_allclose(found.correlation[1, :2], -0.5, atol=0.05)
    assert (np.abs(found.correlation[2:, :2]) < 0.08).all()
    assert (found.lasting[:2] < 0.12).all()


def with_white_pixels(recording: Recording, sigma: float, seed: int = 0) -> Recording:
    """The drive with white noise in u of both images and in v, px."""
    rng = np.random.default_rng(seed)
    R = StereoNoise.independent_pixels(sigma).R
    return recording.with_observations(
        dataclasses.replace(seen, uvd=seen.uvd + rng.multivariate_normal(np.zeros(3), R, len(seen)))
        for seen in (frame.observation for frame in recording.frames)
    )


@pytest.mark.parametrize("sigma", [0.5, 2.0])
def test_white_errors_of_disparities_are_no_walk_of_the_pixels(sigma: float) -> None:
    """Where a point is expected next hangs on its depth: a white error there must be taken back, too."""
    found = [track_noise(with_white_pixels(drive(seed=seed), sigma, seed)) for seed in range(4)]
    # The point is seen larger in each frame, so that the step in u is more than that of white noise in u.
    assert np.mean([one.step[0] for one in found]) > 1.5 * sigma
    assert abs(np.mean([one.lasting_share for one in found])) < 0.1


@pytest.mark.parametrize("white", [0.0, 0.5, 2.0])
def test_white_errors_and_those_that_last_are_told_apart(white: float) -> None:
    """White noise that is added to a slide is found as such, and what lasts is as large as without it."""
    found = [track_noise(drive(white=white, slide=0.4, seed=seed)) for seed in range(4)]
    np.testing.assert_allclose(np.mean([one.white[:2] for one in found], axis=0), white, rtol=0.1, atol=0.1)
    lasting = [np.sqrt(np.maximum(one.step[:2] ** 2 - 2.0 * one.white[:2] ** 2, 0.0)) for one in found]
    np.testing.assert_allclose(np.mean(lasting), 0.4, atol=0.05 + 0.1 * white)


@pytest.mark.parametrize("white", [0.0, 0.5])
def test_what_lasts_is_stated_as_an_error_of_each_landmark(white: float) -> None:
    noise = noise_of(drive(white=white, slide=0.4))
    assert noise.lasting_time == LASTING_TIME
    assert 0.5 * LASTING * 0.4 < np.sqrt(noise.lasting[0, 0]) < 2.0 * LASTING * 0.4
    alone = noise_of(drive(white=0.3)).lasting
    assert alone[0, 0] < 0.1 * noise.lasting[0, 0]


def test_only_what_walks_is_stated_to_walk() -> None:
    """Pixels walk, disparities have white errors: no walk of the disparity, which would leave depth open."""
    noise = noise_of(with_white_pixels(drive(walk=0.5), 0.5))
    u, v, d = noise.drift.pixels
    assert 0.3 < v < 0.8
    assert max(d, noise.drift.gate_pixels[2]) < 0.3 * min(u, v)


def test_a_random_walk_leaves_no_trace_in_later_frames() -> None:
    found = track_noise(drive(walk=0.3))
    np.testing.assert_allclose(found.step[:2], 0.3, rtol=0.05)
    np.testing.assert_allclose(found.lasting[:2], 0.3, rtol=0.25)
    assert (np.abs(found.correlation[1:, :2]) < 0.08).all()


def test_a_slide_goes_on_and_its_long_walk_is_found() -> None:
    found = [track_noise(drive(slide=0.3, seed=seed)) for seed in range(4)]
    np.testing.assert_allclose(np.mean([f.step[:2] for f in found], axis=0), 0.3, rtol=0.1)
    lags = np.arange(1, 6)
    correlation = np.mean([f.correlation[lags, 0] for f in found], axis=0)
    # A little less than the rate's: a point that has slid is taken to be elsewhere, where parallax differs.
    np.testing.assert_allclose(correlation, np.exp(-lags / TIME_CONSTANT), atol=0.16)
    within = 1.0 + 2.0 * np.sum(np.exp(-np.arange(1, LAGS + 1) / TIME_CONSTANT))
    np.testing.assert_allclose(np.mean([f.lasting[:2] for f in found], axis=0), 0.3 * np.sqrt(within), rtol=0.15)


def noise_of(recording: Recording) -> ColouredNoise:
    noise = with_measured_noise(recording).noise
    assert isinstance(noise, ColouredNoise)
    return noise


def rig_errors(noise: ColouredNoise) -> tuple[float, ...]:
    """What is stated of the rig."""
    return noise.misalignment, noise.disparity_offset, noise.right_yaw, noise.right_roll, noise.scale


def as_seen_with(recording: Recording, R: np.ndarray) -> Recording:
    """The drive with a covariance for each measurement."""
    seen = [frame.observation for frame in recording.frames]
    return recording.with_observations(dataclasses.replace(one, R=np.tile(R, (len(one), 1, 1))) for one in seen)


def test_the_recording_is_told_what_was_found() -> None:
    noise = noise_of(drive(slide=0.3))
    np.testing.assert_array_equal(noise.R, StereoNoise.independent_pixels(2.0).R)
    assert noise.drift.share < 0.2
    assert noise.drift.pixels[0] > 2.0 * noise.drift.gate_pixels[0]
    assert noise.gauge_walk == COMMON_WALK
    assert rig_errors(noise) == (MISALIGNMENT, DISPARITY_OFFSET, RIGHT_TURN, 0.0, SCALE)


def test_measurements_with_a_covariance_keep_it_have_less_in_common_and_show_a_roll() -> None:
    """Bare tracks slide over the ground, which looks like a roll of the right camera."""
    recording = as_seen_with(drive(slide=0.3), np.diag([0.1, 0.1, 0.2]))
    told = with_measured_noise(recording)
    assert told.frames == recording.frames
    assert told.noise.white is None
    assert told.noise.drift.share > 0.0
    assert told.noise.drift.pixels == (0.0, 0.0, 0.0)
    assert told.noise.gauge_walk == COMMON_WALK_WITH_R < 0.5 * COMMON_WALK
    assert rig_errors(told.noise) == (MISALIGNMENT, DISPARITY_OFFSET, RIGHT_TURN, RIGHT_TURN, SCALE)


def test_a_right_camera_that_is_turned_is_found() -> None:
    """Turned by 0.2 degrees (two sigma) about its vertical axis and by 0.1 about its optical one."""
    errors, nees = [], []
    for seed in range(4):
        drawn = as_seen_with(drive(white=0.1, seed=seed), 0.02 * np.eye(3))
        told = with_measured_noise(turned(drawn, -2.0 * RIGHT_TURN, RIGHT_TURN))
        straight = dataclasses.replace(told.noise, right_yaw=0.0, right_roll=0.0)  # type: ignore[call-arg]
        *_, last = sse.run("coloured-noise", told)
        *_, taken_as_stated = sse.run("coloured-noise", dataclasses.replace(told, noise=straight))
        errors.append([last.position_error, taken_as_stated.position_error])
        nees.append(last.nees / 6)
    found, not_looked_for = np.mean(errors, axis=0)
    assert found < 0.5 * not_looked_for
    assert np.mean(nees) < 1.5


def turned(recording: Recording, yaw: float, roll: float) -> Recording:
    """The drive by a rig whose right camera is turned."""

    def seen_by_it(uvd: np.ndarray) -> np.ndarray:
        x_right, y = (uvd[:, 0] - uvd[:, 2] - CAMERA.cx) / CAMERA.fx, (uvd[:, 1] - CAMERA.cy) / CAMERA.fy
        return uvd + np.outer(CAMERA.fx * (yaw * (1.0 + x_right**2) + roll * y), [0.0, 0.0, 1.0])

    seen = [frame.observation for frame in recording.frames]
    return recording.with_observations(dataclasses.replace(one, uvd=seen_by_it(one.uvd)) for one in seen)


def test_the_rig_of_a_simulation_is_as_it_is_stated() -> None:
    noise = noise_of(dataclasses.replace(drive(slide=0.3), truth_from=SIMULATION))
    assert (noise.gauge_walk, *rig_errors(noise)) == (0.0,) * 6


def test_white_errors_leave_the_stated_noise_white() -> None:
    recording = drive(white=0.3)
    noise = noise_of(recording)
    np.testing.assert_allclose(noise.white, recording.noise.R, rtol=0.15)
    assert max(noise.drift.pixels[:2]) < 0.15


def test_noise_changes_steadily_while_white_errors_grow() -> None:
    """No threshold: a little more white noise never changes what is stated by much."""
    steps = [noise_of(drive(walk=0.2, white=white)) for white in np.linspace(0.0, 0.5, 11)]
    for before, after in pairwise(steps):
        assert 0.5 < np.sqrt(after.white[0, 0] + 0.1) / np.sqrt(before.white[0, 0] + 0.1) < 2.0


@pytest.mark.parametrize("frames", [1, 2, 4])
def test_what_is_not_known_is_bounded(frames: int) -> None:
    """With no or few tracks: R is the white part, points walk by a share of it, and the rig may be wrong."""
    recording = drive(slide=0.3)[:frames]
    noise = noise_of(recording)
    assert noise.white[0, 0] > 0.5 * recording.noise.R[0, 0]
    assert max(noise.drift.share, *noise.drift.pixels) > 0.1
    assert noise.gauge_walk == COMMON_WALK
    assert noise.right_yaw == RIGHT_TURN


def test_without_tracks_the_prior_stands() -> None:
    found = track_noise(drive()[:1])
    assert (found.known_to_last, found.ignorance) == (0.0, 1.0)


def test_standard_errors_are_those_of_repetition() -> None:
    """20 drives; the stated error of the share that lasts is its scatter."""
    found = [track_noise(drive(walk=0.3, seed=seed)) for seed in range(20)]
    scatter = np.std([one.lasting_share for one in found], ddof=1)
    assert 0.5 < np.mean([one.lasting_share_error for one in found]) / scatter < 2.0


def test_a_stated_noise_that_is_too_small_for_white_errors_is_raised() -> None:
    noise = noise_of(with_white_pixels(drive(), 4.0))
    assert 3.5 < np.sqrt(noise.white[1, 1]) < 5.0
    np.testing.assert_array_equal(noise.R, StereoNoise.independent_pixels(2.0).R)


@pytest.mark.parametrize("truth_from", [GIVEN_TRUTH, SIMULATION])
def test_a_loaded_recording_says_how_its_errors_last_unless_it_is_simulated(tmp_path: Path, truth_from: Reference):
    recording = dataclasses.replace(drive(slide=0.3), truth_from=truth_from)
    expected = recording if truth_from == SIMULATION else with_measured_noise(recording)
    for given in (recording, expected):
        save_recording(tmp_path / "drive.npz", given)
        assert load(tmp_path / "drive.npz").noise == expected.noise


def test_a_covariance_that_is_too_small_is_raised_to_what_residuals_show() -> None:
    recording = as_seen_with(drive(white=0.5), np.diag([0.05, 0.05, 0.1]) ** 2 + 1e-4)
    raised = with_measured_noise(recording).frames[3].observation.R
    assert 0.35 < np.sqrt(raised[:, 0, 0].mean()) < 0.8


@pytest.mark.parametrize(("white", "warned"), [(1.0, False), (2.0, True)])
def test_tracks_too_rough_for_any_claim_are_warned_of(
    white: float, warned: bool, caplog: pytest.LogCaptureFixture
) -> None:
    with_measured_noise(drive(white=white))
    assert ["drive: its tracks jump by 2.9 px" in message for message in caplog.messages] == [True] * warned


def with_wrong_matches(recording: Recording, share: float) -> Recording:
    """The drive with some measurements off by some 30 px."""
    rng, wrong = np.random.default_rng(1), []
    for frame in recording.frames:
        uvd = frame.observation.uvd + 30.0 * rng.normal(size=(TRACKS, 3)) * (rng.random((TRACKS, 1)) < share)
        wrong.append(StereoObservation(frame.observation.ids, uvd))
    return recording.with_observations(wrong)


def test_wrong_matches_do_not_count() -> None:
    found = track_noise(with_wrong_matches(drive(white=0.3), 0.05))
    np.testing.assert_allclose(found.step[:2], np.sqrt(2.0) * 0.3, rtol=0.1)


@pytest.mark.parametrize(("share", "warned"), [(0.03, False), (0.1, True)])
def test_many_wrong_matches_are_warned_of(share: float, warned: bool, caplog: pytest.LogCaptureFixture) -> None:
    """A wrong match is two steps, to it and back: of a tenth of them 1 - 0.9^2 are wrong."""
    recording = with_wrong_matches(drive(white=0.3), share)
    assert track_noise(recording).mismatched == pytest.approx(1.0 - (1.0 - share) ** 2, abs=0.04)
    with_measured_noise(recording)
    assert ["of the steps of its tracks are far" in message for message in caplog.messages] == [True] * warned


def test_white_errors_alone_leave_nothing_that_lasts_whatever_the_rounding() -> None:
    """Half of the variance of a step is white at most; the rest was -1e-17 now and then, and its root no number."""
    for sigma in np.random.default_rng(0).uniform(0.1, 2.0, (300, 3)):
        white = TrackNoise(sigma, np.sqrt(0.5) * sigma, 0.1 * sigma, np.zeros((LAGS + 1, 3)), 0.5, 0.2, 1.0, 0.0)
        noise = stated_noise(white, StereoNoise.independent_pixels(1.0), brings_R=False, stranger=True)
        assert max(noise.drift.gate_pixels) < 1e-3
