"""Which pairs of a recording are used, and what a step over left-out ones has; images of all depths; tracks (1 s)."""

import logging
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, Pose
from stereo_slam_env.datasets.image_files import (
    BrokenPair,
    as_grey,
    decoded_pixels,
    numbered_images,
    read_grey,
    shift_of,
    shift_of_files,
)
from stereo_slam_env.datasets.sequence import Choice, Faults, ImageFiles, poses_of_rows, usable_pairs
from stereo_slam_env.datasets.track_files import (
    PointTracks,
    camera_velocities,
    frames_of,
    stated_or_assumed,
    without_repeats,
)

HERE = Path("left"), Path("right")


def files(numbers=range(5), seconds=None, **more):
    images = {number: Path(f"{number}.png") for number in numbers}
    times = 0.1 * np.arange(max(numbers, default=-1) + 1) if seconds is None else np.array(seconds)
    return ImageFiles(HERE, (images, dict(images)), times, Path("times.txt"), **more)


def used(recording, **choice):
    """Numbers of the pairs that are used, and why others are not."""
    faults = Faults("skip")
    return [pair.number for pair in usable_pairs(recording, Choice(**choice), faults)], faults.counts


@pytest.mark.parametrize(
    ("choice", "numbers"),
    [
        *(({}, [0, 1, 2, 3, 4]), ({"first": 0, "last": 0}, [0]), ({"first": 4}, [4]), ({"last": 2}, [0, 1, 2])),
        *(({"first": 1, "last": 3}, [1, 2, 3]), ({"first": 3, "last": 99}, [3, 4])),
    ],
)
def test_both_ends_of_a_choice_belong_to_it(choice, numbers):
    assert used(files(), **choice) == (numbers, {})


def test_a_choice_of_nothing_is_refused():
    with pytest.raises(ValueError, match=r"first=5, last=None select no frame of left: its frames are 0 to 4"):
        used(files(), first=5)
    with pytest.raises(ValueError, match=r"left has no images"):
        used(files(numbers=(), seconds=[]))
    for wrong in ({"first": -1}, {"last": 1.0}, {"first": True}, {"on_broken": "stop"}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            Choice(**wrong)


def test_pairs_without_an_image_a_time_or_a_pose_are_left_out_and_counted():
    left = {number: Path(f"{number}.png") for number in (0, 1, 2, 4, 5, 6)}
    right = {number: Path(f"{number}.png") for number in (0, 2, 3, 4, 5, 6)}
    pose = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    times = np.array([0.0, 0.1, 0.2, 0.3, np.nan, 0.5])
    recording = ImageFiles(HERE, (left, right), times, Path("times.txt"), truth=[pose, pose, pose, pose, pose, None])
    numbers, counts = used(recording)
    assert numbers == [0, 2]
    expected = {"right image missing": 1, "left image missing": 1, "no time stamp": 2, "no true pose": 1}
    assert counts == expected
    with pytest.raises(BrokenPair, match="right has no image of frame 1"):
        usable_pairs(recording, Choice(), Faults("raise"))


@pytest.mark.parametrize(
    ("seconds", "numbers"),
    [
        ([0.0, 0.1, 9.0, 0.3, 0.4], [0, 1, 3, 4]),
        ([0.0, 0.1, 0.1, 0.3, 0.4], None),
        ([5.0, 0.1, 0.2, 0.3, 0.4], [1, 2, 3, 4]),
        ([0.0, 0.1, 0.2, 0.3, -1.0], [0, 1, 2, 3]),
        ([0.0, 0.3, 0.1, 0.2, 0.4], [0, 2, 3, 4]),
    ],
)
def test_one_wild_time_costs_one_pair(seconds, numbers, caplog):
    with caplog.at_level(logging.WARNING):
        found, counts = used(files(seconds=seconds))
    assert len(found) == 4
    assert numbers is None or found == numbers
    assert (np.diff(np.array(seconds)[found]) > 0.0).all()
    assert counts == Counter({"time stamp does not increase": 1})
    assert "times must increase" in caplog.text


def test_a_row_of_a_pose_is_a_rotation_to_a_hundredth_or_none():
    R = Rotation.from_rotvec([0.1, -0.4, 0.2]).as_matrix()
    rows = np.array([np.column_stack([S, [1.0, 2.0, 3.0]]).ravel() for S in (R, 1.004 * R, 1.006 * R, R * [1, 1, -1])])
    rows = np.vstack([rows, rows[0]])
    rows[4, 5] = np.inf
    poses = poses_of_rows(rows)
    assert [pose is None for pose in poses] == [False, False, True, True, True]
    np.testing.assert_allclose(poses[0].R_wc, R, atol=1e-12)
    np.testing.assert_array_equal(poses[1].position, [1.0, 2.0, 3.0])


# --- images ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("most", "bits"), [(0, 2), (1023, 2), (1024, 4), (4095, 4), (4096, 6), (16383, 6), (16384, 8), (65535, 8)]
)
def test_values_of_sixteen_bits_are_those_of_ten_twelve_fourteen_or_all(most, bits, tmp_path):
    assert shift_of(most) == bits
    image = np.full((6, 8), most, dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "0.png"), image)
    both = {0: tmp_path / "0.png"}
    assert shift_of_files((both, both)) == bits
    assert (read_grey(tmp_path / "0.png", (8, 6), bits) == most >> bits).all()


