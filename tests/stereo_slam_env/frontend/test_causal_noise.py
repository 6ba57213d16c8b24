"""Noise of tracks measured as the drive goes: no future in it, and in the end what a look at the whole says."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

import stereo_slam_env as sse
from filters import ColouredNoise, StereoFilter, StereoNoise, check_filter
from filters.catalogue.presets import ColouredNoiseEKF
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.lasting_errors import LastingErrors
from stereo_slam_env.frontend.causal_noise import CausalNoiseEKF
from stereo_slam_env.frontend.ego_motion import Step
from stereo_slam_env.frontend.settings import DRIFT_SHARE
from stereo_slam_env.frontend.track_noise import COMMON_WALK, TrackStatistics, with_measured_noise
from stereo_slam_env.frontend.track_recorder import TYPICAL_NOISE
from stereo_slam_env.loop import Moment
from stereo_slam_env.recording.recording import Recording

from .test_track_noise import as_seen_with, drive


def last_moment(recording: Recording) -> Moment:
    *_, last = sse.run(CausalNoiseEKF, recording, use_odometry=False)
    return last


def test_the_estimate_does_not_depend_on_later_frames() -> None:
    recording = drive(slide=0.3)
    there = next(m for m in sse.run(CausalNoiseEKF, recording, use_odometry=False) if m.number == 39)
    expected = there.pose.position.copy(), there.pose.covariance.copy()
    alone = last_moment(recording[:40]).pose
    np.testing.assert_array_equal(alone.position, expected[0])
    np.testing.assert_array_equal(alone.covariance, expected[1])


@pytest.mark.parametrize("errors", [{"white": 0.3}, {"walk": 0.3}, {"slide": 0.3}])
def test_in_the_end_it_assumes_what_a_look_at_the_whole_drive_says(errors: dict[str, float]) -> None:
    recording = drive(**errors)
    slam = last_moment(recording).slam
    ahead = with_measured_noise(recording).noise
    np.testing.assert_allclose(slam.options.gauge_walk, ahead.gauge_walk, rtol=0.2)
    np.testing.assert_allclose(slam.noise.R[0, 0], ahead.white[0, 0], atol=0.4 * recording.noise.R[0, 0])
    assert kept_sigma(slam) == pytest.approx(ahead.lasting[0, 0] ** 0.5, rel=0.25, abs=0.1)


def kept_sigma(slam: StereoFilter) -> float:
    """Standard deviation of the errors of u that a filter keeps in its state, px."""
    assert isinstance(slam.options.landmark, LastingErrors)
    return float(np.asarray(slam.options.landmark.covariance)[0, 0] ** 0.5)


def test_errors_that_last_are_allowed_for_once() -> None:
    """In the state, or as a walk where measurements bring a covariance of their own: never both."""
    bare = drive(slide=0.3)
    for moment in sse.run(CausalNoiseEKF, bare, use_odometry=False):
        assert moment.slam.options.drift is None
    R = np.diag([0.1, 0.1, 0.2])
    measured = as_seen_with(bare, R)
    by_plain_noise = last_moment(measured).slam
    assert kept_sigma(by_plain_noise) == 0.0
    stated = last_moment(dataclasses.replace(measured, noise=TYPICAL_NOISE)).slam
    assert not isinstance(stated.options.landmark, LastingErrors)
    for slam in (by_plain_noise, stated):
        assert slam.options.drift.share == DRIFT_SHARE


def told_wrong_motions(recording: Recording, wrong: float) -> TrackStatistics:
    """Statistics of the tracks by motions that are off by so many m, and by a fiftieth of it in rad."""
    statistics, rng = TrackStatistics(recording.camera), np.random.default_rng(0)
    for before, now in pairwise(recording.frames):
        true = before.truth.inverse() @ now.truth
        error = wrong * rng.normal(size=6) / [1.0, 1.0, 1.0, 50.0, 50.0, 50.0]
        step = Step(true.R_wc, true.position).moved(error)
        statistics.add(before.observation, now.observation, step, fits=False)
    return statistics


def test_a_motion_that_is_far_off_is_corrected_or_says_nothing_of_the_tracks() -> None:
    """With 1 m and 20 mrad, tens of pixels, the residuals are those of the tracks all the same."""
    right = told_wrong_motions(drive(white=0.3), 0.0)
    wrong = told_wrong_motions(drive(white=0.3), 1.0)
    assert wrong.frames > 0.8 * right.frames
    np.testing.assert_allclose(wrong.noise.step[:2], right.noise.step[:2], rtol=0.02)
    assert wrong.noise.lasting_share == pytest.approx(right.noise.lasting_share, abs=0.05)


def test_frames_with_too_few_tracks_say_nothing() -> None:
    recording = drive(white=0.3)
    few = recording.with_observations([f.observation.select(np.arange(7)) for f in recording.frames])
    assert told_wrong_motions(few, 0.0).frames == 0


def test_frames_that_tell_nothing_are_none_of_the_first_it_learns_from() -> None:
    """With five points for 45 frames, it would soon look at few frames only, and wait for frame 150."""
    recording = drive(white=0.3)
    seen = [frame.observation for frame in recording.frames]
    late = recording.with_observations([one.select(np.arange(5)) for one in seen[:45]] + seen[45:])
    sigmas = [kept_sigma(moment.slam) for moment in sse.run(CausalNoiseEKF, late, use_odometry=False)]
    assert sigmas[44] == sigmas[0]
    assert sigmas[-1] != sigmas[0]


def test_what_it_assumes_changes_every_ten_frames() -> None:
    told = []
    for moment in sse.run(CausalNoiseEKF, drive(slide=0.3), use_odometry=False):
        told.append((moment.slam.options.gauge_walk, float(moment.slam.noise.R[0, 0])))
    changes = [k for k, (before, now) in enumerate(pairwise(told), start=1) if before != now]
    assert changes[:3] == [10, 20, 30]
    assert all(k % 10 == 0 for k in changes)


def test_it_starts_with_no_more_than_R_and_forgets_at_a_reset() -> None:
    recording = drive(slide=0.3)
    slam = last_moment(recording).slam
    slam.reset(recording.start)
    slam.update(recording.frames[0].observation)
    assert slam.options.gauge_walk == COMMON_WALK
    np.testing.assert_array_equal(slam.noise.R, recording.noise.R)


def test_the_rig_of_a_simulation_is_taken_as_stated() -> None:
    exact = ColouredNoise(StereoNoise.independent_pixels(2.0).R)
    assert CausalNoiseEKF(drive().camera, exact).options.gauge_walk == 0.0


def test_measurements_with_a_covariance_by_an_exact_rig_leave_nothing_of_the_rig_to_assume() -> None:
    recording = as_seen_with(drive(white=0.3), np.diag([0.1, 0.1, 0.2]))
    last = last_moment(dataclasses.replace(recording, noise=ColouredNoise(recording.noise.R)))
    assert last.number == len(recording) - 1
    assert np.isfinite(last.pose.covariance).all()


def test_what_is_stated_of_the_rig_is_believed() -> None:
    stated = ColouredNoise(StereoNoise.independent_pixels(2.0).R, gauge_walk=0.002, right_yaw=0.0005)
    slam = CausalNoiseEKF(drive().camera, stated)
    slam.reset()
    np.testing.assert_allclose(slam.belief("calibration").covariance, [[0.0005**2]])


def test_a_filter_goes_on_with_what_it_is_told_to_assume() -> None:
    """Told before the first frame, it is the filter that is made so, to the last bit."""
    recording = with_measured_noise(drive(slide=0.3)[:20])
    noise = recording.noise
    made = ColouredNoiseEKF(recording.camera, noise)
    other_noise = dataclasses.replace(noise, white=None, lasting=4.0 * noise.R, lasting_time=1.0, gauge_walk=0.02)
    told = ColouredNoiseEKF(recording.camera, other_noise)
    told.assume(StereoNoise(noise.white), landmark=made.options.landmark, gauge_walk=noise.gauge_walk)
    *_, one = sse.run(made, recording)
    *_, other = sse.run(told, recording)
    np.testing.assert_array_equal(one.pose.position, other.pose.position)
    np.testing.assert_array_equal(one.pose.covariance, other.pose.covariance)
    with pytest.raises(ValueError, match="gauge_walk"):
        told.assume(StereoNoise(noise.white), gauge_walk=-1.0)
    with pytest.raises(ValueError, match="of the kind that the filter has, LastingErrors, got InverseDepth"):
        told.assume(StereoNoise(noise.white), landmark=InverseDepth())
    assert (told.options.landmark, told.options.gauge_walk) == (made.options.landmark, noise.gauge_walk)


def test_it_keeps_the_contract() -> None:
    check_filter(CausalNoiseEKF)
