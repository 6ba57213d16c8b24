"""The search in the images as a film and live (1 s)."""

import socket
from urllib.request import urlopen

import cv2
import pytest

from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.viewer.search_film import search_film

from ..datasets.images.small_image_folders import CAMERA, drive


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


def test_the_latest_picture_is_served_and_the_address_told(tmp_path):
    told = []
    with search_film("small", tmp_path / "film.mp4", 0, on_live=told.append) as watch:
        show(watch)
        with urlopen(told[0] + "picture.jpg", timeout=10) as answer:
            assert answer.headers["Content-Type"] == "image/jpeg"
    assert (tmp_path / "film.mp4").is_file()


def test_no_film_is_left_by_what_breaks_off(tmp_path):
    def breaks_off():
        with search_film("small", tmp_path / "film.mp4") as watch:
            show(watch)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        breaks_off()
    assert list(tmp_path.iterdir()) == []


def test_wrong_files_and_ports_are_known_at_once(tmp_path):
    with pytest.raises(ValueError, match=r"must end in \.mp4"), search_film("small", tmp_path / "film.avi"):
        pytest.fail("it began")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with (
            pytest.raises(ValueError, match=f"port {port} cannot be used"),
            search_film("small", tmp_path / "film.mp4", port),
        ):
            pytest.fail("it began")
    assert list(tmp_path.iterdir()) == []