def test_grey_values_of_colours_go_by_their_order():
    """Rec. 601: 0.299 R, 0.587 G, 0.114 B."""
    pixels = np.tile(np.array([200, 100, 50], dtype=np.uint8), (2, 2, 1))
    assert as_grey(pixels)[0, 0] == round(0.114 * 200 + 0.587 * 100 + 0.299 * 50)
    assert as_grey(pixels, rgb=True)[0, 0] == round(0.299 * 200 + 0.587 * 100 + 0.114 * 50)
    deep = np.full((2, 2), 1023, dtype=np.uint16)
    assert (as_grey(deep, 2)[0, 0], as_grey(deep, 1)[0, 0], as_grey(deep, 8)[0, 0]) == (255, 255, 3)


def test_numbers_of_images_end_at_a_million(tmp_path):
    for name in ("000000.png", "999999.JPG", "a1.png", "1.tif", "7.jpeg"):
        (tmp_path / name).touch()
    assert sorted(numbered_images(tmp_path)) == [0, 7, 999_999]
    assert numbered_images(tmp_path / "nowhere") == {}
    (tmp_path / "1000000.png").touch()
    with pytest.raises(ValueError, match="is image 1000000: numbers from 1000000 on are refused"):
        numbered_images(tmp_path)
    (tmp_path / "1000000.png").unlink()
    (tmp_path / "07.png").touch()
    with pytest.raises(ValueError, match="are both image 7"):
        numbered_images(tmp_path)


@pytest.mark.parametrize("colour", [False, True])
def test_pixels_are_grey_unless_colours_are_asked_for(tmp_path, colour):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((4, 6, 3), dtype=np.uint8))
    found = decoded_pixels(Path("a.png"), (tmp_path / "a.png").read_bytes(), (6, 4), colour=colour)
    assert found.shape == ((4, 6, 3) if colour else (4, 6))
    with pytest.raises(BrokenPair, match="is 6x4 where 4x6 was expected"):
        decoded_pixels(Path("a.png"), (tmp_path / "a.png").read_bytes(), (4, 6))


# --- tracks ----------------------------------------------------------------------------------------------------------


