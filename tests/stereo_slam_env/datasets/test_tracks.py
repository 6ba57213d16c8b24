"""Thinning of tracks, and frames made of them (0.2 s)."""

import numpy as np
import pytest

from stereo_slam_env.datasets.track_files import PointTracks, frames_of, without_repeats


def random_tracks(seed=3, landmarks=60, frames=30):
    """Tracks of random start and length, some with a gap, observations shuffled."""
    rng = np.random.default_rng(seed)
    rows = []
    for j in range(landmarks):
        start, length = rng.integers(0, frames - 1), rng.integers(1, 15)
        rows += [(k, j) for k in range(start, min(start + length, frames)) if rng.random() > 0.1]
    frame, ids = np.array(rows)[rng.permutation(len(rows))].T
    return PointTracks(frame, ids, rng.uniform(1.0, 9.0, (len(frame), 3)), rng.uniform(0, 9, len(frame)))


def seen_in(tracks, landmark):
    return set(tracks.frame[tracks.ids == landmark].tolist())


@pytest.mark.parametrize("limit", [1, 5, 12])
def test_thinned_tracks_respect_the_limit_and_are_never_cut_short(limit):
    tracks = random_tracks()
    thinned = tracks.thinned(limit)
    assert np.bincount(thinned.frame).max() == limit
    for landmark in np.unique(thinned.ids):
        kept, all_frames = seen_in(thinned, landmark), seen_in(tracks, landmark)
        assert kept == {k for k in all_frames if k >= min(kept)}


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
