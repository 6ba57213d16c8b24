"""The expected gain, against what filters really gain from exactly those measurements (6 s)."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from filters import BodyVelocity, StereoObservation
from filters.geometry import rotations
from stereo_slam_env.policies.foresight import CameraPoses, expected_gain, motion_noise

from .looking import knowledge_of, looked_around, sensor_of, whole_jacobians

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
@pytest.mark.parametrize("turning", [0.0, -0.5])
def test_of_a_sequence_of_looks_on_the_way_it_is_what_the_filter_gains(env, gain, turning):
    slam = copy.deepcopy(env.slam)
    blind = copy.deepcopy(slam)
    knowledge, sensor, steps = knowledge_of(slam), sensor_of(env), 5
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


def test_a_map_of_nothing_has_nothing_to_gain(env):
    nothing = knowledge_of(env.slam, within=0.0)
    assert len(nothing.ids) == 0
    gains = expected_gain(nothing, np.zeros((4, 2, 0, 3, 3)), np.zeros((2, 6, 6)), "pose")
    np.testing.assert_array_equal(gains, np.zeros(4))


def test_a_start_that_is_known_exactly_and_odometry_without_error_are_no_trouble(env):
    slam = copy.deepcopy(env.slam)
    slam.reset()
    observation = env.get_wrapper_attr("frame").observation
    slam.update(observation)
    knowledge, sensor = knowledge_of(slam), sensor_of(env)
    looks = np.repeat(sensor.information(knowledge.points, here(slam))[None, None], 8, axis=1)
    for sigmas in (0.0, 0.0), (0.01, 0.001):
        Q = motion_noise(np.zeros((8, 3)), *sigmas)
        for gain in ("pose", "map"):
            assert np.isfinite(expected_gain(knowledge, looks, Q, gain)).all()


def test_a_covariance_that_is_none_is_named(env):
    knowledge = knowledge_of(env.slam)
    looks = sensor_of(env).information(knowledge.points, here(env.slam))[None, None]
    covariance = knowledge.covariance.copy()
    covariance[0, 1] = covariance[1, 0] = 2.0 * np.sqrt(covariance[0, 0] * covariance[1, 1])
    with pytest.raises(ArithmeticError, match="positive definite"):
        expected_gain(replace(knowledge, covariance=covariance), looks, np.zeros((1, 6, 6)), "pose")


@pytest.mark.parametrize("gain", ["pose", "map"])
@pytest.mark.parametrize("steps", [1, 6])
def test_it_is_that_of_the_whole_information_matrix_put_together_look_by_look(env, gain, steps):
    """Brute force: pose and all landmarks in every step, by inverses; some looks see nothing, some landmark never."""
    knowledge, sensor, rng = knowledge_of(env.slam), sensor_of(env, farthest=25.0, most=4), np.random.default_rng(1)
    turns = rotations.exp(np.stack([np.zeros(4), [-1.5, 0.0, 0.7, 3.1], np.zeros(4)], axis=1))
    cameras = CameraPoses(
        env.slam.pose.position + rng.normal(0.0, 1.0, (4, steps, 3)),
        here(env.slam).R_wc @ turns[:, None].repeat(steps, 1),
    )
    looks = sensor.information(knowledge.points, cameras)
    looks[1, : steps - 1] = 0.0
    looks[2] = 0.0
    Q = motion_noise(rng.normal(0.0, 1.0, (steps, 3)), 0.02, 0.004)
    size, J = 6 + 3 * len(knowledge.points), whole_jacobians(knowledge)
    seen = looks.any(axis=(3, 4))
    assert 0 < seen.any(axis=(0, 1)).sum() < len(knowledge.points)

    def logdet(sequence):
        covariance = knowledge.covariance
        for k in range(steps):
            covariance = covariance + np.pad(Q[k], (0, size - 6))
            information = np.linalg.inv(covariance) + np.einsum("nia,nij,njb->ab", J, sequence[k], J)
            covariance = np.linalg.inv(information)
        return np.linalg.slogdet(covariance[:6, :6] if gain == "pose" else covariance)[1]

    expected = [0.5 * (logdet(0.0 * sequence) - logdet(sequence)) for sequence in looks]
    assert max(expected) > 0.1
    np.testing.assert_allclose(expected_gain(knowledge, looks, Q, gain), expected, rtol=1e-6, atol=1e-7)
