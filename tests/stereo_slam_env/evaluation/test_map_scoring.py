"""The map in the camera against the truth; its errors by range and by age; which landmarks are traced (1 s)."""

from dataclasses import fields, replace

import numpy as np
import pytest

from filters import Start, StereoNoise, StereoObservation, make_filter
from stereo_slam_env.evaluation.landmark_statistics import (
    AT_INFINITY,
    LandmarkScorer,
    LandmarkStatistics,
    depth_convergence,
    range_errors,
)
from stereo_slam_env.evaluation.map_scoring import (
    FrameMap,
    MapScore,
    MapView,
    TraceRecorder,
    choose_landmarks,
    depths,
    score_maps,
    view_maps,
)
from stereo_slam_env.recording.recording import Frame, Recording

from ..benchmark.small_recordings import CAMERA, small_recording


def scored(points, uvd, spread=1.0):
    return score_maps(view(points, uvd, spread), CAMERA)


def view(points, uvd, spread=1.0):
    count = len(uvd)
    covariance = np.tile(spread**2 * np.eye(3), (count, 1, 1))
    return MapView(np.zeros(count, dtype=int), np.arange(count), np.array(uvd), covariance, np.array(points))


def of_frame(score, figure):
    """The figure of the only frame."""
    (value,) = getattr(score, figure)(range(1))
    return value


def test_the_covariance_of_new_landmarks_is_the_noise_of_their_measurement():
    recording = small_recording()
    frame = recording.frames[0]
    for name in ("inverse-depth", "euclidean"):
        estimator = make_filter(name, camera=CAMERA, noise=recording.noise)
        estimator.update(frame.observation)
        seen = view_maps([FrameMap(0, frame, estimator.forecast(), estimator.noise.R)], recording.landmarks)
        np.testing.assert_allclose(
            seen.covariance, np.broadcast_to(recording.noise.R, seen.covariance.shape), atol=1e-9
        )
        truth = CAMERA.backproject(CAMERA.project(recording.landmarks.positions[seen.ids]))
        np.testing.assert_allclose(seen.true_points, truth, atol=1e-9)


def test_nees_is_that_of_the_predicted_measurement():
    points = [[0.0, 0.0, 35.0], [1.0, 1.0, 17.5]]
    uvd = CAMERA.project(points) + np.array([2.0, 0.0, 0.0])
    assert of_frame(scored(points, uvd, spread=2.0), "mean_nees") == pytest.approx(1.0)


def test_landmarks_without_truth_or_truly_behind_are_not_scored():
    behind = scored([[np.nan] * 3, [0.0, 0.0, -5.0]], [[600.0, 180.0, 10.0]] * 2)
    assert np.isnan(of_frame(behind, "mean_nees"))
    assert np.isnan(of_frame(scored([[np.nan] * 3], [[600.0, 180.0, 10.0]]), "position_rmse"))


def test_position_error_is_of_near_landmarks_only():
    points = [[0.0, 0.0, 35.0], [0.0, 0.0, 70.0]]
    shifted = CAMERA.project(np.array(points) + np.array([0.0, 0.0, 0.5]))
    assert of_frame(scored(points, shifted), "position_rmse") == pytest.approx(0.5)


def test_depth_and_its_spread_follow_from_the_disparity():
    uvd = [[600.0, 180.0, d] for d in (10.0, 0.01, 0.0, -0.01, -1.0)]
    depth, sigma = depths(view([[0.0] * 3] * 5, uvd, spread=0.5), CAMERA)
    np.testing.assert_allclose(depth, [35.0, 35_000.0, np.nan, np.nan, np.nan])
    np.testing.assert_allclose(sigma, [35.0 * 0.05, 35_000.0 * 50.0, np.nan, np.nan, np.nan])


def test_a_kept_landmark_out_of_view_is_not_scored():
    """Beside the camera a pixel of error is nothing like Gaussian, and filters that drop it are not judged by it."""
    seen, passed = [0.0, 0.0, 20.0], [30.0, 0.0, 1.0]
    uvd = CAMERA.project([seen, passed]) + np.array([[1.0, 0.0, 0.0], [500.0, 0.0, 0.0]])
    for figure in ("mean_nees", "position_rmse"):
        assert of_frame(scored([seen, passed], uvd), figure) == of_frame(scored([seen], uvd[:1]), figure)


F_B = CAMERA.disparity_constant


def ahead(depths):
    """Points straight ahead."""
    return np.column_stack([np.zeros(len(depths)), np.zeros(len(depths)), depths])


def map_score(points, estimated, ids=None, variance=1.0):
    """Score of a map whose points are believed elsewhere, by (u, v, d) with this variance each."""
    ids = np.arange(len(points)) if ids is None else np.asarray(ids)
    uvd = CAMERA.project(np.asarray(estimated, dtype=float))
    covariance = np.tile(variance * np.eye(3), (len(ids), 1, 1))
    return score_maps(MapView(np.zeros(len(ids), dtype=int), ids, uvd, covariance, points), CAMERA)


