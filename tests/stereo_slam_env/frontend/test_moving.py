"""Landmarks on bodies that move (< 1 s)."""

import numpy as np
import pytest

from stereo_slam_env.frontend.tracker import beside_moving, moving_together

from .synthetic_steps import CAMERA, STEP, Cloud


def told(pairs):
    return moving_together(CAMERA, pairs.first, pairs.second, pairs.R_first, pairs.R_second, STEP)


@pytest.mark.parametrize("shift", [(0.5, 0.0, 0.0), (0.0, 0.0, 1.2), (-0.3, 0.0, -1.0)])
def test_the_points_of_a_car_move_together(shift):
    pairs = Cloud(count=8, moved=8, shift=shift).pairs()
    assert told(pairs).mean() > 0.8


def test_strangers_on_different_ways_are_no_body():
    pairs = Cloud(count=8, moved=8).pairs()
    pairs.second[:, 0] += np.array([30.0, -40, 55, -70, 90, -110, 130, -150])
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
