"""Motions of the camera between the frames of a recording, from its tracks, and the accelerations they show."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from filters import ConstantVelocity, StereoCamera, StereoNoise
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.frontend.ego_motion import Pairs, Step, robust_step
from stereo_slam_env.recording.recording import Frame, Recording

FIRST_GUESS = StereoNoise.independent_pixels(0.4)
"""For the weights of the motion between two frames, where measurements bring no covariance."""


@dataclass(frozen=True, eq=False)
class CameraStep:
    """Most likely motion of the camera between two frames."""

    step: Step
    """The motion."""
    variances: FloatArray
    """(6,): of its error, m^2 and rad^2."""
    pairs: Pairs
    """Tracks of both frames."""


@lru_cache(maxsize=2)
def camera_steps(camera: StereoCamera, frames: tuple[Frame, ...]) -> tuple[CameraStep | None, ...]:
    """Robust motion to each frame but the first from the one before; None where too few tracks agree.

    Kept for the recording looked at last, since noise, accelerations and the audit of the reference all need it.
    """
    steps: list[CameraStep | None] = []
    for before, now in pairwise(frames):
        pairs = Pairs.between(before.observation, now.observation, FIRST_GUESS)
        last = steps[-1] if steps else None
        found = robust_step(camera, pairs, None if last is None else last.step)
        if found is None:
            steps.append(None)
        else:
            steps.append(CameraStep(found.step, np.diag(found.estimate.covariance).copy(), pairs))
    return tuple(steps)


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
    steps = camera_steps(recording.camera, recording.frames)
    for (before, now), found in zip(pairwise(recording.frames), steps, strict=True):
        if found is None:
            last = None
            continue
        dt, R = now.timestamp - before.timestamp, found.step.R
        velocity = np.concatenate([found.step.t, rotations.log(R)]) / dt
        guessed = now.observation.R is None
        scale = float(np.trace(recording.noise.R) / np.trace(FIRST_GUESS.R)) if guessed else 1.0
        variance = scale * found.variances / dt**2
        if last is not None:
            R_last, earlier, earlier_variance = last
            change = np.concatenate([R_last @ velocity[:3], velocity[3:]]) - earlier
            squares.append((change**2 - variance - earlier_variance) / dt**2)
        last = R, velocity, variance
    if not squares:
        return usual
    linear, angular = np.mean(squares, axis=0).reshape(2, 3).mean(axis=1)
    return ConstantVelocity(
        max(usual.sigma_acceleration, float(np.sqrt(max(linear, 0.0)))),
        max(usual.sigma_angular_acceleration, float(np.sqrt(max(angular, 0.0)))),
    )
