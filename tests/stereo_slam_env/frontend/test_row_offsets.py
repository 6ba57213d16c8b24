"""Rows of corners tell rectified pairs from others (2 s)."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stereo_slam_env.frontend.rectification_errors import calibrated, require_rectified, row_offsets
from stereo_slam_env.recording.recording import StereoPair

from .drawn_street import CAMERA, DrawnStreet

K = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1.0]])


def turned(image, rotation):
    """The image of a camera that is turned by this rotation vector, rad."""
    H = K @ Rotation.from_rotvec(rotation).as_matrix() @ np.linalg.inv(K)
    return cv2.warpPerspective(image, H, (CAMERA.width, CAMERA.height), borderMode=cv2.BORDER_REPLICATE)


def pairs(rotation=(0.0, 0.0, 0.0), count=8):
    return [(pair.left, turned(pair.right, rotation)) for pair in DrawnStreet(count).pairs()]


def test_the_rows_of_a_rectified_pair_agree():
    rows = row_offsets(pairs())
    assert len(rows.offset) > 150
    assert rows.spread < 0.1
    assert rows.beyond_infinity == 0.0
    require_rectified(rows, CAMERA, "street")


@pytest.mark.parametrize("rotation", [(0.001, 0.0, 0.0), (0.0, 0.001, 0.0), (0.0, 0.0, 0.002)])
def test_what_a_calibration_leaves_is_let_pass(rotation):
    require_rectified(row_offsets(pairs(rotation)), CAMERA, "street")


@pytest.mark.parametrize(
    ("rotation", "complaint"),
    [
        ((0.012, 0.0, 0.0), r"no rectified pair \(pitch [+-]3\.\d"),
        ((0.0, 0.0, 0.015), r"no rectified pair .*roll [+-]1[45]\.\d"),
        ((0.0, 0.0, np.deg2rad(0.35)), r"no rectified pair .*roll [+-][56]\.\d"),
        ((0.0, 0.0, -np.deg2rad(0.35)), r"no rectified pair .*roll [+-][56]\.\d"),
        ((0.0, 0.06, 0.0), r"corners lie beyond infinity|yaw [+-][56]\d\.\d|turned to each other \(yaw\)"),
        ((0.0, -0.06, 0.0), r"corners lie beyond infinity|yaw [+-][56]\d\.\d|turned to each other \(yaw\)"),
    ],
)
def test_a_camera_that_is_turned_is_refused_with_what_turns_it(rotation, complaint):
    with pytest.raises(ValueError, match=f"street: .*({complaint})") as error:
        require_rectified(row_offsets(pairs(rotation)), CAMERA, "street")
    assert "\n" not in str(error.value)


def test_left_and_right_that_are_swapped_are_named():
    with pytest.raises(ValueError, match=r"\d+ % of its disparities are negative: are left and right swapped"):
        require_rectified(row_offsets([(right, left) for left, right in pairs()]), CAMERA, "street")


def test_one_camera_given_twice_is_named():
    with pytest.raises(ValueError, match="street: left and right images are the same"):
        require_rectified(row_offsets([(left, left.copy()) for left, _ in pairs()]), CAMERA, "street")


def test_images_upside_down_are_among_the_reasons():
    with pytest.raises(ValueError, match="the images of both upside down"):
        require_rectified(row_offsets([(left[::-1, ::-1], right[::-1, ::-1]) for left, right in pairs()]), CAMERA, "s")


def test_few_corners_convict_nobody():
    flat = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    rows = row_offsets([(flat, flat)])
    assert rows.spread == np.inf
    require_rectified(rows, CAMERA, "street")
    require_rectified(row_offsets([]), CAMERA, "street")


class Yawed(DrawnStreet):
    """The right camera looks away from the left one, or towards it: rows hardly tell."""

    def __init__(self, count, yaw):
        super().__init__(count)
        self.yaw = yaw

    def pair(self, number):
        one = super().pair(number)
        return StereoPair(one.timestamp, one.left, turned(one.right, (0.0, self.yaw, 0.0)), one.truth)


@pytest.mark.parametrize("yaw", [-0.012, np.deg2rad(0.3), -np.deg2rad(0.3)])
def test_a_yaw_that_no_row_shows_is_refused_by_the_motion(yaw):
    with pytest.raises(ValueError, match=r"all disparities are off by [+-]\d\.\d .* px, by the motion, a yaw of \d"):
        calibrated(Yawed(30, yaw))


def test_a_yaw_that_calibrations_leave_is_let_pass():
    calibrated(Yawed(30, 0.0005))
