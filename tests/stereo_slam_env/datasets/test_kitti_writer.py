"""What is written as a KITTI sequence is read back the same (1 s)."""

from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.datasets import open_image_sequence, write_recording
from stereo_slam_env.datasets.written_frame import KINDS
from stereo_slam_env.files.readers import read_table

from .small_image_folders import CAMERA, FRAMES, Drive, drive


def changed(**fields):
    """The drive with fields of its third pair replaced."""
    pairs = list(drive().pairs())
    pairs[2] = replace(pairs[2], **fields)
    return Drive(pairs)


def test_the_round_trip_keeps_bits_camera_times_and_truth(tmp_path):
    written = write_recording(drive(), tmp_path, "kitti", name="03", may_lose=KINDS)
    assert written == tmp_path / "sequences" / "03"
    sequence = open_image_sequence(tmp_path)
    for name in ("fx", "fy", "cx", "cy", "width", "height"):
        assert getattr(sequence.camera, name) == getattr(CAMERA, name)
    assert sequence.camera.baseline == pytest.approx(CAMERA.baseline, rel=1e-15)
    pairs = list(sequence.pairs())
    assert len(pairs) == FRAMES
    for pair, original in zip(pairs, drive().pairs(), strict=True):
        assert pair.timestamp == original.timestamp
        np.testing.assert_array_equal(pair.left, original.left)
        np.testing.assert_array_equal(pair.right, original.right)
        np.testing.assert_allclose(pair.truth.position, original.truth.position, atol=1e-9)
        np.testing.assert_allclose(pair.truth.orientation, original.truth.orientation, atol=1e-9)


def test_the_files_are_those_of_the_benchmark(tmp_path):
    told = []
    folder = write_recording(
        drive(), tmp_path, "kitti", may_lose=KINDS, on_pair=lambda done, of: told.append((done, of))
    )
    assert told == [(k + 1, FRAMES) for k in range(FRAMES)]
    files = ["calib.txt", "image_0", "image_1", "settings", "source.json", "times.txt"]
    assert sorted(p.name for p in folder.iterdir()) == [*files, "truth_body.tum", "truth_left_camera.tum"]
    assert sorted(p.name for p in (folder / "image_1").iterdir()) == [f"{k:06d}.png" for k in range(FRAMES)]
    assert read_table(tmp_path / "poses" / "00.txt", 12).shape == (FRAMES, 12)
    lines = (folder / "calib.txt").read_text().splitlines()
    assert [line.split(":")[0] for line in lines] == ["P0", "P1", "P2", "P3"]
    assert float(lines[1].split()[4]) == pytest.approx(-CAMERA.fx * CAMERA.baseline)


def test_an_interrupted_writing_cannot_be_mistaken_for_a_whole_one(tmp_path):
    def interrupt(done, of):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_recording(drive(), tmp_path, "kitti", may_lose=KINDS, on_pair=interrupt)
    assert not (tmp_path / "sequences" / "00").exists()
    assert not (tmp_path / "poses").exists()
    with pytest.raises(ValueError, match="has no known layout"):
        open_image_sequence(tmp_path / "sequences" / "00.partial")
    other = Drive(list(drive().pairs()))
    other.source = {"made": "otherwise"}
    with pytest.raises(ValueError, match=r"00\.partial was left by a writing that was interrupted, of something else"):
        write_recording(other, tmp_path, "kitti", may_lose=KINDS)


def test_nothing_is_overwritten(tmp_path):
    write_recording(drive(), tmp_path, "kitti", may_lose=KINDS)
    with pytest.raises(ValueError, match="sequences/00 is not empty"):
        write_recording(drive(), tmp_path, "kitti", may_lose=KINDS)
    write_recording(drive(), tmp_path, "kitti", name="01", may_lose=KINDS)
    (tmp_path / "poses" / "02.txt").write_text("mine")
    with pytest.raises(ValueError, match=r"poses/02\.txt is there already"):
        write_recording(drive(), tmp_path, "kitti", name="02", may_lose=KINDS)
    assert sorted(p.name for p in (tmp_path / "sequences").iterdir()) == ["00", "01"]


def test_without_all_true_poses_there_is_no_pose_file(tmp_path, caplog):
    write_recording(changed(truth=None), tmp_path, "kitti", may_lose=KINDS)
    assert not (tmp_path / "poses").exists()
    assert "1 of 6 pairs have no true pose" in caplog.text
    assert next(open_image_sequence(tmp_path).pairs()).truth is None


@pytest.mark.parametrize("name", ["", ".", "..", "a/b", "../00", ".hidden"])
def test_a_name_that_is_no_folder_name_is_refused(tmp_path, name):
    with pytest.raises(ValueError, match="name must be a plain folder name"):
        write_recording(drive(), tmp_path, "kitti", name=name, may_lose=KINDS)


def test_images_that_are_not_the_cameras_are_refused(tmp_path):
    for bad in (np.zeros((10, 10), np.uint8), np.zeros((120, 160, 3), np.uint8), np.zeros((120, 160))):
        with pytest.raises(ValueError, match=r"pair 2 cannot be written to .*000002\.png: its images must be uint8"):
            write_recording(
                changed(right=bad), tmp_path / str(bad.ndim) / bad.dtype.name / str(bad.size), "kitti", may_lose=KINDS
            )
    with pytest.raises(ValueError, match="has no pairs"):
        write_recording(Drive([]), tmp_path, "kitti", may_lose=KINDS)
