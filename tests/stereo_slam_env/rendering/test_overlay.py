"""The picture of render()."""

import numpy as np
import pytest

from filters import Pose
from filters.contract.inputs import StereoObservation
from filters.geometry import rotations
from stereo_slam_env.rendering.overlay import annotated_pair, caption_bar
from stereo_slam_env.rendering.pinhole import StereoImages
from stereo_slam_env.sensing.rigs import RIGS

PATH = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 50.0], [30.0, 0.0, 60.0]])
POSE = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


def grey_pair(height, width):
    image = np.full((height, width, 3), 128, dtype=np.uint8)
    return StereoImages(image, image.copy(), np.full((height, width), 10.0))


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


NONE = StereoObservation([], np.zeros((0, 3)))
VIEWS = grey_pair(240, 320)
CAMERA = RIGS["qvga"]


def turned(pan):
    return Pose(POSE.position, rotations.exp_quaternion([0.0, pan, 0.0]))


def around(observation, pan):
    """The map of where the head looks, as it differs from a picture without: rows, columns from its middle."""
    plain = annotated_pair(VIEWS, NONE, ["a"], PATH, turned(pan), pan=pan).astype(int)
    marked = annotated_pair(VIEWS, observation, ["a"], PATH, turned(pan), camera=CAMERA, pan=pan).astype(int)
    return marked[20:, :320][-89:-8, -89:-8], plain[20:, :320][-89:-8, -89:-8]


@pytest.mark.parametrize("pan", [-1.2, 0.0, 0.9, 2.5])
def test_the_wedge_points_where_the_head_looks(pan):
    marked, plain = around(NONE, pan)
    blue = marked[..., 2] - marked[..., 0] > 40
    assert not (plain[..., 2] - plain[..., 0] > 40).any()
    rows, columns = np.nonzero(blue)
    bearing = np.arctan2((columns - 40.0).mean(), (40.0 - rows).mean())
    assert bearing == pytest.approx(pan, abs=0.1)
    field = 2 * np.arctan(0.5 * CAMERA.width / CAMERA.fx)
    assert blue.sum() == pytest.approx(0.5 * field * 37.5**2, rel=0.15)


@pytest.mark.parametrize("pan", [-1.2, 0.0, 0.9])
def test_landmarks_are_on_the_map_where_they_are_far_ones_on_its_rim_and_impossible_ones_nowhere(pan):
    uvd = CAMERA.project(np.array([[3.0, 0.0, 20.0]]))
    far = [[160.0, 120.0, 0.5], [160.0, 120.0, -0.5]]
    without = around(NONE, pan)[0]
    for seen, bearing, away in (
        (StereoObservation([1], uvd), pan + np.arctan2(3.0, 20.0), np.hypot(3.0, 20.0) * 37.5 / 40.0),
        (StereoObservation([1, 2], far), pan, 37.5),
    ):
        rows, columns = np.nonzero((around(seen, pan)[0] != without).any(axis=2))
        assert columns.mean() == pytest.approx(40.0 + away * np.sin(bearing), abs=1.5)
        assert rows.mean() == pytest.approx(40.0 - away * np.cos(bearing), abs=1.5)


def test_the_map_of_the_drive_shows_the_car_and_not_its_head():
    ahead = annotated_pair(VIEWS, NONE, ["a"], PATH, POSE)
    for pan in (-1.2, 0.9):
        aside = annotated_pair(VIEWS, NONE, ["a"], PATH, turned(pan), pan=pan)
        np.testing.assert_array_equal(ahead, aside)
