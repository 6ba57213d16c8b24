"""A broken recording is refused by the name of the file, or its broken pairs are left out and counted (2 s)."""

import logging

import numpy as np
import pytest

from stereo_slam_env.datasets import BrokenPair, open_image_sequence

from .small_image_folders import (
    FRAMES,
    cut_file,
    drive,
    karlsruhe,
    kitti06,
    kitti_odometry,
    kitti_raw,
    png_bomb,
    true_poses,
    write_png,
)


def rewrite_rows(path, change):
    rows = path.read_text().splitlines()
    change(rows)
    path.write_text("\n".join(rows) + "\n")


def set_row(number, text):
    def change(rows):
        rows[number] = text

    return change


def nan_pose(rows):
    words = rows[3].split()
    words[5] = "nan"
    rows[3] = " ".join(words)


BROKEN = {
    "right image missing": (
        lambda root: (root / "sequences/07/image_1/000003.png").unlink(),
        r"image_1 has no image of frame 3 \(6 left images, 5 right images, 6 times in times\.txt\)",
        {"right image missing": 1},
    ),
    "left image missing": (
        lambda root: (root / "sequences/07/image_0/000003.png").unlink(),
        r"image_0 has no image of frame 3",
        {"left image missing": 1},
    ),
    "wrong size": (
        lambda root: write_png(root / "sequences/07/image_1/000003.png", np.zeros((100, 160), dtype=np.uint8)),
        r"image_1/000003\.png is 160x100 where 160x120 was expected",
        {"image of another size": 1},
    ),
    "truncated PNG": (
        lambda root: cut_file(root / "sequences/07/image_0/000003.png"),
        r"image_0/000003\.png is damaged, .*: copy it again",
        {"image damaged": 1},
    ),
    "image bomb": (
        lambda root: png_bomb(root / "sequences/07/image_0/000003.png", 100_000, 100_000),
        r"image_0/000003\.png is too large to be decoded",
        {"image too large": 1},
    ),
    "unsorted times": (
        lambda root: rewrite_rows(root / "sequences/07/times.txt", set_row(3, "0.05")),
        r"times\.txt: times must increase, frame 3 has 0\.05 s next to 0\.2 s of frame 2",
        {"time stamp does not increase": 1},
    ),
    "a wild time": (
        lambda root: rewrite_rows(root / "sequences/07/times.txt", set_row(1, "1e9")),
        r"times\.txt: times must increase, frame 1 has 1e\+09 s next to 0\.2 s of frame 2",
        {"time stamp does not increase": 1},
    ),
    "duplicate times": (
        lambda root: rewrite_rows(root / "sequences/07/times.txt", set_row(3, "0.2")),
        r"times\.txt: times must increase, frame [23] has 0\.2 s",
        {"time stamp does not increase": 1},
    ),
    "NaN time": (
        lambda root: rewrite_rows(root / "sequences/07/times.txt", set_row(3, "nan")),
        r"times\.txt has NaN or infinity as the time of frame 3",
        {"no time stamp": 1},
    ),
    "NaN pose": (
        lambda root: rewrite_rows(root / "poses/07.txt", nan_pose),
        r"poses/07\.txt has NaN, infinity or no rotation in row 3",
        {"no true pose": 1},
    ),
    "no rotation": (
        lambda root: rewrite_rows(root / "poses/07.txt", set_row(3, " ".join(["1.0"] * 12))),
        r"poses/07\.txt has NaN, infinity or no rotation in row 3",
        {"no true pose": 1},
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_the_file_is_named(tmp_path, fault):
    break_it, message, _ = BROKEN[fault]
    folder = kitti_odometry(tmp_path)
    break_it(tmp_path)
    with pytest.raises(ValueError, match=message) as caught:
        list(open_image_sequence(folder).pairs())
    assert isinstance(caught.value, BrokenPair)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("fault", BROKEN)
def test_or_the_pair_is_skipped_counted_and_logged(tmp_path, caplog, fault):
    break_it, _, counts = BROKEN[fault]
    folder = kitti_odometry(tmp_path)
    break_it(tmp_path)
    sequence = open_image_sequence(folder, on_broken="skip")
    with caplog.at_level(logging.WARNING):
        times = [pair.timestamp for pair in sequence.pairs()]
    assert len(times) == FRAMES - 1
    assert sequence.skipped == counts
    assert (np.diff(times) > 0).all()
    caplog.clear()
    assert len(list(sequence.pairs())) == FRAMES - 1  # and again the same
    assert sequence.skipped == counts


def test_skipping_says_why(tmp_path, caplog):
    folder = kitti_odometry(tmp_path)
    cut_file(folder / "image_0" / "000003.png")
    list(open_image_sequence(folder, on_broken="skip").pairs())
    assert "pair skipped" in caplog.text
    assert "000003.png is damaged" in caplog.text


def test_one_wild_time_costs_one_pair_not_all_that_follow(tmp_path):
    folder = kitti_odometry(tmp_path)
    rewrite_rows(folder / "times.txt", set_row(1, "1e9"))
    sequence = open_image_sequence(folder, on_broken="skip")
    assert sequence.frame_numbers == (0, 2, 3, 4, 5)


def test_when_the_first_pair_is_broken_the_world_starts_at_the_next(tmp_path):
    folder = kitti_odometry(tmp_path)
    cut_file(folder / "image_1" / "000000.png")
    pairs = list(open_image_sequence(folder, on_broken="skip").pairs())
    np.testing.assert_array_equal(pairs[0].left, drive()._pairs[1].left)
    np.testing.assert_allclose(pairs[0].truth.position, 0.0, atol=1e-12)
    apart = np.linalg.norm(true_poses()[2].position - true_poses()[1].position)
    assert np.linalg.norm(pairs[1].truth.position) == pytest.approx(apart)


@pytest.mark.parametrize("break_at", ["opening", "reading"])
def test_odometry_over_a_skipped_pair_is_the_mean_or_nothing(tmp_path, break_at):
    folder = kitti06(tmp_path)
    whole = list(open_image_sequence(folder).pairs())
    image = folder / "image_r" / "000002.png"
    image.unlink() if break_at == "opening" else cut_file(image)
    pairs = list(open_image_sequence(folder, on_broken="skip").pairs())
    after = pairs[2]
    assert after.timestamp == whole[3].timestamp
    if break_at == "opening":
        assert after.odometry is None
    else:
        mean = 0.5 * (whole[2].odometry.linear + whole[3].odometry.linear)
        np.testing.assert_allclose(after.odometry.linear, mean, atol=1e-12)
        np.testing.assert_allclose(after.odometry.covariance, 0.5 * whole[3].odometry.covariance, rtol=1e-9)
    np.testing.assert_array_equal(pairs[3].odometry.linear, whole[4].odometry.linear)


def test_a_broken_pair_outside_the_chosen_part_does_not_matter(tmp_path):
    folder = kitti_odometry(tmp_path)
    cut_file(folder / "image_0" / "000005.png")
    (folder / "image_1" / "000000.png").unlink()
    assert len(list(open_image_sequence(folder, first=1, last=4).pairs())) == 4


def test_more_images_than_times_and_the_other_way_round(tmp_path):
    folder = kitti_odometry(tmp_path, truth=False)
    rewrite_rows(folder / "times.txt", lambda rows: rows.pop())
    with pytest.raises(ValueError, match=r"times\.txt has 5 times where image_0 has 6 images \(frame 5 has none\)"):
        open_image_sequence(folder)
    assert open_image_sequence(folder, on_broken="skip").skipped == {"no time stamp": 1}
    rewrite_rows(folder / "times.txt", lambda rows: rows.extend(["0.5", "0.6", "0.7"]))
    with pytest.raises(ValueError, match=r"image_0 has no image of frame 6 .*8 times"):
        open_image_sequence(folder)
    assert open_image_sequence(folder, on_broken="skip").skipped == {"left image missing": 2}


def test_fewer_poses_than_frames(tmp_path):
    folder = kitti_odometry(tmp_path)
    rewrite_rows(tmp_path / "poses/07.txt", lambda rows: rows.pop())
    with pytest.raises(ValueError, match=r"poses/07\.txt has 5 poses and none for frame 5"):
        open_image_sequence(folder)
    assert len(open_image_sequence(folder, use_truth=False)) == FRAMES


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("P1:", "Q1:"), r"calib\.txt lacks the entry 'P1:' \(it has P0, Q1, P2, P3, Tr\)"),
        (lambda text: text.replace("P1: ", "P1: 1.0 "), r"entry 'P1:' has 13 numbers where 12 were expected"),
        (lambda text: text.replace("P1: 1.2", "P1: 1.3"), "both cameras must have the same focal lengths"),
        (
            lambda text: text.replace("P0:", "X:").replace("P1:", "P0:").replace("X:", "P1:"),
            "are left and right swapped",
        ),
        (lambda text: text.replace("P0: 1.200000000000e+02", "P0: nan"), r"entry 'P0:' has NaN or infinity"),
    ],
)
def test_calibration_faults_are_never_skipped(tmp_path, change, message):
    folder = kitti_odometry(tmp_path)
    calibration = folder / "calib.txt"
    calibration.write_text(change(calibration.read_text()))
    with pytest.raises(ValueError, match=message):
        open_image_sequence(folder, on_broken="skip")


