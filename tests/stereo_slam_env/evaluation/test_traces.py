"""Which landmarks are traced, and what is noted of them (0.3 s)."""

from dataclasses import replace

import numpy as np

from filters import Start, StereoNoise, StereoObservation, make_filter
from stereo_slam_env.evaluation.map_scoring import FrameMap, TraceRecorder, choose_landmarks, view_maps
from stereo_slam_env.recording.recording import Frame, Recording

from ..benchmark.small_recordings import CAMERA, small_recording


def recording_of(tracks, frames=20):
    """Tracks: id -> (first frame, length, depth)."""
    taken = []
    for k in range(frames):
        seen = {i: depth for i, (first, length, depth) in tracks.items() if first <= k < first + length}
        uvd = [[600.0, 180.0, CAMERA.disparity_constant / depth] for depth in seen.values()]
        taken.append(Frame(0.1 * k, StereoObservation(list(seen), np.reshape(uvd, (-1, 3)))))
    return Recording("tracks", CAMERA, tuple(taken), StereoNoise.independent_pixels(1.0))


def test_the_landmarks_nearest_to_20_and_75_m_are_chosen():
    recording = recording_of({1: (0, 15, 12.0), 2: (0, 15, 21.0), 3: (3, 15, 70.0), 4: (0, 15, 140.0)})
    assert choose_landmarks(recording) == {"near": 2, "far": 3}


def test_short_tracks_do_not_count_where_there_are_long_ones():
    assert choose_landmarks(recording_of({1: (0, 11, 20.0), 2: (0, 12, 30.0), 3: (0, 12, 60.0)})) == {
        "near": 2,
        "far": 3,
    }
    assert choose_landmarks(recording_of({1: (0, 5, 20.0), 2: (0, 5, 75.0)})) == {"near": 1, "far": 2}


def test_near_and_far_are_different_and_may_be_missing():
    assert choose_landmarks(recording_of({1: (0, 12, 40.0)})) == {"near": 1}
    assert choose_landmarks(recording_of({})) == {}


def test_where_truth_is_known_the_noise_does_not_choose():
    quiet, noisy = small_recording(sigma=0.01), small_recording(sigma=3.0)
    assert choose_landmarks(quiet) == choose_landmarks(noisy)


def test_landmarks_with_truth_seen_from_where_nobody_knows_are_chosen_by_what_was_measured():
    recording = small_recording()
    blind = replace(recording, frames=tuple(replace(frame, truth=None) for frame in recording.frames))
    assert choose_landmarks(blind) == choose_landmarks(replace(blind, landmarks=None)) != {}


def test_a_trace_is_the_depth_in_the_current_camera():
    recording = small_recording(sigma=0.01)
    estimator = make_filter("inverse-depth", camera=CAMERA, noise=recording.noise)
    estimator.reset(Start(covariance=recording.start.covariance, linear_velocity=recording.start.linear_velocity))
    recorder = TraceRecorder(recording)
    for k, frame in enumerate(recording.frames):
        if k:
            estimator.predict(0.1)
        estimator.update(frame.observation)
        maps = [FrameMap(k, frame, estimator.forecast(), estimator.noise.R)]
        recorder.add(view_maps(maps, recording.landmarks), maps)
    near, far = recorder.traces()
    assert (near.label, far.label) == ("near", "far")
    for trace in (near, far):
        assert len(trace.frames) >= 12
        np.testing.assert_allclose(trace.depth, trace.true_depth, rtol=0.02)
        np.testing.assert_allclose(trace.measured_depth, trace.true_depth, rtol=0.02)
        assert (np.diff(trace.true_depth) < 0).all()
        assert trace.sigma[-1] < trace.sigma[0]
