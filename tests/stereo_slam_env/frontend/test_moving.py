"""Landmarks on bodies that move, and their rejection (< 1 s)."""

import dataclasses

import numpy as np
import pytest

from stereo_slam_env.frontend.finding import Found
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracker import STRIKES, StereoTracker, judged, moving_together
from stereo_slam_env.frontend.tracks import Outcome, beside_moving

from .synthetic_steps import CAMERA, STEP, Cloud, tracks_of

GATE = 0.999


def judge(pairs, strikes=0, missed=(), steps=(STEP,)):
    tracks = tracks_of(pairs.first, pairs.R_first)
    tracks = dataclasses.replace(tracks, strikes=np.full(len(pairs), strikes))
    outcome = np.full(len(pairs), int(Outcome.MATCHED))
    uvd, R = pairs.second.copy(), pairs.R_second.copy()
    outcome[list(missed)], uvd[list(missed)], R[list(missed)] = Outcome.NO_MATCH, np.nan, np.nan
    return judged(CAMERA, tracks, Found(uvd, R, outcome), steps, GATE)


def test_the_scene_is_consistent():
    tracks, outcome = judge(Cloud().pairs())
    assert (outcome == Outcome.MATCHED).mean() > 0.98
    assert not tracks.moving.any()


def test_what_was_found_is_entered_and_counted():
    pairs = Cloud().pairs()
    tracks, outcome = judge(pairs, missed=(3, 4))
    assert outcome[[3, 4]].tolist() == [Outcome.NO_MATCH] * 2
    assert tracks.misses[[2, 3, 4, 5]].tolist() == [0, 1, 1, 0]
    assert tracks.age[[2, 3, 4, 5]].tolist() == [1, 0, 0, 1]
    assert np.array_equal(tracks.measured[0, 0], pairs.second[0])
    assert np.isnan(tracks.measured[3, 0]).all()


def test_one_strike_is_a_suspicion_and_the_second_in_company_a_moving_body():
    pairs = Cloud(moved=8).pairs()
    once, outcome = judge(pairs)
    assert (outcome[:8] == Outcome.INCONSISTENT).all()
    assert not once.moving.any()
    twice, outcome = judge(pairs, strikes=STRIKES - 1)
    assert (outcome[:8] == Outcome.MOVING).all()
    assert twice.moving[:8].all()
    assert twice.moving[8:].sum() == 0


def test_a_lone_stranger_is_inconsistent_but_no_body():
    pairs = Cloud(moved=1).pairs()
    tracks, outcome = judge(pairs, strikes=STRIKES)
    assert outcome[0] == Outcome.INCONSISTENT
    assert not tracks.moving.any()


def test_a_good_measurement_clears_the_strikes_and_a_miss_keeps_them():
    tracks, _ = judge(Cloud().pairs(), strikes=1, missed=(0,))
    assert tracks.strikes[0] == 1
    assert (tracks.strikes[1:] == 0).mean() > 0.98


def test_nobody_is_judged_where_the_motion_is_not_known():
    _, outcome = judge(Cloud(moved=8).pairs(), steps=())
    assert (outcome == Outcome.MATCHED).all()


@pytest.mark.parametrize("pairs_remembered", [1, 3])
def test_a_slow_body_is_told_over_several_pairs(pairs_remembered):
    """0.04 m a pair, 12 m ahead: 2.4 px that the noise hides in one pair, and not in three."""
    rng = np.random.default_rng(1)
    sigma, drift = 0.5, np.array([0.04, 0.0, 0.0])
    body = np.array([-3.0, 0.5, 15.0]) + rng.uniform(-0.7, 0.7, (8, 3))
    R = np.tile(sigma**2 * np.eye(3), (8, 1, 1))
    measured = []
    for _ in range(4):  # oldest first
        measured.append(CAMERA.project(body) + sigma * rng.standard_normal((8, 3)))
        body = (body - STEP.t) @ STEP.R + drift
    tracks = tracks_of(measured[2], R)
    for back in (2, 3):
        tracks.measured[:, back], tracks.measured_R[:, back] = measured[3 - back], R
    found = Found(measured[3], R, np.full(8, int(Outcome.MATCHED)))
    _, outcome = judged(CAMERA, tracks, found, [STEP] * pairs_remembered, GATE)
    told = (outcome == Outcome.INCONSISTENT).mean()
    assert (told > 0.5) == (pairs_remembered == 3)


def told(pairs):
    return moving_together(CAMERA, pairs.first, pairs.second, pairs.R_first, pairs.R_second, STEP)


@pytest.mark.parametrize("shift", [(0.5, 0.0, 0.0), (0.0, 0.0, 1.2), (-0.3, 0.0, -1.0)])
def test_the_points_of_a_car_move_together(shift):
    pairs = Cloud(count=8, moved=8, shift=shift).pairs()
    assert told(pairs).mean() > 0.8


def test_strangers_on_different_ways_are_no_body():
    for ways in ([30.0, -40, 55, -70, 90, -110, 130, -150], [30.0, 30.0, -40, -40, 90, 90, -110, -110]):  # or by twos
        pairs = Cloud(count=8, moved=8).pairs()
        pairs.second[:, 0] += np.array(ways)
        assert not told(pairs).any()


@pytest.mark.parametrize(("count", "together"), [(1, False), (2, False), (3, True), (4, True)])
def test_a_body_has_three_landmarks(count, together):
    pairs = Cloud(count=count, moved=count, shift=(0.5, 0.0, 0.0)).pairs()
    assert told(pairs).all() == told(pairs).any() == together


@pytest.mark.parametrize(
    ("at", "beside"),
    [
        *(((-0.1, 0.5, 15.0), True), ((0.1, 0.5, 15.0), False), ((-5.9, 0.5, 15.0), True), ((-6.1, 0.5, 15.0), False)),
        *(((-3.0, 3.4, 15.0), True), ((-3.0, 3.6, 15.0), False), ((-3.0, -2.4, 15.0), True)),
        *(((-3.0 * 19.4 / 15, 0.5 * 19.4 / 15, 19.4), True), ((-3.0 * 19.6 / 15, 0.5 * 19.6 / 15, 19.6), False)),
        *(((-3.0 * 10.6 / 15, 0.5 * 10.6 / 15, 10.6), True), ((-3.0 * 10.4 / 15, 0.5 * 10.4 / 15, 10.4), False)),
    ],
)
def test_a_body_reaches_three_metres_and_a_tenth_of_its_depth_more_along_the_view(at, beside):
    body, point = CAMERA.project(np.array([[-3.0, 0.5, 15.0]])), CAMERA.project(np.array([at]))
    assert beside_moving(CAMERA, point, body).tolist() == [beside]
    assert not beside_moving(CAMERA, point, np.zeros((0, 3))).any()


@pytest.mark.parametrize("movers", [False, True])
def test_landmarks_on_bodies_are_given_to_a_filter_that_asks_for_them(movers):
    """Eight of eighty landmarks are judged to move: they leave the map, or stay in it under their ids."""
    pairs = Cloud(moved=8).pairs()
    tracks, _ = judge(pairs, strikes=STRIKES - 1)
    tracker = StereoTracker(CAMERA, TrackerSettings(movers=movers))
    measured, after, initialised = tracker._release(tracks)
    assert np.isin(tracks.ids[:8], measured[0]).tolist() == [movers] * 8
    assert set(initialised.tolist()) == set(measured[0].tolist())
    assert after.released[8:].mean() > 0.9
