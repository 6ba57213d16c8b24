"""What the front end promises, on drawn streets with exact truth (about 10 s)."""

import dataclasses

import numpy as np
import pytest

from filters.contract.outputs import Forecast
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.frontend.tracks import Outcome

from .drawn_street import CAMERA, CAR, DT, STREET, DrawnStreet, Truth

SETTINGS = TrackerSettings(max_landmarks=60, refill_below=50)


def run(street, numbers, settings=SETTINGS, tracker=None, change=None):
    """Track the pairs `numbers` and yield (number, tracked); `change` may paint over the images."""
    tracker = StereoTracker(CAMERA, settings) if tracker is None else tracker
    before = None
    for number in numbers:
        pair = street.pair(number)
        left, right = (pair.left, pair.right) if change is None else change(number, pair.left, pair.right)
        yield number, tracker.track(left, right, None if before is None else (number - before) * DT)
        before = number


def same(a, b):
    """Whether two observations are the same bits."""
    return all(np.array_equal(x, y) for x, y in ((a.ids, b.ids), (a.uvd, b.uvd), (a.R, b.R)))


def outcome_of(tracked, ids):
    return tracked.search.outcome[np.isin(tracked.search.ids, ids)]


@pytest.fixture(scope="module")
def drive():
    """Twelve pairs of a drive: street, truth, what was tracked."""
    street = DrawnStreet(12)
    truth, pairs = Truth(street), []
    for number, tracked in run(street, range(12)):
        truth.note(number, tracked)
        pairs.append(tracked)
    return street, truth, pairs


# Ids and life.


def test_ids_ascend_and_a_landmark_begins_once_and_ends_once(drive):
    _, _, pairs = drive
    new = np.concatenate([pair.corners.ids for pair in pairs])
    assert np.array_equal(new, np.arange(len(new)))
    assert len(pairs[0].observation) == SETTINGS.max_landmarks
    had, gone = set(), set()
    for pair in pairs:
        for ids in (pair.observation.ids, pair.search.ids, pair.initialised, pair.dropped):
            assert (np.diff(ids) > 0).all()
        seen, begun, dropped = (set(ids.tolist()) for ids in (pair.observation.ids, pair.initialised, pair.dropped))
        assert dropped <= had - gone
        gone |= dropped
        assert not begun & had
        had |= begun
        assert seen <= had - gone
        assert SETTINGS.refill_below <= len(seen) <= SETTINGS.max_landmarks
        free = SETTINGS.max_landmarks - len(np.setdiff1d(pair.ids, pair.corners.ids))
        assert len(begun & set(pair.corners.ids.tolist())) == min(len(pair.corners), free)


def test_a_landmark_out_of_view_is_dropped_and_reported():
    street = DrawnStreet(10, turn=(0.0, 0.06, 0.0))
    left_view, gone = 0, set()
    for _, tracked in run(street, range(8)):
        out = tracked.search.ids[tracked.search.outcome == Outcome.OUT_OF_VIEW]
        first = set(out[out < SETTINGS.max_landmarks].tolist())  # the filter had all of these
        gone |= set(tracked.dropped.tolist())
        left_view += len(first)
        assert first <= gone
    assert left_view > 10


COVER = np.s_[40:200, 150:340]


def well_covered(tracked):
    """Ids of the landmarks that will be behind the cover, wherever they are searched for."""
    u, v = tracked.observation.uvd[:, :2].T
    return tracked.observation.ids[(u > 170) & (u < 320) & (v > 60) & (v < 180)]


def test_a_covered_landmark_is_missed_and_dropped_when_missed_too_often():
    street, behind = DrawnStreet(8), np.zeros(0)

    def covered(number, left, right):
        if number >= 2:
            for image in (left, right):
                image[COVER] = 90
        return left, right

    outcomes, dropped_at = [], {}
    for number, tracked in run(street, range(8), change=covered):
        if number == 1:
            behind = well_covered(tracked)
            assert len(behind) >= 5
        if number >= 2:
            outcomes.append(outcome_of(tracked, behind))
            dropped_at |= dict.fromkeys(tracked.dropped.tolist(), number)
            assert not np.isin(tracked.observation.ids, behind).any()
    allowed = SETTINGS.max_misses
    for missed in outcomes[: allowed + 1]:
        assert len(missed) == len(behind)
        assert (missed == Outcome.NO_MATCH).all()
    assert len(outcomes[allowed + 1]) == 0
    assert [dropped_at[i] for i in behind.tolist()] == [2 + allowed] * len(behind)


