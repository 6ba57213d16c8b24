"""Accelerations of the camera, measured from the tracks: what a filter has to allow for."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from filters import ConstantVelocity
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.frontend.ego_motion import Pairs, RobustStep, robust_step
from stereo_slam_env.recording.recording import Recording


def needed_motion(recording: Recording, usual: ConstantVelocity | None = None) -> ConstantVelocity:
    """The usual motion, with larger accelerations where the tracks of a recording show larger ones.

    The velocity between two frames is that of the most likely motion; from one pair of frames to the next it changes by
    the acceleration and by the errors of both motions, whose variances are subtracted. The look ahead is over the whole
    recording. Nothing is made smaller: a quiet recording says little of what comes.

    Parameters
    ----------
    recording : Recording
        Tracks. Times need not be evenly spaced.
    usual : ConstantVelocity, optional
        Of vehicles on roads unless said: `ConstantVelocity()`.

    Returns
    -------
    ConstantVelocity
        Standard deviations per axis, m/s² and rad/s²: the root mean squares of the recording, or the usual ones.
    """
    usual = ConstantVelocity() if usual is None else usual
    squares: list[FloatArray] = []
    last: tuple[FloatArray, FloatArray, FloatArray] | None = None
    step = None
    for before, now in pairwise(recording.frames):
        dt = now.timestamp - before.timestamp
        pairs = Pairs.between(before.observation, now.observation, recording.noise)
        found = robust_step(recording.camera, pairs, step)
        step = None if found is None else found.step
        if found is None:
            last = None
            continue
        velocity, variance = _velocity(found, dt)
        if last is not None:
            R, earlier, earlier_variance = last
            change = np.concatenate([R @ velocity[:3], velocity[3:]]) - earlier
            squares.append((change**2 - variance - earlier_variance) / dt**2)
        last = found.step.R, velocity, variance
    if not squares:
        return usual
    linear, angular = np.mean(squares, axis=0).reshape(2, 3).mean(axis=1)
    return ConstantVelocity(
        max(usual.sigma_acceleration, float(np.sqrt(max(linear, 0.0)))),
        max(usual.sigma_angular_acceleration, float(np.sqrt(max(angular, 0.0)))),
    )


def _velocity(found: RobustStep, dt: float) -> tuple[FloatArray, FloatArray]:
    """Velocity (6,) in the first camera and its variances: linear m/s, angular rad/s."""
    step = found.step
    return np.concatenate([step.t, rotations.log(step.R)]) / dt, np.diag(found.estimate.covariance) / dt**2
