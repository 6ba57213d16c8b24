"""The search in the images as a film (1 s)."""

import cv2
import pytest

from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.viewer.search_view import search_film

from ..datasets.small_image_folders import CAMERA, drive


def test_the_film_has_a_picture_a_pair_and_is_gone_where_that_breaks_off(tmp_path):
    def film(name, breaks_off):
        tracker = StereoTracker(CAMERA)
        with search_film("small", tmp_path / name) as watch:
            for number, pair in enumerate(list(drive().pairs())[:3]):
                watch(pair, tracker.track(pair.left, pair.right, 0.1 if number else None))
            if breaks_off:
                raise KeyboardInterrupt

    film("film.mp4", False)
    with pytest.raises(KeyboardInterrupt):
        film("broken.mp4", True)
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
    video = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 3
    video.release()
