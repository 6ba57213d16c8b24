"""Faults of streams: what each does, and that it leaves the rest as it was (5 s)."""

import numpy as np
import pytest

from stereo_slam_env.benchmark import long_drive
from studies.faults import FAULTS, catalogue
from studies.faults.catalogue import Fault, find_fault


@pytest.fixture(scope="module")
def drive():
    return long_drive(0, frames=60, landmarks=12)


def applied(corruption, drive, seed=0):
    return corruption.applied_to(drive, np.random.default_rng(seed))


def times(recording):
    return np.array([frame.timestamp for frame in recording.frames])


def test_overtaken_frames_come_with_a_time_that_has_passed(drive):
    late = applied(catalogue.Reordered(0.3), drive)
    assert sorted(times(late)) == times(drive).tolist()
    assert 5 < (np.diff(times(late)) < 0).sum() < 30
    assert np.abs(times(late) - times(drive)).max() < 0.25


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_bad_numbers_are_in_some_frames_only(drive, value):
    bad = applied(catalogue.BadNumbers(value, frames=0.5, share=0.3), drive)
    changed = [(a.observation.uvd != b.observation.uvd) for a, b in zip(bad.frames, drive.frames, strict=True)]
    assert 15 < sum(hit.any() for hit in changed) < 45
    for hit, frame in zip(changed, bad.frames, strict=True):
        np.testing.assert_array_equal(frame.observation.uvd[hit], value)


def test_disparities_of_none_or_less_are_legal(drive):
    flat = applied(catalogue.NoDisparity(0.5), drive)
    d = np.concatenate([frame.observation.uvd[:, 2] for frame in flat.frames])
    assert 0.4 < (d <= 0).mean() < 0.6


def test_a_kidnapped_camera_goes_on_at_once_elsewhere(drive):
    moved = applied(catalogue.Kidnapped(2.0), drive)
    assert len(moved) == len(drive) - 20
    assert np.diff(times(moved)) == pytest.approx(0.1)
    assert moved.frames[0].timestamp == pytest.approx(drive.frames[0].timestamp)
    np.testing.assert_array_equal(moved.frames[0].truth.position, drive.frames[20].truth.position)


def test_time_steps_of_any_length_measure_the_same_world(drive):
    other = applied(catalogue.TimeSteps(0.001, 1.0), drive)
    steps = np.diff(times(other))
    assert steps.min() > 0.001
    assert steps.max() < 1.0
    assert steps.max() > 30 * steps.min()
    for frame in other.frames[1:]:
        ids = np.searchsorted(drive.landmarks.ids, frame.observation.ids)
        exact = drive.camera.project(frame.truth.to_camera(drive.landmarks.positions[ids]))
        assert np.abs(frame.observation.uvd - exact).max() < 6.0


def test_time_steps_that_meet_the_frames_have_their_poses(drive):
    thin = applied(catalogue.TimeSteps(0.5, 0.5), drive)
    assert len(thin) == 12
    np.testing.assert_allclose(thin.frames[3].truth.position, drive.frames[15].truth.position, atol=1e-9)


def test_a_truck_carries_its_landmarks_away_together(drive):
    still, moved = drive.frames[-1], applied(catalogue.MovingTruck(1.0, 5.0, 1.0), drive).frames[-1]
    both, at, where = np.intersect1d(still.observation.ids, moved.observation.ids, return_indices=True)
    assert len(both) > 3
    # Away from the camera: disparities shrink, but for what has just been seen for the first time.
    assert (moved.observation.uvd[where, 2] <= still.observation.uvd[at, 2] + 1e-9).all()
    assert (moved.observation.uvd[where, 2] < still.observation.uvd[at, 2]).any()


@pytest.mark.parametrize("seed", range(5))
def test_every_view_of_a_truck_shows_some_of_what_stands_still(seed):
    drive = FAULTS["truck-starts"].drive(seed)
    errors = {}  # of each landmark, frame by frame; px
    for frame in drive.frames[81:141]:
        place = np.searchsorted(drive.landmarks.ids, frame.observation.ids)
        exact = drive.camera.project(frame.truth.to_camera(drive.landmarks.positions[place]))
        off = np.abs(frame.observation.uvd - exact).max(axis=1)
        for landmark, error in zip(frame.observation.ids.tolist(), off, strict=True):
            errors.setdefault(landmark, []).append(error)
    still = {landmark for landmark, seen in errors.items() if len(seen) > 10 and np.median(seen) < 2.0}
    for frame in drive.frames[81:141]:
        assert 0.03 < np.mean([landmark in still for landmark in frame.observation.ids.tolist()]) < 0.3


def test_what_needs_the_truth_says_so(drive):
    import dataclasses

    blind = dataclasses.replace(drive, landmarks=None)
    for corruption in (catalogue.TimeSteps(0.1, 0.1), catalogue.MovingTruck(0.5, 5.0, 1.0)):
        with pytest.raises(ValueError, match="simulated drive"):
            applied(corruption, blind)


def test_a_fault_leaves_what_was_before_and_comes_after(drive):
    dark = FAULTS["empty-frames"].corruption
    fault = Fault("dark for a second", type(dark)(1.0, 0.05), begins=2.0, lasts=1.0, frames=60)
    seen = [len(frame.observation) for frame in fault.drive(0).frames]
    assert min(seen[:20]) > 0
    assert max(seen[20:30]) == 0
    assert min(seen[30:]) > 0


def test_the_same_seed_gives_the_same_bits():
    first, second = (FAULTS["outliers-30"].drive(3) for _ in range(2))
    for a, b in zip(first.frames, second.frames, strict=True):
        np.testing.assert_array_equal(a.observation.uvd, b.observation.uvd)


def test_an_unknown_fault_is_named_with_the_nearest():
    with pytest.raises(ValueError, match=r"outliers-10"):
        find_fault("outlier-10")
