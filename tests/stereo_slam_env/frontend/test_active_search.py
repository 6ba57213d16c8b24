"""A filter guides the search; or the same tracks are recorded for every filter (about 5 s)."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from filters import Start, make_filter
from filters.contract.noise import StereoNoise
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.track_recorder import ActiveSearch, record_tracks

from .drawn_street import CAMERA, DT, DrawnStreet

SETTINGS = TrackerSettings(max_landmarks=50, refill_below=40)


def a_filter():
    return make_filter("inverse-depth", camera=CAMERA, noise=StereoNoise.diagonal(0.3, 0.3, 0.3))


def test_a_filter_guides_the_search_for_twenty_pairs():
    street, seen, positions = DrawnStreet(20, step=(0.01, 0.0, 0.15)), [], []
    search, estimator = ActiveSearch(street, SETTINGS, lambda _, pair: seen.append(pair)), a_filter()
    for number in range(20):
        if number:
            estimator.predict(DT)
        estimator.update(search.observe(number, estimator))
        positions.append(estimator.pose.position)
    assert min(len(pair.observation) for pair in seen) >= SETTINGS.refill_below - 10
    true = np.array([street.pose(number)[1] for number in range(20)])
    assert np.linalg.norm(np.array(positions) - true, axis=1).max() < 0.05


def test_zero_starts_again_with_the_same_bits():
    search = ActiveSearch(DrawnStreet(3), SETTINGS)
    estimator = a_filter()
    first = search.observe(0, estimator)
    again = search.observe(0, estimator)
    assert np.array_equal(first.ids, again.ids)
    assert np.array_equal(first.uvd, again.uvd)


def test_pairs_come_in_order_and_end():
    search = ActiveSearch(DrawnStreet(1), SETTINGS)
    estimator = a_filter()
    with pytest.raises(ValueError, match="number must be 0 or 0, the next pair, got 2"):
        search.observe(2, estimator)
    search.observe(0, estimator)
    with pytest.raises(ValueError, match="no more pairs"):
        search.observe(1, estimator)


def test_a_pair_that_a_bad_forecast_was_refused_for_can_be_asked_for_again():
    observed = []
    for refused in (False, True):
        search, estimator = ActiveSearch(DrawnStreet(2), SETTINGS), a_filter()
        estimator.update(search.observe(0, estimator))
        estimator.predict(DT)
        if refused:
            forecast = estimator.forecast()
            bad = SimpleNamespace(forecast=lambda told=forecast: dataclasses.replace(told, uvd=np.nan * told.uvd))
            with pytest.raises(ValueError, match=r"forecast\.uvd must be finite"):
                search.observe(1, bad)
        observed.append(search.observe(1, estimator))
    assert len(observed[0]) > 10
    assert np.array_equal(observed[0].uvd, observed[1].uvd)


def test_a_recording_has_a_frame_for_each_pair_with_the_truth_of_the_sequence():
    street = DrawnStreet(5)
    watched, progress = [], []
    recording = record_tracks(
        street,
        SETTINGS,
        frames=4,
        watch=lambda pair, tracked: watched.append((pair.timestamp, len(tracked.observation))),
        progress=lambda done, wanted: progress.append((done, wanted)),
    )
    assert len(recording) == 4
    assert [frame.timestamp for frame in recording.frames] == pytest.approx(DT * np.arange(4))
    assert watched == [(frame.timestamp, len(frame.observation)) for frame in recording.frames]
    assert progress == [(1, 4), (2, 4), (3, 4), (4, 4)]
    for number, frame in enumerate(recording.frames):
        assert frame.truth.position == pytest.approx(street.pose(number)[1])
        assert frame.observation.R.shape == (len(frame.observation), 3, 3)


def test_the_source_says_how_to_make_it_again():
    recording = record_tracks(DrawnStreet(2), SETTINGS)
    written = json.loads(json.dumps(dict(recording.source)))
    assert written["drawn"] is True
    assert TrackerSettings(**written["front_end"]) == SETTINGS


def test_a_filter_is_told_the_velocity_that_the_first_two_pairs_show():
    street = DrawnStreet(3, turn=(0.0, 0.01, 0.0))
    start = record_tracks(street, SETTINGS).start
    assert start.linear_velocity == pytest.approx(np.array(street.step) / DT, abs=0.1)
    assert start.angular_velocity == pytest.approx(np.array(street.turn) / DT, abs=0.01)
    assert start.covariance is not None


def test_a_start_that_the_sequence_knows_stays():
    street = DrawnStreet(3)
    street.start = dataclasses.replace(Start(), covariance=np.eye(12))
    assert record_tracks(street, SETTINGS).start is street.start
