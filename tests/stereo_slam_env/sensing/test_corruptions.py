"""Corruptions of recordings: what each does, that it does nothing else, and that the seed decides (3 s)."""

import dataclasses
import json

import numpy as np
import pytest

from filters import StereoNoise, StereoObservation
from filters.geometry import rotations
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.benchmark.scenarios.streams import stream_digest
from stereo_slam_env.recording.recording import LandmarkTruth
from stereo_slam_env.sensing.corruptions import CORRUPTIONS, corrupted, make_corruption

from ..benchmark.small_recordings import CAMERA, DT, small_recording

ONE_OF_EACH = [
    {"kind": "outliers", "share": 0.2, "sigma": 20.0},
    {"kind": "wrong-ids", "probability": 0.1},
    {"kind": "missed-detections", "probability": 0.2},
    {"kind": "blackouts", "probability": 0.2, "seconds": 0.25},
    {"kind": "dropped-frames", "probability": 0.3},
    {"kind": "duplicated-frames", "probability": 0.3},
    {"kind": "latency", "frames": 2},
    {"kind": "moving-landmarks", "share": 0.3, "speed": 3.0},
    {"kind": "wrong-calibration", "focal_percent": 1.0, "baseline_percent": -2.0, "principal_point_percent": 0.5},
    {"kind": "biased-disparity", "bias": 0.4},
    {"kind": "misscaled-noise", "factor": 2.0},
]


def by_kind(entry):
    return entry["kind"]


def with_right_rows(recording):
    """The same with a row in the right image that tells the landmark: the left one, and the id in thousandths."""
    return recording.with_observations(
        dataclasses.replace(f.observation, v_right=f.observation.uvd[:, 1] + 1e-3 * f.observation.ids)
        for f in recording.frames
    )


def measurements(recording):
    """All (frame, id) -> (u, v, d)."""
    return {
        (k, i): uvd
        for k, frame in enumerate(recording.frames)
        for i, uvd in zip(frame.observation.ids.tolist(), frame.observation.uvd, strict=True)
    }


def changes(before, after):
    """Per measurement in both: what was added, (n, 3)."""
    old, new = measurements(before), measurements(after)
    return np.array([new[key] - old[key] for key in old if key in new])


@pytest.fixture(scope="module")
def drive():
    return long_drive(0, frames=60)


# ---------------------------------------------------------------- for all of them


def test_there_is_a_test_of_each():
    assert [entry["kind"] for entry in ONE_OF_EACH] == list(CORRUPTIONS)


@pytest.mark.parametrize("entry", ONE_OF_EACH, ids=by_kind)
def test_the_same_seed_gives_the_same_bits_and_the_original_and_the_truth_stay(entry):
    recording = with_right_rows(small_recording())
    before = stream_digest(recording)
    first, again = corrupted(recording, [entry], 3), corrupted(recording, [entry], 3)
    assert stream_digest(first) == stream_digest(again) != before
    assert stream_digest(recording) == before
    needs_chance = any(name in entry for name in ("share", "probability"))
    assert (stream_digest(corrupted(recording, [entry], 4)) != stream_digest(first)) == needs_chance
    poses = {frame.timestamp: frame.truth for frame in recording.frames}
    assert all(poses[frame.timestamp] is frame.truth for frame in first.frames)
    assert (first.camera, first.start) == (recording.camera, recording.start)


@pytest.mark.parametrize("entry", ONE_OF_EACH, ids=by_kind)
def test_one_that_is_added_at_the_end_changes_nothing_of_those_before(entry):
    first = {"kind": "outliers", "share": 0.3}
    after_each_other = corrupted(corrupted(small_recording(), [first], 5), [], 5)
    last_undone = make_corruption(entry).applied_to(after_each_other, np.random.default_rng(5).spawn(2)[1])
    assert stream_digest(corrupted(small_recording(), [first, entry], 5)) == stream_digest(last_undone)


@pytest.mark.parametrize("entry", ONE_OF_EACH, ids=by_kind)
def test_empty_frames_and_covariances_of_their_own_are_no_problem(entry):
    recording = small_recording()
    nothing = StereoObservation([], np.zeros((0, 3)), [], np.zeros((0, 3, 3)))
    seen = [
        nothing if k % 3 == 1 else dataclasses.replace(f.observation, R=np.tile(np.eye(3), (len(f.observation), 1, 1)))
        for k, f in enumerate(recording.frames)
    ]
    for frame in corrupted(recording.with_observations(seen), [entry], 0).frames:
        assert frame.observation.R.shape == (len(frame.observation), 3, 3)
        assert (np.diff(frame.observation.ids) > 0).all()


