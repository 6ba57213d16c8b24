"""The search in the images as a film (1 s)."""

import cv2
import pytest

from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.viewer.search_view import search_film

from ..datasets.small_image_folders import CAMERA, drive


def show(watch, pairs=3):
    tracker = StereoTracker(CAMERA)
    for number, pair in enumerate(list(drive().pairs())[:pairs]):
        watch(pair, tracker.track(pair.left, pair.right, 0.1 if number else None))


def test_the_film_has_a_picture_a_pair(tmp_path):
    with search_film("small", tmp_path / "film.mp4") as watch:
        show(watch)
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 3
    film.release()


def test_no_film_is_left_by_what_breaks_off(tmp_path):
    def breaks_off():
        with search_film("small", tmp_path / "film.mp4") as watch:
            show(watch)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        breaks_off()
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_file_is_known_at_once(tmp_path):
    with pytest.raises(ValueError, match=r"must end in \.mp4"), search_film("small", tmp_path / "film.avi"):
        pytest.fail("it began")
    assert list(tmp_path.iterdir()) == []
