"""Five filters with one planted error each: what is wrong? `check_filter` finds each of them.

They are the stereo EKF of this package with one thing done wrong, as it is done wrong in practice. What each line of the
report means is exercise 3a: name the error of each by one of the words R, dt, baseline, S, process noise.
"""

from dataclasses import replace

import numpy as np

from filters import ConstantVelocity, StereoCamera, StereoEKF, StereoObservation


class First(StereoEKF):
    """A filter that is told to trust its camera."""

    def update(self, observation):
        """Correct."""
        if not isinstance(observation, StereoObservation):
            return super().update(observation)
        R = np.tile(self.noise.R / 25.0, (len(observation), 1, 1))
        return super().update(StereoObservation(observation.ids, observation.uvd, R=R))


class Second(StereoEKF):
    """A filter with a clock of its own."""

    def predict(self, dt, odometry=None, inertial=None):
        """Predict."""
        super().predict(1e-3 * dt, odometry, inertial)


class Third(StereoEKF):
    """A filter whose rig was measured with a ruler."""

    def __init__(self, camera, noise, **options):
        numbers = camera.fx, camera.fy, camera.cx, camera.cy, 1.05 * camera.baseline
        super().__init__(StereoCamera(*numbers, camera.width, camera.height), noise, **options)
        self.camera = camera


class Fourth(StereoEKF):
    """A filter whose map was ported from another library."""

    def forecast(self, ids=None):
        """Predicted measurements and their innovation covariances."""
        expected = super().forecast(ids)
        return replace(expected, S=expected.S - self.noise.R)


class Fifth(StereoEKF):
    """A filter that knows how cars move."""

    def __init__(self, camera, noise, **options):
        options["motion"] = ConstantVelocity(1e-3, 1e-4)
        super().__init__(camera, noise, **options)


ALL = (First, Second, Third, Fourth, Fifth)
