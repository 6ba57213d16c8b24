"""The map in the camera against the truth (0.3 s)."""

import numpy as np
import pytest

from filters import make_filter
from stereo_slam_env.evaluation.map_scoring import FrameMap, MapView, depths, score_maps, view_maps

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
