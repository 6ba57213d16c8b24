"""The pan-tilt head."""

import numpy as np
import pytest

from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.world.vehicle import Head, head_turn

HEAD = Head(0.5, max_angles=(2.0, 0.4), max_rates=(1.5, 1.0))
BODY = Pose(np.array([1.0, -2.0, 3.0]), rotations.exp_quaternion(np.array([0.1, 0.7, -0.2])))
ANGLES = np.array([0.8, -0.3])


def test_the_turn_is_pan_about_y_then_tilt_about_x():
    expected = rotations.exp([0.0, 0.8, 0.0]) @ rotations.exp([-0.3, 0.0, 0.0])
    np.testing.assert_allclose(rotations.matrix(head_turn(ANGLES)), expected, atol=1e-15)


def test_the_middle_between_the_eyes_stays_where_it_is():
    turned = HEAD.camera_pose(BODY, ANGLES)
    middles = [p.position + 0.25 * rotations.matrix(p.orientation)[:, 0] for p in (BODY, turned)]
    np.testing.assert_allclose(*middles, atol=1e-15)


def test_straight_ahead_the_camera_is_where_the_car_says():
    straight = HEAD.camera_pose(BODY, np.zeros(2))
    np.testing.assert_array_equal(straight.position, BODY.position)
    np.testing.assert_allclose(straight.orientation, BODY.orientation, atol=1e-16)


def test_the_body_pose_is_found_back():
    back = HEAD.body_pose(HEAD.camera_pose(BODY, ANGLES), ANGLES)
    np.testing.assert_allclose(back.position, BODY.position, atol=1e-14)
    np.testing.assert_allclose(back.orientation, BODY.orientation, atol=1e-15)


@pytest.mark.parametrize(("command", "expected"), [((1, 1), (0.15, 0.1)), ((-1, 0), (-0.15, 0)), ((0.05, 0), (0.1, 0))])
def test_the_head_turns_towards_the_command_as_fast_as_it_can(command, expected):
    np.testing.assert_allclose(HEAD.turned(np.zeros(2), np.array(command), 0.1), expected, atol=1e-15)


def test_the_head_stays_within_its_limits():
    angles = np.zeros(2)
    for _ in range(30):
        angles = HEAD.turned(angles, np.array([1.0, -1.0]), 0.1)
    np.testing.assert_array_equal(angles, [2.0, -0.4])
