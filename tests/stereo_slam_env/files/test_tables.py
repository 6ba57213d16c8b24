"""Damaged and missing files are named in one line (0.1 s)."""

import os

import numpy as np
import pytest

from stereo_slam_env.files.readers import read_archive, read_poses, read_table


def test_a_table_is_read_as_it_is(tmp_path):
    path = tmp_path / "t.txt"
    path.write_text("1 2 3\n4 5 6\n")
    np.testing.assert_array_equal(read_table(path, 3), [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("1 2 3\n4 nan 6\n", r"t\.txt has NaN or infinity in 1 rows, the first is row 1"),
        ("1 2\n", r"t\.txt has 2 columns where 3 were expected"),
        ("", r"t\.txt is empty"),
        ("1 2 3\n4 x 6\n", r"t\.txt is not a table of 3 numbers a row"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_wrong_table_is_named(tmp_path, text, complaint):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(ValueError, match=rf"\A.*{complaint}.*\Z"):
        read_table(tmp_path / "t.txt", 3)


@pytest.mark.parametrize("keep", [0, 300, None])
def test_a_truncated_archive_and_one_of_pickles_are_named(tmp_path, keep):
    path = tmp_path / "a.npz"
    np.savez(path, x=np.zeros(100) if keep is not None else np.array([{"evil": 1}], dtype=object))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"a\.npz is damaged and cannot be read"):
        read_archive(path, {"x": "n"})


def test_a_missing_array_is_named(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.zeros(3))
    with pytest.raises(ValueError, match=r"a\.npz lacks the array y"):
        read_archive(tmp_path / "a.npz", {"x": 3, "y": 3})


def test_poses_are_camera_to_world(tmp_path):
    # A quarter turn to the right about y (down): the camera's z axis becomes the world's x axis.
    np.savetxt(tmp_path / "p.txt", [[0, 0, 1, 7, 0, 1, 0, 8, -1, 0, 0, 9]])
    positions, orientations = read_poses(tmp_path / "p.txt")
    np.testing.assert_allclose(positions, [[7, 8, 9]])
    np.testing.assert_allclose(np.abs(orientations), [[0, np.sqrt(0.5), 0, np.sqrt(0.5)]], atol=1e-12)


def test_lengths_of_one_letter_must_agree_and_a_pipe_is_not_waited_for(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.zeros((1, 5)), y=np.zeros((3, 5)), z=np.zeros((3, 4)))
    found = read_archive(tmp_path / "a.npz", {"x": "k", "y": (3, "k")})
    assert found["x"].shape == (5,)
    with pytest.raises(ValueError, match=r"array z has shape \(3, 4\), expected \(3, 5\)"):
        read_archive(tmp_path / "a.npz", {"x": "k", "z": (3, "k")})
    with pytest.raises(ValueError, match="array x has 5 numbers, expected 1"):
        read_archive(tmp_path / "a.npz", {"x": 1})
    os.mkfifo(tmp_path / "pipe.npz")
    with pytest.raises(ValueError, match="no regular file"):
        read_archive(tmp_path / "pipe.npz", {"x": "k"})
