"""Finding the reader of a folder (0.1 s)."""

import pytest

from stereo_slam_env.datasets import READERS, known_layouts, read_recording

from .small_folders import kitti00, kitti07, starry_night


def test_each_layout_finds_its_reader(tmp_path):
    assert read_recording(kitti07(tmp_path / "a")).source["reader"] == "kitti07_tracks"
    assert read_recording(str(kitti00(tmp_path / "b"))).source["reader"] == "kitti00_stereo_tracks"
    assert read_recording(starry_night(tmp_path / "c"), first=2).source["reader"] == "starry_night"


def test_an_unknown_folder_gets_one_line_with_the_known_layouts(tmp_path):
    with pytest.raises(ValueError, match="has no known layout") as caught:
        read_recording(tmp_path)
    assert all(name in str(caught.value) for name in known_layouts())
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("reader", [r for r in READERS if len(r.FILES) > 1], ids=lambda reader: reader.NAME)
def test_a_missing_file_is_named(tmp_path, reader):
    folder = {"kitti07_tracks": kitti07, "kitti00_stereo_tracks": kitti00}[reader.NAME](tmp_path)
    (folder / reader.FILES[0]).unlink()
    with pytest.raises(ValueError, match=f"for {reader.NAME} it lacks {reader.FILES[0]}"):
        read_recording(folder)


def test_a_missing_folder_and_a_file_are_told_apart(tmp_path):
    with pytest.raises(ValueError, match="does not exist"):
        read_recording(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="is a file, not a folder"):
        read_recording(tmp_path / "file")


def test_a_misspelt_option_is_named_with_what_was_meant(tmp_path):
    with pytest.raises(ValueError, match="no option 'sigma_pix', did you mean 'sigma_px'"):
        read_recording(kitti07(tmp_path), sigma_pix=2.0)
