"""A data set from a stranger leads nowhere outside its folder, and asks for no more than a recording can need."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fuzz import seeds
from stereo_slam_env.datasets import load, open_image_sequence
from stereo_slam_env.files.opening import require_inside, require_links_inside


def lay_out(folder: Path, files: seeds.Files) -> Path:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture
def outside(tmp_path):
    folder = tmp_path / "outside"
    folder.mkdir()
    return folder


def replace_by_link(path: Path, outside: Path) -> None:
    path.rename(outside / path.name)
    path.symlink_to(outside / path.name)


def test_no_folder_of_a_recording_may_be_a_link_out_of_it(tmp_path, outside):
    """Of files: `test_foreign_files.py`."""
    folder = lay_out(tmp_path / "given", seeds.kitti06())
    replace_by_link(folder / "image_l", outside)
    with pytest.raises(ValueError, match=r"image_l is a link out of its folder, to .*put the file itself there"):
        open_image_sequence(folder)


def test_nor_a_recording_below_the_given_folder(tmp_path, outside):
    lay_out(outside / "drive", seeds.kitti06())
    given = tmp_path / "given"
    given.mkdir()
    (given / "drive").symlink_to(outside / "drive")
    with pytest.raises(ValueError, match="link out of its folder"):
        open_image_sequence(given)
    assert len(open_image_sequence(given / "drive")) == seeds.FRAMES  # asked for by its own name


def test_links_inside_and_a_link_to_the_recording_are_followed(tmp_path):
    folder = lay_out(tmp_path / "given", seeds.kitti06())
    (folder / "image_l" / "000001.png").unlink()
    (folder / "image_l" / "000001.png").symlink_to("000000.png")
    (tmp_path / "named").symlink_to(folder)
    assert len(list(open_image_sequence(tmp_path / "named").pairs())) == seeds.FRAMES


def test_a_circle_of_links_is_refused(tmp_path):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(ValueError, match="leads nowhere"):
        require_links_inside(tmp_path)


def test_a_folder_whose_name_only_begins_alike_is_outside(tmp_path):
    with pytest.raises(ValueError, match="out of its folder"):
        require_inside(tmp_path / "drive-2" / "calib.txt", tmp_path / "drive")


@pytest.mark.parametrize("name", ["../../secret.png", "/etc/hostname", "a/b.png", "..", 300 * "a"])
def test_lists_in_a_recording_name_files_of_its_own_folder(name, tmp_path):
    files = dict(seeds.euroc())
    listing = files["mav0/cam0/data.csv"].decode().replace("1.png", name)
    folder = lay_out(tmp_path / "given", files | {"mav0/cam0/data.csv": listing.encode()})
    with pytest.raises(ValueError, match="line 3 is not 'timestamp in ns,file name'"):
        open_image_sequence(folder)


@pytest.mark.parametrize("read", [load, open_image_sequence])
@pytest.mark.parametrize("name", ["missing", 300 * "a", 5000 * "a"])
def test_a_path_that_nothing_can_have_does_not_exist(read, name, tmp_path):
    with pytest.raises(ValueError, match="does not exist: give a folder"):
        read(tmp_path / name)


def test_a_calibration_for_huge_images_is_refused(tmp_path):
    files = dict(seeds.euroc())
    for eye in ("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml"):
        files[eye] = files[eye].replace(b"[32, 24]", b"[900000, 900000]")
    with pytest.raises(ValueError, match="resolution 900000x900000"):
        open_image_sequence(lay_out(tmp_path / "given", files))


def test_many_time_stamps_do_not_ask_for_as_many_packets(tmp_path):
    files = dict(seeds.kitti_raw())
    name = "2011_09_26/2011_09_26_drive_0005_sync/image_00/timestamps.txt"
    folder = lay_out(tmp_path / "given", files | {name: files[name] + b"x\n" * 200_000})
    sequence = open_image_sequence(folder, last=seeds.FRAMES - 1)
    assert len(sequence) == seeds.FRAMES


def test_huge_arrays_of_small_numbers_are_refused(tmp_path):
    files = dict(seeds.kitti07())
    folder = lay_out(tmp_path, files)
    with np.load(folder / "tracks.npz") as archive:
        arrays = {key: archive[key] for key in archive.files}
    np.savez_compressed(folder / "tracks.npz", **(arrays | {"features": np.zeros((4, 10, 1_000_000), dtype=np.int8)}))
    with pytest.raises(ValueError, match="as float64 its arrays take more"):
        load(folder)
