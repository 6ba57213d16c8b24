"""Noise of tracks is told from the tracks themselves: white errors, random walks and slides apart."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import ColouredNoise, StereoCamera, StereoNoise, StereoObservation
from stereo_slam_env.datasets import load
from stereo_slam_env.frontend.track_noise import (
    DISPARITY_OFFSET,
    LAGS,
    MISALIGNMENT,
    MOST_IN_COMMON,
    flow_residuals,
    track_noise,
    with_measured_noise,
)
from stereo_slam_env.recording.archive import save_recording
from stereo_slam_env.recording.recording import GIVEN_TRUTH, SIMULATION, Frame, Recording, Reference

CAMERA = StereoCamera(700.0, 700.0, 600.0, 200.0, 0.5, 1200, 400)
FRAMES, TRACKS = 60, 80
TIME_CONSTANT = 10.0


def drive(white: float = 0.0, walk: float = 0.0, slide: float = 0.0, seed: int = 0) -> Recording:
    """A drive past points, each seen while it is ahead; errors of u and v in px, of one frame or of a step."""
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
        frames.append(Frame(0.1 * k, StereoObservation(ids[order], uvd[order])))
        rate = keep * rate + np.sqrt(1.0 - keep**2) * rng.normal(size=rate.shape)
        error += walk * rng.normal(size=error.shape) + slide * rate
        position = position + heading.apply([0.0, 0.0, 0.8])
        heading = heading * Rotation.from_rotvec([0.0, 0.01 * np.sin(0.2 * k), 0.0])
    return Recording("drive", CAMERA, tuple(frames), StereoNoise.independent_pixels(2.0))


def test_white_errors_are_taken_back_in_the_next_frame() -> None:
    found = track_noise(flow_residuals(drive(white=0.3)), CAMERA.fx)
    np.testing.assert_allclose(found.step[:2], np.sqrt(2.0) * 0.3, rtol=0.05)
    np.testing.assert_allclose(found.correlation[1, :2], -0.5, atol=0.05)
    assert (np.abs(found.correlation[2:, :2]) < 0.08).all()
    assert (found.lasting[:2] < 0.12).all()
    assert found.slide < 0.001


def test_a_random_walk_leaves_no_trace_in_later_frames() -> None:
    found = track_noise(flow_residuals(drive(walk=0.3)), CAMERA.fx)
    np.testing.assert_allclose(found.step[:2], 0.3, rtol=0.05)
    np.testing.assert_allclose(found.lasting[:2], 0.3, rtol=0.25)
    assert (np.abs(found.correlation[1:, :2]) < 0.08).all()
    assert found.slide < 0.0025


def test_a_slide_goes_on_and_its_long_walk_is_found() -> None:
    found = [track_noise(flow_residuals(drive(slide=0.3, seed=seed)), CAMERA.fx) for seed in range(4)]
    np.testing.assert_allclose(np.mean([f.step[:2] for f in found], axis=0), 0.3, rtol=0.1)
    lags = np.arange(1, 6)
    correlation = np.mean([f.correlation[lags, 0] for f in found], axis=0)
    # A little less than the rate's: a point that has slid is taken to be elsewhere, where parallax differs.
    np.testing.assert_allclose(correlation, np.exp(-lags / TIME_CONSTANT), atol=0.16)
    within = 1.0 + 2.0 * np.sum(np.exp(-np.arange(1, LAGS + 1) / TIME_CONSTANT))
    np.testing.assert_allclose(np.mean([f.lasting[:2] for f in found], axis=0), 0.3 * np.sqrt(within), rtol=0.15)
    assert min(f.slide for f in found) > 0.005


def test_the_recording_is_told_what_was_found() -> None:
    noise = with_measured_noise(drive(slide=0.3)).noise
    assert isinstance(noise, ColouredNoise)
    np.testing.assert_array_equal(noise.R, StereoNoise.independent_pixels(2.0).R)
    assert noise.white is not None
    assert noise.drift is not None
    assert noise.drift.share == 0.0
    assert noise.drift.gate_pixels is not None
    assert noise.drift.pixels[0] > 2.0 * noise.drift.gate_pixels[0]
    assert (noise.gauge_walk, noise.misalignment) == (MOST_IN_COMMON, MISALIGNMENT)
    assert noise.disparity_offset == DISPARITY_OFFSET


def test_a_walk_beside_white_errors_is_the_landmarks_alone() -> None:
    noise = with_measured_noise(drive(white=0.1, walk=0.3)).noise
    assert isinstance(noise, ColouredNoise)
    assert noise.drift is not None
    np.testing.assert_allclose(noise.drift.pixels[:2], 1.2 * np.hypot(0.3, np.sqrt(2.0) * 0.1), rtol=0.1)
    assert (noise.gauge_walk, noise.misalignment, noise.disparity_offset) == (0.0, 0.0, 0.0)


def test_white_errors_leave_the_noise_as_it_was() -> None:
    recording = drive(white=0.3)
    assert with_measured_noise(recording) is recording


@pytest.mark.parametrize("truth_from", [GIVEN_TRUTH, SIMULATION])
def test_a_loaded_recording_says_how_its_errors_last_unless_it_is_simulated(tmp_path: Path, truth_from: Reference):
    recording = dataclasses.replace(drive(slide=0.3), truth_from=truth_from)
    expected = recording if truth_from == SIMULATION else with_measured_noise(recording)
    for given in (recording, expected):
        save_recording(tmp_path / "drive.npz", given)
        assert load(tmp_path / "drive.npz").noise == expected.noise


def test_measurements_with_a_covariance_keep_it() -> None:
    recording = drive(slide=0.3)
    R = np.tile(np.diag([0.1, 0.1, 0.2]), (TRACKS, 1, 1))
    seen = [dataclasses.replace(frame.observation, R=R) for frame in recording.frames]
    noise = with_measured_noise(recording.with_observations(seen)).noise
    assert isinstance(noise, ColouredNoise)
    assert noise.white is None
    assert noise.drift is not None
    assert noise.drift.share > 0.0
    assert noise.drift.pixels == (0.0, 0.0, 0.0)


def test_wrong_matches_do_not_count() -> None:
    recording, rng = drive(white=0.3), np.random.default_rng(1)
    wrong = []
    for frame in recording.frames:
        uvd = frame.observation.uvd + 30.0 * rng.normal(size=(TRACKS, 3)) * (rng.random((TRACKS, 1)) < 0.05)
        wrong.append(StereoObservation(frame.observation.ids, uvd))
    found = track_noise(flow_residuals(recording.with_observations(wrong)), CAMERA.fx)
    np.testing.assert_allclose(found.step[:2], np.sqrt(2.0) * 0.3, rtol=0.1)


def test_too_few_tracks_say_nothing() -> None:
    recording = drive(white=0.3)[:4]
    assert with_measured_noise(recording).noise is recording.noise
    with pytest.raises(ValueError, match="flow must have at least"):
        track_noise(flow_residuals(recording), CAMERA.fx)