def test_what_is_not_stated_of_tracks_is_assumed_and_told(caplog):
    """2 px of a pixel, 2 sqrt 2 of a disparity, 0.5 m/s and 0.05 rad/s; images that just hold all pixels."""
    tracks = PointTracks(
        np.zeros(2, int), np.arange(2), np.array([[10.2, 5.0, 1.0], [3.0, 7.5, 2.0]]), np.array([5.1, 8.2])
    )
    unknown = dict.fromkeys(
        ("sigma_px", "sigma_u", "sigma_v", "sigma_d", "sigma_linear", "sigma_angular", "image_size")
    )
    with caplog.at_level(logging.WARNING):
        found, size = stated_or_assumed(Path("x"), tracks, None, **unknown)
    assert size == (12, 10)
    assert found == {
        **dict.fromkeys(("sigma_px", "sigma_u", "sigma_v"), 2.0),
        **{"sigma_d": pytest.approx(np.sqrt(8.0)), "sigma_linear": 0.5, "sigma_angular": 0.05},
    }
    assert "image_size=(12, 10)" in caplog.text
    caplog.clear()
    found, size = stated_or_assumed(Path("x"), tracks, None, sigma_px=1.0, image_size=[20, 30])
    assert (found, size, caplog.text) == ({"sigma_px": 1.0}, (20, 30), "")
    found, size = stated_or_assumed(
        Path("x"), tracks, {"sigma_px": 0.3, "image_size": (5, 6)}, sigma_px=None, image_size=None
    )
    assert (found, size, caplog.text) == ({"sigma_px": 0.3}, (5, 6), "")
    for wrong in (7, [1, 2, 3], [0, 5], [1.5, 2]):
        with pytest.raises(ValueError, match="image_size"):
            stated_or_assumed(Path("x"), tracks, None, image_size=wrong)


def test_thinned_tracks_are_the_longest_ones_each_as_a_whole():
    """Landmark n is seen in frames 0 to n; 9 begins later, where places are free."""
    rows = [(frame, n) for n in range(5) for frame in range(n + 1)] + [(frame, 9) for frame in (2, 3)]
    frame, ids = np.array(rows).T
    tracks = PointTracks(frame, ids, np.ones((len(rows), 3)))
    assert len(tracks.thinned(None)) == len(rows)
    for most, kept in ((1, {4}), (2, {3, 4}), (3, {2, 3, 4, 9}), (5, {0, 1, 2, 3, 4, 9})):
        assert set(tracks.thinned(most).ids.tolist()) == kept, most
        assert np.bincount(tracks.thinned(most).frame).max() <= most
    assert set(tracks.thinned(4).ids.tolist()) == {1, 2, 3, 4, 9}
    assert (tracks.with_positive_disparity().uvd[:, 2] > 0).all()
    none = PointTracks(frame, ids, np.zeros((len(rows), 3)))
    assert len(none.with_positive_disparity()) == 0


def test_frames_that_repeat_the_one_before_are_taken_out():
    """The points of the stopped tracker go on as others."""
    pixels = np.full((4, 4, 3), -1.0)
    pixels[:, :, 0] = [[1.0, 2.0, 2.0, 3.0]] * 4
    pixels[:, 0:3, 1] = [[5.0, 6.0, 6.0]] * 4
    pixels[:, 2:, 2] = [[8.0, 9.0]] * 4
    tracks, repeated = without_repeats(pixels)
    assert repeated == 2
    seen = [sorted(tracks.ids[tracks.frame == frame].tolist()) for frame in range(4)]
    assert seen == [[0, 1], [0, 1], [2], [2, 3]]


def test_velocities_of_the_camera_have_the_lever_arm_and_its_errors():
    rng = np.random.default_rng(0)
    R_ci, p = Rotation.from_rotvec([0.4, -1.0, 0.7]).as_matrix(), np.array([0.5, -0.3, 1.2])
    linear, angular = rng.normal(size=(2, 30_001, 3))
    sigmas = {"sigma_linear": 0.3, "sigma_angular": 0.1}
    exact = camera_velocities(linear, angular, R_ci, p, **sigmas)
    noisy = camera_velocities(linear, angular, R_ci, p, **sigmas, seed=1)
    assert exact[0] is None
    assert isinstance(exact[1], BodyVelocity)
    np.testing.assert_allclose(exact[1].linear, R_ci @ (linear[1] + np.cross(angular[1], p)))
    np.testing.assert_allclose(exact[1].angular, R_ci @ angular[1])
    errors = np.array(
        [[*(b.linear - a.linear), *(b.angular - a.angular)] for a, b in zip(exact[1:], noisy[1:], strict=True)]
    )
    np.testing.assert_allclose(np.cov(errors.T), exact[1].covariance, atol=0.004)


