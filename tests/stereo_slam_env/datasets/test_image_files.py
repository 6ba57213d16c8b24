"""Images that a decoder would return although they are damaged (0.2 s)."""

import os

import cv2
import numpy as np
import pytest

from stereo_slam_env.datasets import BrokenPair, image_files
from stereo_slam_env.datasets.image_files import image_size, read_grey

from .small_image_folders import cut_file, drive, png_bomb, write_png


@pytest.fixture
def picture():
    return next(drive().pairs()).left


def test_a_grey_png_comes_back_bit_by_bit(tmp_path, picture):
    write_png(tmp_path / "a.png", picture)
    np.testing.assert_array_equal(read_grey(tmp_path / "a.png", (160, 120)), picture)
    assert image_size(tmp_path / "a.png") == (160, 120)


@pytest.mark.parametrize(("suffix", "channels"), [("png", 1), ("png", 3), ("png", 4), ("jpg", 1), ("jpg", 3)])
def test_colour_and_jpeg_are_read_as_grey_values(tmp_path, picture, suffix, channels):
    stored = (
        picture
        if channels == 1
        else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR if channels == 3 else cv2.COLOR_GRAY2BGRA)
    )
    write_png(tmp_path / f"a.{suffix}", stored)
    read = read_grey(tmp_path / f"a.{suffix}")
    assert read.dtype == np.uint8
    assert read.shape == picture.shape
    assert np.abs(read.astype(int) - picture).mean() < (1.0 if suffix == "png" else 4.0)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.6, 0.95, 0.999])
def test_a_cut_file_is_found_wherever_it_is_cut(tmp_path, picture, suffix, share):
    path = tmp_path / f"a.{suffix}"
    write_png(path, picture)
    cut_file(path, share)
    with pytest.raises(BrokenPair, match="is damaged, ") as caught:
        read_grey(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_one_wrong_byte_in_a_png_is_found(tmp_path, picture):
    path = tmp_path / "a.png"
    write_png(path, picture)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(BrokenPair, match=r"a\.png is damaged, .*checksum in b'IDAT'"):
        read_grey(path)


def test_a_huge_image_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    for side, what in (
        (60_000, "is too large to be decoded"),
        (8_000, "says that it is 8000x8000: images above 40 million"),
    ):
        png_bomb(tmp_path / "a.png", side, side)
        with pytest.raises(BrokenPair, match=rf"a\.png {what}"):
            read_grey(tmp_path / "a.png")


def test_other_faults_are_named(tmp_path, picture):
    path = tmp_path / "a.png"
    with pytest.raises(BrokenPair, match=r"a\.png is missing"):
        read_grey(path)
    path.write_bytes(b"")
    with pytest.raises(BrokenPair, match="it is no whole PNG or JPEG"):
        read_grey(path)
    path.write_bytes(b"GIF89a.........")
    with pytest.raises(BrokenPair, match="it is no whole PNG or JPEG"):
        read_grey(path)
    png_bomb(path, 40, 40)  # a whole file of too few pixels
    with pytest.raises(BrokenPair, match="cannot be decoded"):
        read_grey(path)
    write_png(path, picture[:100])
    with pytest.raises(BrokenPair, match="is 160x100 where 160x120 was expected"):
        read_grey(path, (160, 120))


def test_what_is_no_file_or_a_giant_one_is_not_even_read(tmp_path, picture, monkeypatch):
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(BrokenPair, match=r"pipe\.png is no regular file but a pipe"):
        read_grey(tmp_path / "pipe.png")
    write_png(tmp_path / "a.png", picture)
    monkeypatch.setattr(image_files, "MAX_BYTES", 100)
    with pytest.raises(BrokenPair, match=r"a\.png has \d+ bytes: more than 100 are refused"):
        read_grey(tmp_path / "a.png")