def statistics(*frames, at_once=1):
    """Statistics of maps of one frame each, so many of them scored together."""
    scorer, numbered = LandmarkScorer(CAMERA), [replace(f, frames=f.frames + k) for k, f in enumerate(frames)]
    for first in range(0, len(frames), at_once):
        some = numbered[first : first + at_once]
        columns = (np.concatenate([getattr(one, field.name) for one in some]) for field in fields(MapScore))
        scorer.add(MapScore(*columns), range(first, first + len(some)))
    return scorer.statistics


def test_errors_go_to_the_range_of_the_true_distance():
    depths = np.array([5.0, 10.0, 19.0, 39.0, 50.0, 79.0, 80.0])
    found = range_errors([statistics(map_score(ahead(depths), ahead(depths + 0.5)))])
    assert [(part.low_m, part.count) for part in found] == [(0.0, 1), (10.0, 2), (20.0, 1), (40.0, 2), (80.0, 1)]
    for part in found:
        assert part.rmse_m == pytest.approx(0.5)
        assert part.depth_bias_m == pytest.approx(0.5)
        assert np.isnan(part.depth_bias_sigma_m)
    assert found[0].anees == pytest.approx((F_B / 5.0 - F_B / 5.5) ** 2)


def test_a_landmark_at_infinity_has_a_nees_and_no_position():
    depths = np.array([100.0, 100.0, 100.0])
    estimated = ahead([101.0, AT_INFINITY * 100.0 + 1.0, -100.0])
    (part,) = range_errors([statistics(map_score(ahead(depths), estimated))])
    assert part.count == 3
    assert part.rmse_m == pytest.approx(1.0)
    assert part.anees == pytest.approx(np.mean((F_B / depths - F_B / estimated[:, 2]) ** 2))


def test_landmarks_out_of_view_or_without_truth_are_left_out():
    points = np.array([[0.0, 0.0, -20.0], [30.0, 0.0, 1.0], [np.nan] * 3])
    total = statistics(map_score(points, ahead([20.0, 20.0, 20.0])))
    assert total.nees_count.sum() == total.position_count.sum() == total.age_count.sum() == 0
    assert range_errors([total]) == depth_convergence([total]) == ()


def test_convergence_is_by_class_at_entry_and_by_frames_since():
    """A near and a far landmark; the far one is out of the map for a frame and begins anew, nearer than far."""
    near, far = 20.0, 64.0
    frames = [
        map_score(ahead([near, far]), ahead([near, far]), [3, 8], variance=4.0),
        map_score(ahead([near - 8, far - 8]), ahead([near - 8, far - 8]), [3, 8], variance=1.0),
        map_score(ahead([near - 9]), ahead([near - 9]), [3], variance=1.0),
        map_score(ahead([far - 10]), ahead([far - 10]), [8], variance=1.0),
    ]
    first, second = depth_convergence([statistics(*frames)])
    assert (first.label, first.frames, first.count) == ("near", (0, 1, 2), (1, 1, 1))
    assert (second.label, second.frames, second.count) == ("far", (0, 1), (1, 1))
    assert first.sigma_m == pytest.approx((near**2 / F_B * 2.0, (near - 8) ** 2 / F_B, (near - 9) ** 2 / F_B))
    assert second.sigma_m == pytest.approx((far**2 / F_B * 2.0, (far - 8) ** 2 / F_B))
    assert second.rmse_m == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("at_once", [2, 3, 40])
def test_frames_that_are_scored_together_count_as_one_after_the_other(at_once):
    """Landmarks come, stay over the ends of what is scored together, are away for a frame, and come again."""
    rng = np.random.default_rng(0)
    frames = []
    for _ in range(40):
        ids = rng.permutation(12)[: rng.integers(0, 13)]
        points = ahead(rng.choice([12.0, 20.0, 64.0, 90.0], len(ids)))
        frames.append(map_score(points, points + rng.normal(0.0, 0.1, points.shape), ids))
    for name, wanted in vars(statistics(*frames)).items():
        np.testing.assert_allclose(getattr(statistics(*frames, at_once=at_once), name), wanted, err_msg=name)


def test_the_order_of_the_map_does_not_matter_and_nonsense_spoils_nothing():
    depths = np.array([20.0, 70.0, 22.0])
    frame, other = (
        map_score(ahead(depths), ahead(depths), [9, 4, 6]),
        map_score(ahead(depths), ahead(depths + 1), [9, 4, 6]),
    )
    turned = map_score(ahead(depths[[1, 2, 0]]), ahead(depths[[1, 2, 0]] + 1), [4, 6, 9])
    lost = map_score(ahead([20.0]), ahead([20.0]), [11], variance=np.nan)
    for name, wanted in vars(statistics(frame, other)).items():
        np.testing.assert_allclose(getattr(statistics(frame, turned), name), wanted, err_msg=name)
        assert np.isfinite(getattr(statistics(frame, lost), name)).all(), name