def test_the_source_says_what_was_done_and_is_json():
    recording = small_recording()
    assert corrupted(recording, [], 0) is recording
    twice = corrupted(corrupted(recording, ONE_OF_EACH[:1], 3), [{"kind": "outliers", "share": 0.1}], 4)
    first, second = {**ONE_OF_EACH[0], "seed": 3}, {"kind": "outliers", "share": 0.1, "sigma": None, "seed": 4}
    assert twice.source == {**recording.source, "corruptions": [first, second]}
    json.dumps(corrupted(recording, ONE_OF_EACH, 0).source, allow_nan=False)


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        (
            {"kind": "outlier", "share": 0.1},
            r"there is no corruption 'outlier', did you mean 'outliers'\? Known: outli",
        ),
        ({"share": 0.1}, "a corruption must have a kind, one of outliers, "),
        ("outliers", "a corruption must have a kind"),
        ({"kind": "outliers", "shar": 0.1}, r"corruption 'outliers' has no field 'shar', did you mean 'share'\?"),
        ({"kind": "outliers"}, "corruption 'outliers' needs the field share"),
        ({"kind": "outliers", "share": 1.5}, "'outliers': share must be a probability from 0 to 1, got 1.5"),
        ({"kind": "outliers", "share": True}, "share must be a probability"),
        ({"kind": "outliers", "share": 0.1, "sigma": 0}, "sigma must be a finite number > 0"),
        ({"kind": "wrong-ids", "probability": "often"}, "probability must be a probability from 0 to 1, got 'often'"),
        ({"kind": "blackouts", "probability": 0.1, "seconds": 0.0}, "seconds must be a finite number > 0"),
        ({"kind": "latency", "frames": 1.5}, "frames must be a whole number >= 0, got 1.5"),
        ({"kind": "moving-landmarks", "share": 0.1, "speed": -1}, "speed must be a finite number >= 0"),
        ({"kind": "wrong-calibration", "focal_percent": -100}, "focal_percent must be more than -100"),
        ({"kind": "biased-disparity", "bias": float("nan")}, "bias must be a finite number, got nan"),
        ({"kind": "misscaled-noise", "factor": 0.0}, "factor must be a finite number > 0"),
    ],
)
def test_wrong_entries_are_named_before_anything_is_done(entry, complaint):
    with pytest.raises(ValueError, match=complaint) as caught:
        corrupted(small_recording(), [{"kind": "moving-landmarks", "share": 0.1, "speed": 1.0}, entry], 0)
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------- one by one


def test_outliers_are_as_many_and_as_large_as_asked(drive):
    added = changes(drive, corrupted(drive, [{"kind": "outliers", "share": 0.1, "sigma": 30.0}], 0))
    hit = (added != 0).any(axis=1)
    assert hit.mean() == pytest.approx(0.1, abs=4 * np.sqrt(0.09 / len(added)))
    np.testing.assert_allclose(added[hit].std(axis=0), 30.0, rtol=0.15)


def test_outliers_without_a_size_are_anywhere_whatever_the_rest_is(drive):
    """Column, row, and the share of the way that the right column is to the left edge: uniform and independent."""
    wild = corrupted(drive, [{"kind": "outliers", "share": 1.0}], 0)
    u, v, d = np.concatenate([frame.observation.uvd for frame in wild.frames]).T
    shares = np.array([u / (CAMERA.width - 1), v / (CAMERA.height - 1), d / u])
    assert drive.camera.in_view(np.column_stack([u, v, d])).all()
    reach = 5.0 / np.sqrt(len(u))
    np.testing.assert_allclose(shares.mean(axis=1), 0.5, atol=reach)
    np.testing.assert_allclose(shares.var(axis=1), 1.0 / 12.0, atol=reach)
    np.testing.assert_allclose(np.corrcoef(shares), np.eye(3), atol=reach)


@pytest.mark.parametrize("entry", [{"share": 0.5}, {"share": 0.5, "sigma": 9.0}], ids=str)
def test_right_rows_of_outliers_move_along(drive, entry):
    for frame in corrupted(with_right_rows(drive), [{"kind": "outliers", **entry}], 0).frames:
        seen = frame.observation
        np.testing.assert_allclose(seen.v_right - seen.uvd[:, 1], 1e-3 * seen.ids, atol=1e-9)


