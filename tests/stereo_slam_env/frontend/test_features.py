"""Front ends by features, with a detector that finds what it is told (1 s)."""

import cv2
import numpy as np
import pytest

from filters import StereoCamera
from stereo_slam_env.frontend import TrackerSettings
from stereo_slam_env.frontend.other_front_ends import FeatureFrontEnd

CAMERA = StereoCamera(400.0, 400.0, 319.5, 239.5, 0.5, 640, 480)
IMAGE = np.zeros((480, 640), dtype=np.uint8)
DT = 0.1


class Told:
    """A detector of OpenCV that is told its features: number -> pixel, of the left and the right image in turn."""

    def __init__(self, *images):
        self.images = iter(images)

    def detectAndCompute(self, image, mask):
        features = next(self.images)
        if not features:
            return (), None
        points = [cv2.KeyPoint(float(u), float(v), 5.0, -1, 100.0 - n) for n, (u, v) in features.items()]
        return points, np.eye(64, dtype=np.float32)[list(features)]


def tracked(*images, **settings):
    front_end = FeatureFrontEnd(CAMERA, TrackerSettings(**settings), Told(*images))
    return [front_end.track(IMAGE, IMAGE, None if k == 0 else DT) for k in range(len(images) // 2)]


def grid(count=12, disparity=20.0):
    """Features all over the left image, and the same in the right one."""
    left = {n: (100.0 + 40.0 * (n % 4) + 3.0 * n, 100.0 + 90.0 * (n // 4) + 2.0 * (n % 3)) for n in range(count)}
    return left, {n: (u - disparity, v) for n, (u, v) in left.items()}


def moved(features, u=0.0, v=0.0):
    return {n: (x + u, y + v) for n, (x, y) in features.items()}


def test_a_landmark_is_the_left_pixel_and_what_it_is_further_right_than_in_the_right_image():
    left, right = grid()
    (pair,) = tracked(left, right)
    assert pair.ids.tolist() == pair.initialised.tolist() == list(range(12))  # the strongest come first
    np.testing.assert_allclose(pair.uvd, [[u, v, 20.0] for u, v in left.values()])
    np.testing.assert_allclose(pair.R, np.tile(0.49 * np.array([[1, 0, 1], [0, 1, 0], [1, 0, 2]]), (12, 1, 1)))


def test_settings_move_disparities_and_claim_no_less_than_the_floor():
    (pair,) = tracked(*grid(), disparity_offset=0.5, sigma_floor=2.0)
    np.testing.assert_allclose(pair.uvd[:, 2], 20.5)
    np.testing.assert_allclose(pair.R[:, 1, 1], 4.0)


@pytest.mark.parametrize(
    ("u", "v", "measured"),
    [
        *((20.0, 1.4, True), (20.0, -1.4, True), (20.0, 1.6, False), (20.0, -1.6, False)),  # rows
        *((1.1, 0.0, True), (0.9, 0.0, False), (-5.0, 0.0, False)),  # the least disparity is 1 px
        *((79.9, 0.0, True), (80.1, 0.0, False)),  # 2.5 m is the least depth
    ],
)
def test_a_match_that_is_no_point_before_both_cameras_is_left_out(u, v, measured):
    left, right = grid()
    left[20], right[20] = (320.0, 400.0), (320.0 - u, 400.0 - v)
    (pair,) = tracked(left, right)
    assert len(pair.ids) == 12 + measured


@pytest.mark.parametrize(("column", "row"), [(8.0, 8.0), (631.9, 471.9)])
def test_the_margin_is_kept_clear_in_both_images(column, row):
    """8 px at all four edges; of the right image here, where the corner is 2 px further left."""
    left, right = grid()
    for beyond in (0.0, -0.2 if row < 240.0 else 0.2):
        for at in ((column + beyond, 300.0), (300.0, row + beyond)):
            right[20] = at
            left[20] = (at[0] + 2.0, at[1]) if at[0] < 600.0 else (at[0], at[1])
            if at[0] >= 600.0:
                right[20] = (at[0] - 2.0, at[1])
            (pair,) = tracked(left, right)
            assert len(pair.ids) == 12 + (beyond == 0.0)


def test_features_are_followed_and_those_off_the_motion_of_the_rest_begin_anew():
    """The rig moves among 40 points; one of them goes down by 0.5 m meanwhile."""
    points = np.random.default_rng(0).uniform([-3.0, -2.0, 6.0], [3.0, 2.0, 16.0], size=(40, 3))
    later = points - [0.3, 0.1, 0.5]
    later[5, 1] += 0.5
    images = []
    for uvd in (CAMERA.project(points), CAMERA.project(later)):
        images += [dict(enumerate(uvd[:, :2])), dict(enumerate(uvd[:, :2] - uvd[:, 2:] * [1.0, 0.0]))]
    first, second = tracked(*images)
    assert first.ids.tolist() == list(range(40))
    assert second.ids.tolist() == [*range(5), *range(6, 41)]
    assert second.initialised.tolist() == [40]
    np.testing.assert_allclose(second.uvd[:5], CAMERA.project(later[:5]), atol=1e-3)


@pytest.mark.parametrize("max_misses", [0, 1, 2])
def test_a_feature_is_waited_for_as_many_pairs_as_may_miss_it(max_misses):
    left, right = grid()
    few, few_right = ({n: uv for n, uv in side.items() if n != 7} for side in (left, right))
    for missing in range(4):
        images = [left, right, *[few, few_right] * missing, left, right]
        *_, last = tracked(*images, max_misses=max_misses)
        assert (7 in last.ids) == (missing <= max_misses)
        assert last.initialised.tolist() == ([] if missing <= max_misses else [12])


def test_one_that_is_waited_for_in_vain_is_dropped_then():
    left, right = grid()
    few, few_right = ({n: uv for n, uv in side.items() if n != 7} for side in (left, right))
    pairs = tracked(left, right, *[few, few_right] * 4, max_misses=2)
    assert [pair.dropped.tolist() for pair in pairs] == [[], [], [], [7], []]


def test_there_are_no_more_landmarks_than_allowed_and_the_strongest_are_taken():
    left, right = grid()
    first, second = tracked(left, right, left, right, max_landmarks=5, refill_below=5)
    assert first.ids.tolist() == second.ids.tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_allclose(first.uvd[:, :2], [left[n] for n in range(5)])


def test_an_image_without_features_ends_nothing_at_once():
    left, right = grid()
    first, empty, again = tracked(left, right, {}, {}, left, right)
    assert empty.ids.tolist() == []
    assert empty.uvd.shape == (0, 3)
    assert again.ids.tolist() == first.ids.tolist()


def test_reset_begins_at_id_0_and_needs_no_step():
    front_end = FeatureFrontEnd(CAMERA, TrackerSettings(), Told(*grid(), *grid(), *grid()))
    front_end.track(IMAGE, IMAGE)
    with pytest.raises(ValueError, match="dt must be given from the second pair on, got None"):
        front_end.track(IMAGE, IMAGE)
    front_end.reset()
    assert front_end.track(IMAGE, IMAGE).initialised.tolist() == list(range(12))
