"""A trajectory from outside stands beside filters as a run: the same figures as the filter whose file it is (10 s)."""

from dataclasses import replace

import numpy as np
import pytest

import stereo_slam_env as sse
from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.evaluation.outside_run import outside_run
from stereo_slam_env.evaluation.trial import Trial, estimate_of

ELSEWHERE = Pose([5.0, -3.0, 2.0], rotations.exp_quaternion([0.3, 1.0, -0.4]))


@pytest.fixture(scope="module")
def recording():
    return sse.make_recording("reference-turn", 0)


@pytest.fixture(scope="module")
def run(recording):
    return sse.evaluate("frame-to-frame", recording, gate=0.99).series


@pytest.fixture(scope="module")
def trajectory(run):
    return estimate_of(run)


def same(found, right, *names, rtol=1e-6, first=1):
    for name in names:
        np.testing.assert_allclose(getattr(found, name)[first:], getattr(right, name)[first:], rtol=rtol, atol=1e-9)


def test_the_file_of_a_filter_has_the_errors_and_the_nees_of_the_filter(recording, run, trajectory):
    found = outside_run(recording, trajectory)
    same(found, run, "positions", "orientations", "pose_covariances", "pose_nees", "position_nees", "rotation_nees")
    assert found.failure is None
    assert np.isnan(found.milliseconds).all()
    assert Trial(found, 10.0).alarm is None
    assert Trial(found, 10.0).position_rmse == pytest.approx(Trial(run, 10.0).position_rmse, rel=1e-9)


def test_a_world_of_its_own_is_brought_to_that_of_the_recording_by_the_first_pose(recording, run, trajectory):
    start = recording.frames[0].truth
    moved = replace(trajectory.moved(ELSEWHERE), gauge="se3")
    found = outside_run(recording, moved)
    np.testing.assert_allclose(found.positions[0], start.position, atol=1e-9)
    same(found, run, "positions", "pose_nees", rtol=1e-3, first=2)


def test_a_claimed_trajectory_has_windows(recording, run, trajectory):
    truth = sse.Trajectory(run.true_positions, run.true_orientations, run.timestamps)
    bare = replace(trajectory, covariances=None, gauge=None)
    claimed = sse.claim(bare, sse.calibrate([bare], [truth]))
    found = outside_run(recording, claimed)
    score = sse.evaluate_trajectory(claimed, truth)
    assert np.nanmean(found.window_nees_1s) == pytest.approx(score.windows[0].nees, rel=0.05)
    assert 0.3 < np.nanmean(found.pose_nees) / 6.0 < 3.0
    assert np.nanmean(found.pose_nees) == pytest.approx(score.claims["pose"].nees.mean, rel=1e-6)


def test_what_claims_nothing_has_errors_and_no_nees(recording, run, trajectory):
    found = outside_run(recording, replace(trajectory, covariances=None))
    same(found, run, "positions")
    assert np.isnan(found.pose_nees).all()
    assert Trial(found, 10.0).final_covariance is None


def test_frames_without_a_pose_stay_unknown_and_late_poses_begin_at_the_truth(recording, trajectory):
    rows = np.arange(4, len(trajectory), 3)
    found = outside_run(recording, replace(trajectory.rows(rows), gauge=None, covariances=None))
    assert np.isfinite(found.positions[:, 0]).sum() == len(rows)
    np.testing.assert_allclose(found.positions[4], recording.frames[4].truth.position, atol=1e-9)


def test_the_first_pose_counts_only_in_the_world_of_the_recording(recording, trajectory):
    """In another one it is put where the vehicle was: its error is none of its own."""
    claimed = replace(trajectory, covariances=trajectory.covariances + 1e-6 * np.eye(6))
    fixed = outside_run(recording, replace(claimed, gauge="fixed"))
    free = outside_run(recording, replace(trajectory, gauge="se3"))
    assert np.isfinite(fixed.pose_nees[:5]).all()
    assert np.isfinite(free.pose_nees[:5]).tolist() == [False, True, True, True, True]


def test_poses_without_times_belong_to_the_frames_of_their_numbers(recording, run, trajectory):
    """Numbers of no frame are left out."""
    numbers = np.array([0, 2, 3, 7, 9])
    bare = replace(trajectory, covariances=None, timestamps=None, gauge="fixed")
    some = replace(bare.rows(numbers), frame_numbers=numbers)
    found = outside_run(recording, some)
    assert found.failure is None
    assert np.flatnonzero(np.isfinite(found.positions[:, 0])).tolist() == [0, 2, 3, 7, 9]
    np.testing.assert_array_equal(found.positions[[2, 7]], run.positions[[2, 7]])
    beyond = replace(some, frame_numbers=np.where(numbers == 9, len(recording), numbers))
    assert np.isfinite(outside_run(recording, beyond).positions[:, 0]).sum() == 4
    whole = outside_run(recording, bare)
    np.testing.assert_array_equal(whole.positions, run.positions)


@pytest.mark.parametrize(
    ("late", "paired"), [(0.0, True), (0.009, True), (-0.009, True), (0.011, False), (-0.011, False)]
)
def test_a_pose_is_that_of_the_nearest_frame_within_a_hundredth_of_a_second(recording, trajectory, late, paired):
    times = trajectory.timestamps.copy()
    times[3] += late
    found = outside_run(recording, replace(trajectory, covariances=None, gauge="fixed", timestamps=times))
    assert np.isfinite(found.positions[3]).all() == paired
    assert np.isfinite(np.delete(found.positions, 3, axis=0)).all()


def test_of_two_poses_of_one_frame_the_nearer_one_in_time_is_taken(recording, trajectory):
    times = trajectory.timestamps.copy()
    times[4] = times[3] + 0.004
    found = outside_run(recording, replace(trajectory, covariances=None, gauge="fixed", timestamps=times))
    np.testing.assert_array_equal(found.positions[3], trajectory.positions[3])
    assert np.isnan(found.positions[4]).all()


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (lambda t: replace(t, timestamps=t.timestamps + 1e6), "has no pose at the time of a frame"),
        (lambda t: replace(t.rows(slice(0, 9)), timestamps=None), "9 poses without times"),
        (lambda t: replace(t, covariances=-t.covariances), "frame 1: its covariance is not positive definite"),
    ],
)
def test_what_cannot_be_held_against_the_recording_is_a_run_that_failed(recording, trajectory, changed, reason):
    assert reason in outside_run(recording, changed(trajectory)).failure
