"""The odometry measures the mean body velocity of a step."""

import numpy as np
import pytest

from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.recording.recording import Velocity
from stereo_slam_env.sensing.sensors import OdometrySensor
from stereo_slam_env.world.vehicle import advance

BEFORE = Pose(np.array([1.0, 2.0, 3.0]), rotations.exp_quaternion([0.1, -0.4, 0.2]))
VELOCITY = Velocity(np.array([1.0, -0.2, 4.0]), np.array([0.1, 0.6, -0.2]))


def test_without_noise_it_gives_the_next_pose_by_dead_reckoning():
    measured = OdometrySensor(0.0, 0.0).measure(BEFORE, VELOCITY, 0.1, np.random.default_rng(0))
    after = advance(BEFORE, VELOCITY, 0.1)
    R_middle = rotations.matrix(BEFORE.orientation) @ rotations.exp(0.05 * measured.angular)
    np.testing.assert_allclose(BEFORE.position + 0.1 * R_middle @ measured.linear, after.position, atol=1e-12)
    np.testing.assert_allclose(measured.angular, VELOCITY.angular)


def test_noise_is_white_with_the_declared_covariance():
    rng, sensor = np.random.default_rng(1), OdometrySensor(0.1, 0.01)
    samples = [sensor.measure(BEFORE, VELOCITY, 0.1, rng) for _ in range(3000)]
    stacked = np.array([np.concatenate([s.linear, s.angular]) for s in samples])
    np.testing.assert_allclose(stacked.std(axis=0), np.repeat([0.1, 0.01], 3), rtol=0.08)
    np.testing.assert_allclose(samples[0].covariance, np.diag(np.repeat([0.01, 0.0001], 3)))


def test_negative_sigma_is_refused():
    with pytest.raises(ValueError, match="odometry_sigma_linear"):
        OdometrySensor(-0.1, 0.01)
