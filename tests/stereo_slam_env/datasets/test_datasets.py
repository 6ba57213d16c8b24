"""Finding the reader of a folder (0.1 s)."""

import re

import pytest

from stereo_slam_env.datasets import available_recordings, image_layouts, layout_of, load, track_layouts

from .small_folders import kitti00, kitti07, starry_night


def test_each_layout_finds_its_reader(tmp_path):
    assert layout_of(tmp_path) is None
    assert layout_of(kitti07(tmp_path / "a")) == load(tmp_path / "a").source["reader"] == "kitti07_tracks"
    assert load(str(kitti00(tmp_path / "b"))).source["reader"] == "kitti00_stereo_tracks"
    assert load(starry_night(tmp_path / "c"), first=2).source["reader"] == "starry_night"


def complaint(path):
    with pytest.raises(ValueError, match=re.escape(str(path))) as caught:
        load(path)
    text = str(caught.value)
    assert "\n" not in text
    assert len(text) < len(str(path)) + 230  # what fits into two lines or three of a terminal
    return text.removeprefix(str(path))


def test_an_unknown_folder_gets_one_line_that_says_where_the_known_layouts_are(tmp_path):
    assert complaint(tmp_path).startswith(" is empty; stereo-slam convert --list says which are known")
    (tmp_path / "letter.txt").write_text("")
    text = complaint(tmp_path)
    assert text.startswith(" has no known layout: it holds no file of one; stereo-slam convert --list says which")
    assert available_recordings().keys() == {reader.NAME for reader in (*track_layouts(), *image_layouts())}


@pytest.mark.parametrize("reader", [r for r in track_layouts() if len(r.FILES[0]) > 1], ids=lambda reader: reader.NAME)
def test_a_missing_file_is_named(tmp_path, reader):
    for name in reader.FILES[0][1:]:
        (tmp_path / name).write_text("")
    folder = tmp_path
    assert complaint(folder) == f" has no known layout: nearest is {reader.NAME}, which lacks {reader.FILES[0][0]}"


def test_the_nearest_layout_is_that_of_tracks_or_of_images_here_or_in_a_folder_below(tmp_path):
    drive = tmp_path / "sequences" / "00"
    (drive / "image_0").mkdir(parents=True)
    (drive / "calib.txt").write_text("")
    nearest = " has no known layout: nearest is kitti_odometry{}, which lacks times.txt, image_1"
    assert complaint(drive) == nearest.format("")
    assert complaint(tmp_path) == nearest.format(", in sequences/00")
    (drive / "times.txt").write_text("")
    (drive / "image_3").mkdir()
    assert complaint(drive) == " has no known layout: nearest is kitti_odometry, which lacks image_1"


def test_a_missing_folder_and_a_file_are_told_apart(tmp_path):
    remedy = ": give a folder with a recording, a bag, a recording in one file (NAME.npz) or 'gtsam'"
    assert complaint(tmp_path / "nowhere") == f" does not exist{remedy}"
    (tmp_path / "file").write_text("")
    assert complaint(tmp_path / "file") == f" is a file, not a folder{remedy}"


def test_a_misspelt_option_is_named_with_what_was_meant(tmp_path):
    with pytest.raises(ValueError, match="no option 'sigma_pix', did you mean 'sigma_px'"):
        load(kitti07(tmp_path), sigma_pix=2.0)
