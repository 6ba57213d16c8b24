"""A broken recording is refused by the name of the file, or its broken pairs are left out and counted (2 s)."""

import logging
import re

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
    return lambda rows: rows.__setitem__(number, text)


def image(eye):
    return lambda root: root / f"sequences/07/image_{eye}/000003.png"


def time(number, text):
    return lambda root: rewrite_rows(root / "sequences/07/times.txt", set_row(number, text))


def pose(words):
    return lambda root: rewrite_rows(root / "poses/07.txt", set_row(3, words))


WRONG = np.zeros((100, 160), dtype=np.uint8)
NO_ORDER, NO_ROTATION = "time stamp does not increase", r"poses/07\.txt has NaN, infinity or no rotation in row 3"
COUNTS = r"\(6 left images, 5 right images, 6 times in times\.txt\)"
BROKEN = {
    "right image": (lambda r: image(1)(r).unlink(), f"image_1 has no image of frame 3 {COUNTS}", "right image missing"),
    "left image": (lambda r: image(0)(r).unlink(), "image_0 has no image of frame 3", "left image missing"),
    "size": (lambda r: write_png(image(1)(r), WRONG), r"3\.png is 160x100 where 160x120 was", "image of another size"),
    "cut": (lambda r: cut_file(image(0)(r)), r"000003\.png is damaged, .*: copy it again", "image damaged"),
    "bomb": (lambda r: png_bomb(image(0)(r), 100_000, 100_000), r"3\.png is too large to be dec", "image too large"),
    "unsorted": (time(3, "0.05"), r"times must increase, frame 3 has 0\.05 s next to 0\.2 s of frame 2", NO_ORDER),
    "wild": (time(1, "1e9"), r"times must increase, frame 1 has 1e\+09 s next to 0\.2 s of frame 2", NO_ORDER),
    "twice": (time(3, "0.2"), r"times\.txt: times must increase, frame [23] has 0\.2 s", NO_ORDER),
    "NaN time": (time(3, "nan"), r"times\.txt has NaN or infinity as the time of frame 3", "no time stamp"),
    "NaN pose": (pose(" ".join(["1", "0", "0", "0", "nan", *["0"] * 7])), NO_ROTATION, "no true pose"),
    "no rotation": (pose(" ".join(["1.0"] * 12)), NO_ROTATION, "no true pose"),
}
"""What is broken, what is said, and as what a pair that is left out is counted."""


@pytest.mark.parametrize("fault", BROKEN)
def test_the_file_is_named_or_the_pair_is_skipped_counted_and_logged(tmp_path, caplog, fault):
    break_it, message, reason = BROKEN[fault]
    folder = kitti_odometry(tmp_path)
    break_it(tmp_path)
    with pytest.raises(BrokenPair, match=rf"\A.*{message}.*\Z"):
        list(open_image_sequence(folder).pairs())
    with caplog.at_level(logging.WARNING):
        sequence = open_image_sequence(folder, on_broken="skip")
        for _ in range(2):  # and again the same
            times = [pair.timestamp for pair in sequence.pairs()]
            assert len(times) == FRAMES - 1
            assert (np.diff(times) > 0).all()
            assert sequence.skipped == {reason: 1}
    assert "pair skipped" in caplog.text
    assert re.search(message, caplog.text)


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
        (lambda text: text.replace("P0:", "X:").replace("P1:", "P0:").replace("X:", "P1:"), "left and right swapped"),
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
    (folder / "oxts/data/0000000003.txt").unlink()
    (folder / "oxts/data/0000000003.txt").mkdir()
    (folder / "oxts/data/0000000004.txt").write_text("1 2 3\n")
    with pytest.raises(ValueError, match=r"oxts/data has NaN, infinity or no rotation in row 2"):
        open_image_sequence(folder)
    sequence = open_image_sequence(folder, on_broken="skip")
    assert sequence.skipped == {"no true pose": 3}
    stamps = folder / "image_00/timestamps.txt"
    rewrite_rows(stamps, set_row(5, "yesterday"))
    assert open_image_sequence(folder, on_broken="skip").skipped == {"no true pose": 3, "no time stamp": 1}
    stamps.write_text("nothing\n")
    with pytest.raises(ValueError, match=r"timestamps\.txt holds no time such as"):
        open_image_sequence(folder)
    stamps.unlink()
    with pytest.raises(ValueError, match=r"timestamps\.txt is missing: copy it from the recording|has no known layout"):
        open_image_sequence(folder)


def test_karlsruhe_without_calibration_entries(tmp_path):
    folder = karlsruhe(tmp_path)
    calibration = tmp_path / "2009_09_08_calib.txt"
    calibration.write_text(calibration.read_text().replace("P2_roi", "P2_cut"))
    with pytest.raises(ValueError, match=r"2009_09_08_calib\.txt lacks the entry 'P2_roi:'"):
        open_image_sequence(folder)


def test_nothing_usable_is_an_error_even_when_skipping(tmp_path):
    folder = kitti_odometry(tmp_path)
    for image in (folder / "image_1").iterdir():
        image.unlink()
    with pytest.raises(ValueError, match="no usable pair among its 6 frames"):
        open_image_sequence(folder, on_broken="skip")