def test_a_landmark_missed_for_a_while_is_found_again():
    street = DrawnStreet(8)

    def covered(number, left, right):
        if number in (3, 4):
            left[COVER] = 90
        return left, right

    for number, tracked in run(street, range(7), change=covered):
        if number == 2:
            behind = well_covered(tracked)
    assert np.isin(behind, tracked.observation.ids).mean() > 0.8


# Measurements.


def test_measurements_are_within_a_third_of_a_pixel(drive):
    _, truth, pairs = drive
    facing = {0, 3}  # the boards that the model of a patch holds for: planes that face the camera
    errors = []
    for number, pair in enumerate(pairs):
        on_facing = np.array([truth.board[i] in facing for i in pair.observation.ids.tolist()])
        errors.append(truth.errors(number, pair.observation.select(on_facing)))
    worst = np.abs(np.concatenate(errors)).max(axis=0)
    assert len(np.concatenate(errors)) > 200
    assert (worst < 0.3).all()


def test_most_measurements_are_within_a_tenth_of_a_pixel_on_any_surface(drive):
    _, truth, pairs = drive
    errors = np.abs(np.concatenate([truth.errors(number, pair.observation) for number, pair in enumerate(pairs)]))
    assert (np.quantile(errors, 0.9, axis=0) < 0.1).all()


def test_the_motion_of_the_camera_comes_with_it():
    street = DrawnStreet(6)
    tracker = StereoTracker(CAMERA, SETTINGS)
    assert tracker.last_step is None
    for _ in run(street, range(3), tracker=tracker):
        pass
    step, dt = tracker.last_step
    assert dt == pytest.approx(DT)
    assert step.t == pytest.approx(street.step, abs=0.01)
    assert step.R[0, 2] == pytest.approx(street.turn[1], abs=5e-4)


# Bodies that move.


def landmarks_on(car, seed=0):
    """Ids of the landmarks on a car in eight pairs: all, those given more than once, which move a filter; dropped."""
    street = DrawnStreet(8, boards=(*STREET, car), seed=seed)
    truth, given, stayed, dropped = Truth(street), set(), set(), set()
    settings = dataclasses.replace(SETTINGS, max_landmarks=100, refill_below=90)
    for number, tracked in run(street, range(8), settings):
        truth.note(number, tracked)
        on_car = {i for i in tracked.observation.ids.tolist() if truth.board[i] == len(STREET) and truth.clean[i]}
        stayed |= on_car & given
        given |= on_car
        dropped |= set(tracked.dropped.tolist())
    return given, stayed, dropped


def test_landmarks_on_a_fast_body_do_not_stay():
    given, stayed, dropped = landmarks_on(CAR)
    assert given
    assert given <= dropped
    assert not stayed


def test_of_the_landmarks_on_a_slow_body_one_in_twenty_may_stay():
    """Which ones do depends on the version of OpenCV, whose corners differ a little."""
    car = dataclasses.replace(CAR, velocity=(0.9, 0.0, 0.6))
    drives = [landmarks_on(car, seed) for seed in range(12)]
    given, stayed = (sum(len(drive[kind]) for drive in drives) for kind in (0, 1))
    assert given > 60
    assert stayed <= 0.05 * given


def test_the_motion_is_that_of_the_scene_in_spite_of_a_car():
    street = DrawnStreet(6, boards=(*STREET, CAR))
    tracker = StereoTracker(CAMERA, SETTINGS)
    for _ in run(street, range(6), tracker=tracker):
        pass
    assert tracker.last_step[0].t == pytest.approx(street.step, abs=0.01)


# Where landmarks are searched for.


