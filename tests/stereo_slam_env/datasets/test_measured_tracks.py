"""Tracks and matches of other programs as text (1 s)."""

import numpy as np
import pytest

from filters import StereoCamera
from stereo_slam_env.datasets.measured_tracks import read_measured_tracks

CAMERA = StereoCamera(300.0, 300.0, 159.5, 119.5, 0.5, 320, 240)


@pytest.fixture
def read(tmp_path):
    def read_text(text):
        (tmp_path / "tracks.txt").write_text(text)
        return read_measured_tracks(tmp_path / "tracks.txt")

    return read_text


@pytest.mark.parametrize(
    "text",
    [
        "0 7 10.5 20 3\n2 7 11 20 3.5\n2 9 40 30 1\n",
        "0,7,10.5,20,3\n2, 9, 40, 30, 1\n2, 7, 11, 20, 3.5\n",
        "# frame id u v d\n0 7 10.5 20 3\n2 7 11 20 3.5\n2 9 40 30 1\n",
        "d,u,v,id,track_length,frame\n3,10.5,20,7,1,0\n3.5,11,20,7,2,2\n1,40,30,9,1,2\n",
    ],
)
def test_rows_are_read_by_their_order_or_their_names(read, text):
    tracks = read(text)
    assert (sorted(tracks.observations), len(tracks), tracks.pairs, tracks.claims) == ([0, 2], 3, 3, False)
    np.testing.assert_array_equal(tracks.observations[0].uvd, [[10.5, 20.0, 3.0]])
    np.testing.assert_array_equal(tracks.observations[2].ids, [7, 9])
    np.testing.assert_array_equal(tracks.observations[2].uvd, [[11.0, 20.0, 3.5], [40.0, 30.0, 1.0]])


def test_a_claim_is_three_deviations_or_the_upper_triangle(read):
    tracks = read("0 1 9 9 3 0.5 0.25 2\n")
    assert tracks.claims
    np.testing.assert_array_equal(tracks.observations[0].R, [np.diag([0.25, 0.0625, 4.0])])
    by_name = read("frame id dd uu uv ud vv vd u v d\n0 1 6 1 .2 .3 4 .5 9 9 3\n").observations[0]
    np.testing.assert_array_equal(by_name.R, [[[1, 0.2, 0.3], [0.2, 4, 0.5], [0.3, 0.5, 6]]])
    np.testing.assert_array_equal(read("0 1 9 9 3 1 .2 .3 4 .5 6\n").observations[0].R, by_name.R)


def test_pairs_are_played_back_in_their_order(read):
    tracks = read("1 7 10.5 20 3 1 1 2\n3 7 11 20 3.5 1 1 2\n")
    image = np.zeros((240, 320), np.uint8)
    for _ in range(2):
        played = [tracks.track(image, image) for _ in range(5)]
        assert [len(pair.ids) for pair in played] == [0, 1, 0, 1, 0]
        np.testing.assert_array_equal(played[3].R, [np.diag([1.0, 1.0, 4.0])])
        tracks.reset()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no rows: write frame, id, u, v, d"),
        ("# frame id u v d\n", "has no rows"),
        ("0 1 9 9\n", "has 4 columns: write frame, id, u, v, d"),
        ("0 1 9 9 3 1\n", "has 6 columns"),
        ("0 1 9 9 3\n0 2 9 9\n", "not a table of 5 numbers a row"),
        ("frame,u,v,d\n0,9,9,3\n", "has no column id among frame, u, v, d"),
        ("frame,id,u,v,d\n0,1,9,9,3,1\n", "has 6 columns below 5 names"),
        ("0.5 1 9 9 3\n", "frame must be a whole number >= 0, row 0 has 0.5"),
        ("0 1 9 9 3\n-1 1 9 9 3\n", "frame must be a whole number >= 0, row 1 has -1"),
        ("0 1.5 9 9 3\n", "id must be a whole number >= 0, row 0 has 1.5"),
        ("0 1 9 9 3\n4 8 9 9 3\n4 8 7 9 3\n", "has id 8 twice in frame 4"),
        ("0 1 9 nan 3\n", "NaN or infinity"),
        ("2 1 9 9 3 1 0 1\n", "frame 2: R"),
        ("2 1 9 9 3 1 5 0 1 0 1\n", "frame 2: R"),
    ],
)
def test_what_is_no_file_of_tracks_is_refused_in_a_line(read, text, message):
    with pytest.raises(ValueError, match=r"\A[^\n]*tracks\.txt[^\n]+\Z") as refusal:
        read(text)
    assert message in str(refusal.value)


def test_a_missing_file_says_what_it_should_hold(tmp_path):
    with pytest.raises(ValueError, match=r"none\.txt does not exist: a file of tracks has rows of frame, id, u, v, d"):
        read_measured_tracks(tmp_path / "none.txt")


@pytest.mark.parametrize(("row", "axis"), [("320 9", "u"), ("9 -0.6", "v"), ("-1 9", "u"), ("9 239.6", "v")])
def test_a_pixel_outside_the_image_is_named(read, row, axis):
    read("0 1 319.5 -0.5 3\n").require_inside(CAMERA)
    with pytest.raises(ValueError, match=f"{axis} of id 5 in frame 3 is .* outside the image of 320x240 px"):
        read(f"0 1 9 9 3\n3 5 {row} 3\n").require_inside(CAMERA)