def test_wrong_ids_exchange_neighbours_and_nothing_else(drive):
    recording = with_right_rows(drive)
    mixed = corrupted(recording, [{"kind": "wrong-ids", "probability": 0.05}], 0)
    wrong = total = 0
    for before, after in zip(recording.frames, mixed.frames, strict=True):
        old, new = before.observation, after.observation
        np.testing.assert_array_equal(new.ids, old.ids)
        rows = {tuple(uvd): (i, v) for uvd, i, v in zip(old.uvd, old.ids, old.v_right, strict=True)}
        assert set(map(tuple, new.uvd)) == set(rows)  # the same measurements, under other ids
        true_ids = np.array([rows[tuple(uvd)][0] for uvd in new.uvd])
        np.testing.assert_array_equal(new.v_right, [rows[tuple(uvd)][1] for uvd in new.uvd])
        partner = dict(zip(new.ids.tolist(), true_ids.tolist(), strict=True))
        assert all(partner[partner[i]] == i for i in partner)  # always two for each other
        wrong, total = wrong + np.count_nonzero(true_ids != new.ids), total + len(new)
    assert 0.06 < wrong / total <= 0.11


def test_missed_detections_leave_the_rest_as_it_was(drive):
    kept = corrupted(drive, [{"kind": "missed-detections", "probability": 0.3}], 0)
    old, new = measurements(drive), measurements(kept)
    assert len(new) / len(old) == pytest.approx(0.7, abs=0.03)
    assert all((old[key] == uvd).all() for key, uvd in new.items())


def test_blackouts_last_as_long_as_asked(drive):
    dark = corrupted(drive, [{"kind": "blackouts", "probability": 0.03, "seconds": 0.45}], 2)
    empty = np.array([len(frame.observation) == 0 for frame in dark.frames])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], empty, [False]]).astype(int)))
    lengths = edges[1::2] - edges[::2]
    assert len(lengths) >= 1
    assert all(n >= 5 or edges[-1] == len(empty) for n in lengths)
    assert 5 in lengths  # of 0.1 s each: those that begin 0, 0.1, ... 0.4 s after the first
    assert not changes(drive, dark).any()


def test_dropped_frames_make_one_longer_step_of_several():
    """The odometry over a gap leads to where the true poses are: the drive turns steadily."""
    recording = small_recording(frames=40)
    result = corrupted(recording, [{"kind": "dropped-frames", "probability": 0.5}], 0)
    assert result.frames[0] is recording.frames[0]
    assert 10 < len(result) < 30
    gaps = 0
    for before, frame in zip(result.frames[:-1], result.frames[1:], strict=True):
        steps = round((frame.timestamp - before.timestamp) / DT)
        gaps = max(gaps, steps)
        np.testing.assert_allclose(frame.odometry.angular, [0.0, 0.2, 0.0], atol=1e-12)
        dt = frame.timestamp - before.timestamp
        np.testing.assert_allclose(before.truth.position + dt * frame.truth_velocity.linear, frame.truth.position)
        np.testing.assert_allclose(frame.truth_velocity.angular, [0.0, 0.2, 0.0], atol=1e-9)
        in_camera = before.truth.to_camera(frame.truth.position)
        half = 0.5 * dt * 0.2
        forward = np.array([[np.cos(half), 0, np.sin(half)], [0, 1, 0], [-np.sin(half), 0, np.cos(half)]])
        np.testing.assert_allclose(dt * forward @ frame.odometry.linear, in_camera, atol=1e-9)
        np.testing.assert_allclose(frame.odometry.covariance, 1e-4 * np.eye(6) / steps, atol=1e-12)
    assert gaps >= 3
    bare = corrupted(small_recording(truth=False, odometry=False), [{"kind": "dropped-frames", "probability": 0.5}], 0)
    assert all(f.odometry is None and f.truth_velocity is None for f in bare.frames)


def test_duplicated_frames_show_the_picture_before(drive):
    result = corrupted(drive, [{"kind": "duplicated-frames", "probability": 0.5}], 0)
    repeated = 0
    for k in range(1, len(drive)):
        shown, before = result.frames[k].observation, result.frames[k - 1].observation
        assert shown is drive.frames[k].observation or shown is before
        repeated += shown is before
        assert result.frames[k].timestamp == drive.frames[k].timestamp
    assert 20 < repeated < 40


