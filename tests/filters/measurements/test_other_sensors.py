"""Sensors other than the rectified pair: they measure what they say, and filters with them are consistent."""

from __future__ import annotations

import numpy as np
import pytest

from filters import DepthCamera, FisheyePair, StereoCamera, StereoNoise, UnrectifiedPair, make_part

from ..drives import CAMERA
from ..matched_drives import HIGH, LOW, Setup, finished, mean_nees

CROOKED = UnrectifiedPair(
    left=(710.0, 705.0, 690.0, 200.0),
    right=(690.0, 700.0, 650.0, 190.0),
    left_pose=(0.01, 0.02, 0.03, 0.02, -0.01, 0.03),
    right_pose=(0.6, 0.02, -0.05, 0.01, 0.03, -0.02),
)
ALL_AROUND = StereoCamera(300.0, 300.0, 640.0, 640.0, 0.4, 1280, 1280)
SETUPS = {
    "unrectified": Setup(CROOKED),
    "depth": Setup(DepthCamera(), noise=StereoNoise.diagonal(1.0, 1.0, 0.05)),
    "fisheye": Setup(FisheyePair(), ALL_AROUND, StereoNoise.independent_pixels(0.3), visible=25),
}
POINTS = np.array([[0.5, -0.3, 4.0, 1.0], [-2.0, 1.0, 9.0, 1.0], [0.1, 0.2, 1.0, 0.0], [0.1, 0.2, 1.0, -0.01]])


def test_the_unrectified_pair_sees_each_point_by_its_own_cameras() -> None:
    point = np.array([0.5, -0.3, 4.0])
    numbers = CROOKED.predict(CAMERA, np.array([[*point, 1.0]]), {})[0]
    pixels = []
    for own, pose in ((CROOKED.left, CROOKED.left_pose), (CROOKED.right, CROOKED.right_pose)):
        theta = np.linalg.norm(pose[3:])
        axis = np.array(pose[3:]) / theta
        p = point - np.array(pose[:3])  # turned back by Rodrigues' formula
        p = np.cos(theta) * p - np.sin(theta) * np.cross(axis, p) + (1.0 - np.cos(theta)) * (axis @ p) * axis
        pixels.append([own[0] * p[0] / p[2] + own[2], own[1] * p[1] / p[2] + own[3]])
    (u, v), (u_right, v_right) = pixels
    assert numbers == pytest.approx([u, v, u - u_right, v_right], abs=1e-9)


def test_an_unrectified_pair_with_a_rectified_geometry_is_the_rectified_pair() -> None:
    with_rows = Setup(UnrectifiedPair())  # its drives have a v_right, which both filters use
    slam, _ = finished(with_rows, 0)
    other, _ = finished(with_rows, 0, measurement="stacked")
    assert slam.pose.position == pytest.approx(other.pose.position, abs=1e-9)
    assert slam.pose.orientation == pytest.approx(other.pose.orientation, abs=1e-9)
    assert slam.pose.covariance == pytest.approx(other.pose.covariance, rel=1e-7, abs=1e-12)
    assert slam.landmarks.positions == pytest.approx(other.landmarks.positions, abs=1e-9)


def test_the_disparity_of_a_fisheye_point_on_the_horizontal_is_an_angle() -> None:
    """At y = 0 the column is f times the angle to the axis, also beyond 90 degrees."""
    for angle in (0.3, 1.2, 1.7):
        point = 5.0 * np.array([np.sin(angle), 0.0, np.cos(angle)])
        right = np.arctan2(point[0] - ALL_AROUND.baseline, point[2])
        u, v, d, v_right = FisheyePair().predict(ALL_AROUND, np.array([[*point, 1.0]]), {})[0]
        assert (u, d) == pytest.approx((640.0 + 300.0 * angle, 300.0 * (angle - right)), abs=1e-9)
        assert (v, v_right) == pytest.approx((640.0, 640.0), abs=1e-9)


def test_a_fisheye_sees_beyond_90_degrees_and_no_further_than_its_half_angle() -> None:
    angles = np.array([0.0, 1.5, 1.7, 2.0])
    points = np.column_stack([np.sin(angles), 0.0 * angles, np.cos(angles), np.ones(4)])
    assert FisheyePair(half_angle=1.8).in_front(points).tolist() == [True, True, True, False]


def test_a_fisheye_landmark_four_baselines_away_is_started_where_it_is() -> None:
    """To rounding, in every direction in which one is started."""
    directions = np.random.default_rng(0).normal(size=(100_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.column_stack([directions, np.full(len(directions), 0.25 / ALL_AROUND.baseline)])
    points = points[FisheyePair().in_front(points)]
    seen = FisheyePair().predict(ALL_AROUND, points, {})
    found = FisheyePair().backproject(ALL_AROUND, seen[:, :3], {})
    started = np.isfinite(found[:, 3])
    assert started.mean() > 0.9
    np.testing.assert_allclose(found[started], points[started], rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("baselines", [1.0, 1.5, 8.0])
def test_a_fisheye_landmark_that_is_started_is_seen_where_it_was_measured(baselines: float) -> None:
    """Close ones, too, for which Newton's method may go astray."""
    directions = np.random.default_rng(1).normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.column_stack([directions, np.full(len(directions), 1.0 / (baselines * ALL_AROUND.baseline))])
    seen = FisheyePair().predict(ALL_AROUND, points[FisheyePair().in_front(points)], {})
    found = FisheyePair().backproject(ALL_AROUND, seen[:, :3], {})
    started = np.isfinite(found[:, 3])
    again = FisheyePair().predict(ALL_AROUND, found[started], {})
    np.testing.assert_allclose(again[:, :3], seen[started, :3], rtol=0.0, atol=2e-6)


def test_a_fisheye_landmark_is_not_started_where_the_disparity_says_too_little() -> None:
    along_the_baseline = FisheyePair().predict(ALL_AROUND, np.array([[5.0, 0.1, 0.2, 1.0]]), {})
    assert np.isnan(FisheyePair().backproject(ALL_AROUND, along_the_baseline[:, :3], {})[0, 3])


def test_a_depth_is_that_along_the_axis_and_a_point_at_infinity_has_none() -> None:
    sensor = DepthCamera()
    assert sensor.predict(CAMERA, POINTS[:2], {})[:, 2] == pytest.approx([4.0, 9.0])
    assert sensor.in_front(POINTS).tolist() == [True, True, False, False]
    no_depth = sensor.backproject(CAMERA, np.array([[600.0, 200.0, 0.0], [600.0, 200.0, -1.0]]), {})
    assert not np.isfinite(no_depth[:, 3]).any()


@pytest.mark.slow
@pytest.mark.parametrize("name", SETUPS)
def test_the_pose_is_as_certain_as_it_is_right(name: str) -> None:
    setup = SETUPS[name]
    assert LOW < mean_nees(lambda seed: setup) < HIGH


@pytest.mark.parametrize("settings", [{"left": (700.0, 700.0, 600.0)}, {"right": (0.0, 700.0, 600.0, 200.0)}])
def test_impossible_settings_of_an_unrectified_pair_are_refused(settings: dict) -> None:
    (name,) = settings
    with pytest.raises(ValueError, match=rf"^{name} must "):
        make_part("measurement", {"name": "unrectified", **settings})