def test_the_error_of_depth_is_defined_behind_infinity():
    (curve,) = depth_convergence([statistics(map_score(ahead([75.0]), ahead([-1000.0])))])
    assert curve.rmse_m == pytest.approx((75.0**2 / F_B * (F_B / 75.0 + F_B / 1000.0),))


def test_runs_count_by_their_landmarks_and_the_bias_scatters_between_runs():
    biases, counts = np.array([0.1, 0.3, -0.2]), np.array([10.0, 20.0, 10.0])
    runs = [
        LandmarkStatistics(
            nees_count=np.full(5, n), position_count=np.full(5, n), depth_error=np.full(5, n * bias), nees=np.full(5, n)
        )
        for bias, n in zip(biases, counts, strict=True)
    ]
    part = range_errors(runs)[2]
    mean = np.average(biases, weights=counts)
    assert part.depth_bias_m == pytest.approx(mean)
    scatter = np.sqrt(np.sum((counts * (biases - mean)) ** 2) * 3 / 2) / 40
    assert part.depth_bias_sigma_m == pytest.approx(scatter)


def test_the_standard_error_of_the_bias_is_that_of_runs_with_a_bias_of_their_own():
    rng = np.random.default_rng(0)
    means, errors = [], []
    for _ in range(500):
        counts = rng.integers(20, 60, 8).astype(float)
        biases = 0.3 * rng.standard_normal(8)
        part = range_errors(
            [
                LandmarkStatistics(
                    nees_count=np.full(5, n), position_count=np.full(5, n), depth_error=np.full(5, n * b)
                )
                for n, b in zip(counts, biases, strict=True)
            ]
        )[0]
        means.append(part.depth_bias_m)
        errors.append(part.depth_bias_sigma_m)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.std(means), rel=0.1)


def recording_of(tracks, frames=20):
    """Tracks: id -> (first frame, length, depth)."""
    taken = []
    for k in range(frames):
        seen = {i: depth for i, (first, length, depth) in tracks.items() if first <= k < first + length}
        uvd = [[600.0, 180.0, CAMERA.disparity_constant / depth] for depth in seen.values()]
        taken.append(Frame(0.1 * k, StereoObservation(list(seen), np.reshape(uvd, (-1, 3)))))
    return Recording("tracks", CAMERA, tuple(taken), StereoNoise.independent_pixels(1.0))


def test_the_landmarks_nearest_to_20_and_75_m_are_chosen():
    recording = recording_of({1: (0, 15, 12.0), 2: (0, 15, 21.0), 3: (3, 15, 70.0), 4: (0, 15, 140.0)})
    assert choose_landmarks(recording) == {"near": 2, "far": 3}


def test_short_tracks_do_not_count_where_there_are_long_ones():
    assert choose_landmarks(recording_of({1: (0, 11, 20.0), 2: (0, 12, 30.0), 3: (0, 12, 60.0)})) == {
        "near": 2,
        "far": 3,
    }
    assert choose_landmarks(recording_of({1: (0, 5, 20.0), 2: (0, 5, 75.0)})) == {"near": 1, "far": 2}


def test_near_and_far_are_different_and_may_be_missing():
    assert choose_landmarks(recording_of({1: (0, 12, 40.0)})) == {"near": 1}
    assert choose_landmarks(recording_of({})) == {}


def test_where_truth_is_known_the_noise_does_not_choose():
    quiet, noisy = small_recording(sigma=0.01), small_recording(sigma=3.0)
    assert choose_landmarks(quiet) == choose_landmarks(noisy)


def test_landmarks_with_truth_seen_from_where_nobody_knows_are_chosen_by_what_was_measured():
    recording = small_recording()
    blind = replace(recording, frames=tuple(replace(frame, truth=None) for frame in recording.frames))
    assert choose_landmarks(blind) == choose_landmarks(replace(blind, landmarks=None)) != {}


def test_a_trace_is_the_depth_in_the_current_camera():
    recording = small_recording(sigma=0.01)
    estimator = make_filter("inverse-depth", camera=CAMERA, noise=recording.noise)
    estimator.reset(Start(covariance=recording.start.covariance, linear_velocity=recording.start.linear_velocity))
    recorder = TraceRecorder(recording)
    for k, frame in enumerate(recording.frames):
        if k:
            estimator.predict(0.1)
        estimator.update(frame.observation)
        maps = [FrameMap(k, frame, estimator.forecast(), estimator.noise.R)]
        recorder.add(view_maps(maps, recording.landmarks), maps)
    near, far = recorder.traces()
    assert (near.label, far.label) == ("near", "far")
    for trace in (near, far):
        assert len(trace.frames) >= 12
        np.testing.assert_allclose(trace.depth, trace.true_depth, rtol=0.02)
        np.testing.assert_allclose(trace.measured_depth, trace.true_depth, rtol=0.02)
        assert (np.diff(trace.true_depth) < 0).all()
        assert trace.sigma[-1] < trace.sigma[0]