def random_tracks(seed=3, landmarks=60, frames=30):
    """Tracks of random start and length, some with a gap, observations shuffled."""
    rng = np.random.default_rng(seed)
    rows = []
    for j in range(landmarks):
        start, length = rng.integers(0, frames - 1), rng.integers(1, 15)
        rows += [(k, j) for k in range(start, min(start + length, frames)) if rng.random() > 0.1]
    frame, ids = np.array(rows)[rng.permutation(len(rows))].T
    return PointTracks(frame, ids, rng.uniform(1.0, 9.0, (len(frame), 3)), rng.uniform(0, 9, len(frame)))


def test_the_choice_does_not_depend_on_the_order_of_the_rows():
    tracks = random_tracks()
    shuffled = tracks.select(np.random.default_rng(1).permutation(len(tracks)))
    a, b = tracks.thinned(6), shuffled.thinned(6)
    assert sorted(zip(a.frame, a.ids, strict=True)) == sorted(zip(b.frame, b.ids, strict=True))


def test_no_limit_keeps_everything_and_a_silly_one_is_refused():
    tracks = random_tracks()
    assert tracks.thinned(None) is tracks
    for silly in (0, -3, 2.5):
        with pytest.raises(ValueError, match="max_per_frame must be a whole number >= 1"):
            tracks.thinned(silly)


def test_frames_hold_exactly_their_observations_in_order_of_ids():
    tracks = random_tracks()
    frames = frames_of(tracks, 0.1 * np.arange(30), [None] * 30)
    assert sum(len(frame.observation) for frame in frames) == len(tracks)
    for k, frame in enumerate(frames):
        at = tracks.frame == k
        order = np.argsort(tracks.ids[at])
        np.testing.assert_array_equal(frame.observation.ids, tracks.ids[at][order])
        np.testing.assert_array_equal(frame.observation.uvd, tracks.uvd[at][order])
        np.testing.assert_array_equal(frame.observation.v_right, tracks.v_right[at][order])


@pytest.mark.parametrize("times", [[0.0, 0.2, 0.1], [0.0, 0.1, 0.1]])
def test_unsorted_times_are_refused(times):
    nothing = PointTracks(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)))
    with pytest.raises(ValueError, match="timestamps must increase: frame 2"):
        frames_of(nothing, np.array(times), [None] * 3)


def test_observations_of_frames_that_do_not_exist_are_refused():
    with pytest.raises(ValueError, match="only 0 to 4 exist"):
        frames_of(random_tracks(), 0.1 * np.arange(5), [None] * 5)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.4])
@pytest.mark.parametrize(("step", "found"), [(5.0, [3, 7]), (0.5, [])])
def test_repeated_frames_are_known_by_their_motion_where_others_move(
    noise: float, step: float, found: list[int]
) -> None:
    """To the last bit they are known at any step; with noise only among frames that move by more than it."""
    rng = np.random.default_rng(0)
    still = np.isin(np.arange(12), [3, 7])
    u = 100.0 + step * np.cumsum(~still)[:, None] + rng.uniform(0.0, 400.0, 40)
    pixels = np.array([u, np.full_like(u, 80.0), u - 20.0, np.full_like(u, 80.0)]) + noise * rng.normal(
        size=(4, 12, 40)
    )
    tracks, repeats = without_repeats(pixels)
    left_out = found if noise else [3, 7]
    assert repeats == 40 * len(left_out)
    assert np.unique(tracks.frame).tolist() == [k for k in range(12) if k not in left_out]