def test_a_forecast_says_where_to_search():
    """The camera stops dead: constant velocity would look 30 px off, the forecast does not."""
    street = DrawnStreet(4, step=(0.0, 0.0, 0.6), turn=(0.0, 0.0, 0.0))
    tracker = StereoTracker(CAMERA, SETTINGS)
    for _ in run(street, range(3), tracker=tracker):
        pass
    stopped = street.pair(2)
    tracks = tracker._tracks
    seen = tracks.misses == 0
    S = np.tile(np.eye(3), (int(seen.sum()), 1, 1))
    here = Forecast(tracks.ids[seen], tracks.uvd[seen], S, np.ones(int(seen.sum()), dtype=bool))
    tracked = tracker.track(stopped.left, stopped.right, DT, here)
    off = np.linalg.norm(tracked.search.predicted - tracked.search.found, axis=1)
    assert (tracked.search.outcome == Outcome.MATCHED).mean() > 0.9
    assert np.nanmax(off) < 1.0
    assert tracker.last_step[0].t == pytest.approx(np.zeros(3), abs=0.01)


def test_a_jump_that_no_motion_explains_is_found_by_optical_flow():
    street = DrawnStreet(14, turn=(0.0, 0.008, 0.0))
    numbers = [0, 1, 2, 3, 9, 10]  # five pairs are missing, and nobody says so
    tracker = StereoTracker(CAMERA, SETTINGS)
    kept, before, truth = [], None, Truth(street)
    for number in numbers:
        pair = street.pair(number)
        tracked = tracker.track(pair.left, pair.right, DT if number else None)
        truth.note(number, tracked)
        if before is not None:
            kept.append(np.isin(before.ids, tracked.observation.ids).mean())
        before = tracked.observation
        assert np.abs(np.median(truth.errors(number, tracked.observation), axis=0)).max() < 0.1
    jump, after = kept[3], kept[4]
    assert jump > 0.4
    assert after > 0.8


# Images that show nothing.


def test_tracking_recovers_after_black_images():
    street = DrawnStreet(12)

    def blackout(number, left, right):
        return (np.zeros_like(left), np.zeros_like(right)) if number in (3, 4, 5, 6) else (left, right)

    counts, truth = [], Truth(street)
    for number, tracked in run(street, range(12), change=blackout):
        truth.note(number, tracked)
        counts.append(len(tracked.observation))
        if number > 8:
            assert np.median(np.abs(truth.errors(number, tracked.observation)), axis=0).max() < 0.1
    assert counts[3:7] == [0, 0, 0, 0]
    assert min(counts[10:]) >= SETTINGS.refill_below


# Bad input, and the same again; that refusals leave no trace: `test_random_use.py`.


def test_bad_input_is_named():
    tracker, pair = StereoTracker(CAMERA, SETTINGS), DrawnStreet().pair(0)
    tracker.track(pair.left, pair.right)
    for left, right, dt, message in (
        (pair.left[:100], pair.right, DT, "left must be a grey uint8 image"),
        (pair.left, pair.right.astype(np.float32), DT, "right must be a grey uint8 image"),
        (pair.left, None, DT, "right must be a grey uint8 image.*NoneType"),
        (pair.left, pair.right, None, "dt must be given"),
        (pair.left, pair.right, -0.1, "dt must be"),
    ):
        with pytest.raises(ValueError, match=message):
            tracker.track(left, right, dt)


def test_reset_forgets_everything_and_the_same_images_give_the_same_bits():
    street = DrawnStreet(4)
    tracker = StereoTracker(CAMERA, SETTINGS)
    first = [tracked for _, tracked in run(street, range(4), tracker=tracker)]
    tracker.reset()
    assert tracker.last_step is None
    assert tracker.longest_pairs() is None
    again = [tracked for _, tracked in run(street, range(4), tracker=tracker)]
    for a, b in zip(first, again, strict=True):
        assert same(a.observation, b.observation)
        assert np.array_equal(a.search.outcome, b.search.outcome)
        assert np.array_equal(a.dropped, b.dropped)
