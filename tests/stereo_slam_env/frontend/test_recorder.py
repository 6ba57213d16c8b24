"""The same tracks for every filter (about 2 s)."""

import dataclasses
import json

import numpy as np
import pytest

from filters import Start
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.track_recorder import record_tracks

from .drawn_street import DT, DrawnStreet

SETTINGS = TrackerSettings(max_landmarks=40, refill_below=30)


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
