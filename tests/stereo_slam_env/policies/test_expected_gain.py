"""The expected gain, against what filters really gain from exactly those measurements (6 s)."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from filters import BodyVelocity, StereoObservation
from filters.geometry import rotations
from stereo_slam_env.policies.expected_gain import expected_gain, motion_noise
from stereo_slam_env.policies.foresight import CameraPoses, Knowledge

from .looking import looked_around, sensor_of

DT, SIGMAS = 0.1, (0.1, 0.01)


@pytest.fixture(scope="module")
def env():
    env = looked_around()
    yield env
    env.close()


def here(slam):
    return CameraPoses(slam.pose.position, rotations.matrix(slam.pose.orientation))


def logdet(slam, ids, gain):
    return np.linalg.slogdet(slam.pose.covariance if gain == "pose" else slam.joint_covariance(ids))[1]


def odometry(linear=(0.0, 0.0, 4.0), angular=(0.0, 0.0, 0.0)):
    return BodyVelocity(linear, angular, np.diag(np.repeat(np.square(SIGMAS), 3)))


def measure(slam, ids):
    """Exactly what the filter predicts: it gains information and moves nowhere."""
    slam.update(StereoObservation(ids, slam.forecast(ids).uvd))


@pytest.mark.parametrize("gain", ["pose", "map"])
def test_of_one_look_it_is_what_the_filter_gains(env, gain):
    slam = copy.deepcopy(env.slam)
    knowledge, sensor = Knowledge.of(slam), sensor_of(env)
    looks = sensor.information(knowledge.points, here(slam))[None, None]
    expected = expected_gain(knowledge, looks, np.zeros((1, 6, 6)), gain)[0]
    before = logdet(slam, knowledge.ids, gain)
    measure(slam, knowledge.ids[slam.forecast(knowledge.ids).in_view])
    gained = 0.5 * (before - logdet(slam, knowledge.ids, gain))
    assert gained > 0.02
    np.testing.assert_allclose(expected, gained, rtol=1e-6)


def test_of_the_map_it_is_half_logdet_S_less_half_logdet_R(env):
    slam, sensor = env.slam, sensor_of(env)
    knowledge = Knowledge.of(slam)
    camera = here(slam)
    seen = np.flatnonzero(sensor.sight(knowledge.points, camera).in_view)
    part = knowledge.of_landmarks(seen)
    H_p = sensor.camera.project_jacobian(camera.to_camera(part.points)) @ camera.R_wc.T
    H = np.zeros((3 * len(seen), 6 + 3 * len(seen)))
    for k in range(len(seen)):
        H[3 * k : 3 * k + 3, :6], H[3 * k : 3 * k + 3, 6 + 3 * k : 9 + 3 * k] = H_p[k] @ part.by_pose[k], H_p[k]
    R = np.kron(np.eye(len(seen)), sensor.noise.R)
    half = 0.5 * (np.linalg.slogdet(H @ part.covariance @ H.T + R)[1] - np.linalg.slogdet(R)[1])
    looks = sensor.information(knowledge.points, camera)[None, None]
    np.testing.assert_allclose(expected_gain(knowledge, looks, np.zeros((1, 6, 6)), "map")[0], half, rtol=1e-9)


@pytest.mark.parametrize("gain", ["pose", "map"])
@pytest.mark.parametrize("turning", [0.0, -0.5])
def test_of_a_sequence_of_looks_on_the_way_it_is_what_the_filter_gains(env, gain, turning):
    slam = copy.deepcopy(env.slam)
    blind = copy.deepcopy(slam)
    knowledge, sensor, steps = Knowledge.of(slam), sensor_of(env), 5
    positions, looks, gone = [slam.pose.position], [], []
    for _ in range(steps):
        for each in (slam, blind):
            each.predict(DT, odometry(angular=(0.0, turning, 0.0)))
        positions.append(slam.pose.position)
        looks.append(sensor.information(knowledge.points, here(slam)))
        seen = knowledge.ids[looks[-1].any(axis=(1, 2))]
        gone.append(len(seen))
        measure(slam, seen)
    assert min(gone) > 0
    middles = 0.5 * (np.array(positions[1:]) + np.array(positions[:-1])) - positions[0]
    Q = motion_noise(middles, *(DT * sigma for sigma in SIGMAS))
    expected = expected_gain(knowledge, np.array(looks)[None], Q, gain)[0]
    gained = 0.5 * (logdet(blind, knowledge.ids, gain) - logdet(slam, knowledge.ids, gain))
    # the Jacobian of the turn is left out of the noise: 1 - turn^2 / 12 of its variance
    np.testing.assert_allclose(expected, gained, rtol=1e-6 if turning == 0.0 else (turning * DT) ** 2 / 12)


def test_sequences_are_judged_each_by_itself_and_one_that_sees_nothing_gains_nothing(env):
    knowledge, sensor = Knowledge.of(env.slam), sensor_of(env)
    looks = sensor.information(knowledge.points, here(env.slam))
    sequences = np.stack([np.stack([looks, looks]), np.stack([looks, 0 * looks]), np.zeros((2, *looks.shape))])
    Q = motion_noise(np.ones((2, 3)), 0.01, 0.001)
    gains = expected_gain(knowledge, sequences, Q, "map")
    for k in range(3):
        np.testing.assert_allclose(expected_gain(knowledge, sequences[k : k + 1], Q, "map"), gains[k], rtol=1e-9)
    assert gains[0] > gains[1] > 0.0
    assert abs(gains[2]) < 1e-9


def test_a_map_of_nothing_has_nothing_to_gain(env):
    nothing = Knowledge.of(env.slam, within=0.0)
    assert len(nothing.ids) == 0
    np.testing.assert_array_equal(
        expected_gain(nothing, np.zeros((4, 2, 0, 3, 3)), np.zeros((2, 6, 6)), "pose"), np.zeros(4)
    )


def test_a_start_that_is_known_exactly_and_odometry_without_error_are_no_trouble(env):
    slam = copy.deepcopy(env.slam)
    slam.reset()
    observation = env.get_wrapper_attr("frame").observation
    slam.update(observation)
    knowledge, sensor = Knowledge.of(slam), sensor_of(env)
    looks = np.repeat(sensor.information(knowledge.points, here(slam))[None, None], 8, axis=1)
    for sigmas in (0.0, 0.0), (0.01, 0.001):
        Q = motion_noise(np.zeros((8, 3)), *sigmas)
        for gain in ("pose", "map"):
            assert np.isfinite(expected_gain(knowledge, looks, Q, gain)).all()


def test_a_covariance_that_is_none_is_named(env):
    knowledge = Knowledge.of(env.slam)
    looks = sensor_of(env).information(knowledge.points, here(env.slam))[None, None]
    covariance = knowledge.covariance.copy()
    covariance[0, 1] = covariance[1, 0] = 2.0 * np.sqrt(covariance[0, 0] * covariance[1, 1])
    with pytest.raises(ArithmeticError, match="positive definite"):
        expected_gain(replace(knowledge, covariance=covariance), looks, np.zeros((1, 6, 6)), "pose")