def test_tables_that_are_no_tables_are_named(tmp_path):
    folder = kitti_odometry(tmp_path)
    (folder / "times.txt").write_text("0.0\n0.1\nlater\n")
    with pytest.raises(ValueError, match=r"times\.txt is not a table of 1 numbers a row"):
        open_image_sequence(folder)


def test_raw_packets_and_stamps_that_are_missing_or_damaged(tmp_path):
    folder = kitti_raw(tmp_path)
    (folder / "oxts/data/0000000002.txt").unlink()
    (folder / "oxts/data/0000000004.txt").write_text("1 2 3\n")
    with pytest.raises(ValueError, match=r"oxts/data has NaN, infinity or no rotation in row 2"):
        open_image_sequence(folder)
    sequence = open_image_sequence(folder, on_broken="skip")
    assert sequence.skipped == {"no true pose": 2}
    stamps = folder / "image_00/timestamps.txt"
    rewrite_rows(stamps, set_row(5, "yesterday"))
    assert open_image_sequence(folder, on_broken="skip").skipped == {"no true pose": 2, "no time stamp": 1}
    stamps.write_text("nothing\n")
    with pytest.raises(ValueError, match=r"timestamps\.txt holds no time such as"):
        open_image_sequence(folder)


def test_karlsruhe_without_calibration_entries(tmp_path):
    folder = karlsruhe(tmp_path)
    calibration = tmp_path / "2009_09_08_calib.txt"
    calibration.write_text(calibration.read_text().replace("P2_roi", "P2_cut"))
    with pytest.raises(ValueError, match=r"2009_09_08_calib\.txt lacks the entry 'P2_roi:'"):
        open_image_sequence(folder)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"first": -1}, "first must be a frame number >= 0, got -1"),
        ({"last": 2.5}, "last must be a frame number >= 0, got 2.5"),
        ({"first": 9}, r"first=9, last=None select no frame of .*image_0: its frames are 0 to 5"),
        ({"first": 4, "last": 2}, "first=4, last=2 select no frame"),
        ({"on_broken": "ignore"}, "on_broken must be 'raise' or 'skip', got 'ignore'"),
    ],
)
def test_options_that_make_no_sense(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        open_image_sequence(kitti_odometry(tmp_path), **options)


def test_nothing_usable_is_an_error_even_when_skipping(tmp_path):
    folder = kitti_odometry(tmp_path)
    for image in (folder / "image_1").iterdir():
        image.unlink()
    with pytest.raises(ValueError, match="no usable pair among its 6 frames"):
        open_image_sequence(folder, on_broken="skip")
