"""What would be seen from an imagined pose, against what the filter itself predicts (8 s)."""

import numpy as np
import pytest

from filters import StereoNoise
from filters.geometry import rotations
from stereo_slam_env.policies.foresight import CameraPoses, SensorModel
from stereo_slam_env.policies.planning import Outlook

from .looking import in_cameras, innovation_covariances, knowledge_of, looked_around, sensor_of


def here(slam):
    return CameraPoses(slam.pose.position, rotations.matrix(slam.pose.orientation))


@pytest.fixture(
    scope="module", params=["shared-anchor", "euclidean", "inverse-depth", "right-invariant", "dual-bearing"]
)
def env(request):
    env = looked_around(filter=request.param, options={"error": "so3"} if request.param == "inverse-depth" else {})
    yield env
    env.close()


def test_at_the_present_pose_it_is_the_forecast_of_the_filter(env):
    knowledge, sensor = knowledge_of(env.slam), sensor_of(env)
    forecast = env.slam.forecast(knowledge.ids)
    assert 3 < forecast.in_view.sum() < len(forecast.ids)
    np.testing.assert_array_equal(sensor.in_view(knowledge.points, here(env.slam)), forecast.in_view)
    S = innovation_covariances(sensor, knowledge, here(env.slam))
    scale = np.abs(forecast.S).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(S / scale, forecast.S / scale, rtol=0, atol=1e-9)


def test_many_cameras_at_once_are_each_by_itself():
    env = looked_around()
    knowledge, sensor = knowledge_of(env.slam), sensor_of(env, nearest=4.0, farthest=30.0, margin=2.0, most=5)
    turns = rotations.exp(np.array([[[0.0, pan, 0.0] for pan in (-1.5, 0.0, 0.8)], [[0.2, 0.0, 0.1]] * 3]))
    many = CameraPoses(here(env.slam).positions + np.arange(6.0).reshape(2, 3, 1), here(env.slam).R_wc @ turns)
    information = sensor.information(knowledge.points, many)
    assert information.shape == (2, 3, len(knowledge.points), 3, 3)
    for index in np.ndindex(2, 3):
        np.testing.assert_array_equal(sensor.information(knowledge.points, many[index]), information[index])
    env.close()


def test_information_is_that_of_the_measurements_in_view():
    """H^T R^-1 H by the camera itself, with errors of u, v and d that are correlated."""
    env = looked_around()
    knowledge = knowledge_of(env.slam)
    A = np.random.default_rng(0).normal(size=(3, 3))
    noise = StereoNoise(A @ A.T + np.eye(3))
    sensor = SensorModel(env.get_wrapper_attr("camera"), noise, nearest=3.0, farthest=30.0, margin=5.0)
    cameras = CameraPoses(np.tile(env.slam.pose.position, (9, 1)), rotations.exp([[0.1, 0.7 * k, 0] for k in range(9)]))
    points_c = in_cameras(knowledge.points, cameras)
    z, uvd = points_c[..., 2], sensor.camera.project(points_c)
    in_view = (z >= 3.0) & (z <= 30.0) & sensor.camera.in_view(uvd, 5.0)
    H = sensor.camera.project_jacobian(points_c) @ cameras.R_wc.transpose(0, 2, 1)[:, None]
    expected = np.where(in_view[..., None, None], np.swapaxes(H, -1, -2) @ np.linalg.inv(noise.R) @ H, 0.0)
    assert 5 < in_view.sum() < in_view.size
    np.testing.assert_array_equal(sensor.in_view(knowledge.points, cameras), in_view)
    np.testing.assert_allclose(sensor.information(knowledge.points, cameras), expected, rtol=1e-9, atol=1e-12)
    env.close()


def test_where_more_are_in_view_than_are_measured_each_counts_with_its_share():
    env = looked_around()
    camera = CameraPoses(np.zeros(3), np.eye(3))
    points = np.array([[x, 0.0, 12.0] for x in (-2.0, 0.0, 1.0, 2.0)])
    all_of_them, half = (sensor_of(env, most=most).information(points, camera) for most in (None, 2))
    assert sensor_of(env, farthest=20.0).reach > 20.0
    np.testing.assert_allclose(half, 0.5 * all_of_them, rtol=1e-12)
    env.close()


@pytest.mark.parametrize("within", [15.0, np.inf])
def test_a_planner_knows_what_the_filter_says_that_is_near(env, within):
    known, expected = Outlook(env).knowledge(within), knowledge_of(env.slam, within)
    np.testing.assert_array_equal(known.ids, expected.ids)
    assert 0 < len(known.ids) <= len(env.slam.landmarks.ids)
    np.testing.assert_allclose(known.points, expected.points, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(known.covariance, expected.covariance)
