"""Odometry: the body velocity with white noise."""

from __future__ import annotations

import numpy as np

from filters import rotations
from filters.interface import BodyVelocity
from filters.validation import FloatArray, positive, unchecked
from stereo_slam_env.recording.recording import Pose, Velocity


class OdometrySensor:
    """Measures the mean velocity of the left camera over a step.

    Parameters
    ----------
    sigma_linear, sigma_angular : float
        Standard deviation of each component, m/s and rad/s; 0 is allowed.
    """

    def __init__(self, sigma_linear: float, sigma_angular: float) -> None:
        sigmas = [
            positive("odometry_sigma_linear", sigma_linear, allow_zero=True),
            positive("odometry_sigma_angular", sigma_angular, allow_zero=True),
        ]
        self._sigmas: FloatArray = np.repeat(sigmas, 3)
        self._covariance: FloatArray = np.diag(self._sigmas**2)
        self._covariance.flags.writeable = False

    def measure(self, before: Pose, velocity: Velocity, dt: float, rng: np.random.Generator) -> BodyVelocity:
        """Measure the step of `dt` s that left `before` with `velocity`.

        The linear part is in the camera frame half-way through the turn, as filters expect it.
        """
        half_way = before.R_wc @ rotations.exp(0.5 * dt * velocity.angular)
        true = np.concatenate([half_way.T @ velocity.linear, velocity.angular])
        measured = true + self._sigmas * rng.standard_normal(6)
        return unchecked(BodyVelocity, linear=measured[:3], angular=measured[3:], covariance=self._covariance)