def test_latency_shows_what_was_there_some_frames_ago(drive):
    late = corrupted(drive, [{"kind": "latency", "frames": 3}], 0)
    assert [len(frame.observation) for frame in late.frames[:3]] == [0, 0, 0]
    assert all(a.observation is b.observation for a, b in zip(late.frames[3:], drive.frames[:-3], strict=True))
    longer = corrupted(small_recording(frames=2), [{"kind": "latency", "frames": 5}], 0)
    assert [len(frame.observation) for frame in longer.frames] == [0, 0]


def test_moving_landmarks_move_steadily_and_have_no_truth():
    """Without noise, the measured points in W are on a straight line, at the right speed, from the true position on."""
    recording = small_recording(sigma=1e-9, frames=10)
    moved = corrupted(recording, [{"kind": "moving-landmarks", "share": 0.5, "speed": 2.0}], 1)
    static = set(moved.landmarks.ids.tolist())
    assert 10 < len(static) < 30
    for i, place in zip(recording.landmarks.ids.tolist(), recording.landmarks.positions, strict=True):
        seen = [
            (frame.timestamp, frame.truth.position + rotated(frame, CAMERA.backproject(frame.observation.uvd[at])))
            for frame in moved.frames
            for at in np.flatnonzero(frame.observation.ids == i)
        ]
        times, points = np.array([t for t, _ in seen]), np.array([p for _, p in seen])
        if not len(times):
            continue
        np.testing.assert_allclose(points[0], place, atol=1e-4)
        speeds = np.linalg.norm(points[1:] - place, axis=1) / (times[1:] - times[0])
        np.testing.assert_allclose(speeds, 0.0 if i in static else 2.0, atol=1e-3)
        np.testing.assert_allclose(points[:, 1], place[1], atol=1e-4)


def rotated(frame, point_c):
    return rotations.matrix(frame.truth.orientation) @ point_c


def test_moving_landmarks_keep_their_noise_and_leave_the_images(drive):
    fast = corrupted(drive, [{"kind": "moving-landmarks", "share": 1.0, "speed": 30.0}], 0)
    still = corrupted(drive, [{"kind": "moving-landmarks", "share": 1.0, "speed": 0.0}], 0)
    assert len(measurements(fast)) < len(measurements(drive)) == len(measurements(still))
    np.testing.assert_allclose(changes(drive, still), 0.0, atol=1e-9)
    assert len(fast.landmarks.ids) == 0


def test_moving_landmarks_need_the_truth():
    for recording in (
        small_recording(truth=False),
        dataclasses.replace(small_recording(), landmarks=LandmarkTruth(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))),
    ):
        with pytest.raises(ValueError, match="corruption 'moving-landmarks' of 'small': needs the true landmarks"):
            corrupted(recording, [{"kind": "moving-landmarks", "share": 0.1, "speed": 1.0}], 0)


def test_a_wrong_calibration_is_another_camera_before_the_same_points():
    recording, per_cent = small_recording(sigma=1e-9), {"focal": 2.0, "baseline": -3.0, "principal_point": 1.0}
    entry = {"kind": "wrong-calibration", **{f"{name}_percent": value for name, value in per_cent.items()}}
    factors = {"fx": 1.02, "fy": 1.02, "cx": 1.01, "cy": 1.01, "baseline": 0.97}
    real = dataclasses.replace(CAMERA, **{name: by * getattr(CAMERA, name) for name, by in factors.items()})
    for before, after in zip(recording.frames, corrupted(recording, [entry], 0).frames, strict=True):
        points_c = CAMERA.backproject(before.observation.uvd)
        np.testing.assert_allclose(after.observation.uvd, real.project(points_c), atol=1e-9)


def test_biased_disparity_is_that_and_nothing_else(drive):
    added = changes(drive, corrupted(drive, [{"kind": "biased-disparity", "bias": -0.5}], 0))
    np.testing.assert_allclose(added, np.tile([0.0, 0.0, -0.5], (len(added), 1)), atol=1e-9)


def test_misscaled_noise_is_only_told():
    recording = small_recording()
    own = recording.with_observations(
        dataclasses.replace(f.observation, R=np.tile(np.eye(3), (len(f.observation), 1, 1))) for f in recording.frames
    )
    told = corrupted(own, [{"kind": "misscaled-noise", "factor": 3.0}], 0)
    assert told.noise == StereoNoise(9.0 * recording.noise.R)
    np.testing.assert_array_equal(told.frames[0].observation.R[0], 9.0 * np.eye(3))
    assert not changes(own, told).any()
