"""The picture of render()."""

import numpy as np
import pytest

from filters.interface import StereoObservation
from stereo_slam_env.recording import Pose
from stereo_slam_env.rendering.drawing import caption_bar
from stereo_slam_env.rendering.images import StereoImages
from stereo_slam_env.rendering.overlay import annotated_pair
from stereo_slam_env.sensing.rigs import RIGS

PATH = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 50.0], [30.0, 0.0, 60.0]])
POSE = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


def grey_pair(height, width):
    image = np.full((height, width, 3), 128, dtype=np.uint8)
    return StereoImages(image, image.copy(), np.full((height, width), 10.0))


@pytest.mark.parametrize(("size", "stacked"), [((200, 640), True), ((240, 320), False)])
def test_wide_views_are_stacked_and_others_side_by_side(size, stacked):
    picture = annotated_pair(grey_pair(*size), StereoObservation([], np.zeros((0, 3))), ["a"], PATH, POSE)
    assert picture.dtype == np.uint8
    height, width = size
    assert picture.shape[1] == (width if stacked else 2 * width + 4)  # 3 between them and 1 to be even
    assert picture.shape[0] > (2 * height if stacked else height)


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("extra", [0, 1])
def test_pictures_have_even_sides_for_video_codecs(rig, extra):
    views = grey_pair(RIGS[rig].height + extra, RIGS[rig].width + extra)
    picture = annotated_pair(views, StereoObservation([], np.zeros((0, 3))), ["a"], PATH, POSE)
    assert [side % 2 for side in picture.shape[:2]] == [0, 0]


def test_landmarks_are_marked_in_both_views_and_the_input_is_not_touched():
    pair = grey_pair(200, 640)
    empty = annotated_pair(pair, StereoObservation([], np.zeros((0, 3))), ["a"], PATH, POSE)
    marked = annotated_pair(pair, StereoObservation([4], [[300.0, 100.0, 40.0]], [101.0]), ["a"], PATH, POSE)
    rows, columns = np.nonzero((marked != empty).any(axis=2))
    bar = caption_bar(640, ["a"]).shape[0]
    left, right = rows < bar + 200, rows >= bar + 203
    assert columns[left].mean() == pytest.approx(300, abs=0.5)
    assert rows[left].mean() == pytest.approx(bar + 100, abs=0.5)
    assert columns[right].mean() == pytest.approx(260, abs=0.5)
    assert rows[right].mean() == pytest.approx(bar + 203 + 101, abs=0.5)
    assert (pair.left == 128).all()


def test_near_and_far_have_different_colours():
    observation = StereoObservation([1, 2], [[200.0, 100.0, 60.0], [400.0, 100.0, 4.0]])
    marked = annotated_pair(grey_pair(200, 640), observation, ["a"], PATH, POSE).astype(int)
    bar = caption_bar(640, ["a"]).shape[0]
    near, far = marked[bar + 100, 200], marked[bar + 100, 400]
    assert near[0] > near[2]
    assert far[2] > far[0]
