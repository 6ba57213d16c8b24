"""Motions of the camera between the frames of a recording, from its tracks, and the accelerations they show."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from filters import ConstantVelocity, StereoCamera, StereoNoise
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.frontend.ego_motion import Pairs, Step, robust_step
from stereo_slam_env.recording.filter_setup import FilterSetup
from stereo_slam_env.recording.recording import Frame, Recording

_HARDEST = (1e3, 1e3)
"""Accelerations of no camera, m/s² and rad/s²: a flip of a racing drone has a tenth of them."""
_TURNING, _TURNS = 0.005, 5
"""Least turn of a step that tells the unit of a gyro, rad, and how many of them are needed."""
_AS_DEGREES = (30.0, 110.0)
"""Gyro over images, where the gyro gives degrees per second (57.3)."""
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

    Raises
    ------
    ValueError
        No camera moves so: the times are of another unit.
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
        variance = _variances(recording, now, found) / dt**2
        if last is not None:
            R_last, earlier, earlier_variance = last
            change = np.concatenate([R_last @ velocity[:3], velocity[3:]]) - earlier
            squares.append((change**2 - variance - earlier_variance) / dt**2)
        last = R, velocity, variance
    if not squares:
        return usual
    linear, angular = np.mean(squares, axis=0).reshape(2, 3).mean(axis=1)
    if linear > _HARDEST[0] ** 2 or angular > _HARDEST[1] ** 2:
        step = float(np.median(np.diff([frame.timestamp for frame in recording.frames])))
        raise ValueError(
            f"{recording.name}: its tracks show accelerations of {np.sqrt(max(linear, 0.0)):.3g} m/s^2 and "
            f"{np.sqrt(max(angular, 0.0)):.3g} rad/s^2, as no camera has, at {step:.3g} s a frame: are its times in "
            "seconds, and the baseline in metres?"
        )
    return ConstantVelocity(
        max(usual.sigma_acceleration, float(np.sqrt(max(linear, 0.0)))),
        max(usual.sigma_angular_acceleration, float(np.sqrt(max(angular, 0.0)))),
    )


def set_up_for_tracks(recording: Recording) -> Recording:
    """The recording of real pictures with its setup of filters, unless it states one; a simulated one as it is.

    Tracks have outliers, which the joint test over each frame finds, and accelerations that they show themselves.
    """
    if recording.stated_setup is not None or recording.truth_from.kind == "simulation":
        return recording
    setup = FilterSetup(consensus=True, motion=asdict(needed_motion(recording)))
    return replace(recording, stated_setup=setup)


def with_moving_start(recording: Recording, step: Step | None = None) -> Recording:
    """The recording with the velocity of its first step at the start, where it says none.

    A filter that starts at rest linearises its first update a whole step away, at 10 m/s a metre. The covariance is
    that of the step by the tracks, and what the usual acceleration changes within half of it; that of an unknown
    velocity where the tracks do not determine the step.

    Parameters
    ----------
    recording : Recording
        Tracks.
    step : Step, optional
        First step as a front end follows it in the images. None: the most likely one of the tracks.
    """
    start, steps = recording.start, camera_steps(recording.camera, recording.frames)
    if start.covariance is not None or start.linear_velocity.any() or not steps:
        return recording
    dt, by_tracks = recording.frames[1].timestamp - recording.frames[0].timestamp, steps[0]
    covariance, R_wc = np.array(start.assumed_covariance), rotations.matrix(start.orientation)
    if by_tracks is not None:
        usual = ConstantVelocity()
        sigmas = np.repeat([usual.sigma_acceleration, usual.sigma_angular_acceleration], 3)
        variances = _variances(recording, recording.frames[1], by_tracks) / dt**2 + (0.5 * dt * sigmas) ** 2
        covariance[6:9, 6:9], covariance[9:, 9:] = R_wc @ np.diag(variances[:3]) @ R_wc.T, np.diag(variances[3:])
        step = by_tracks.step if step is None else step
    if step is None:
        return recording
    moving = replace(
        start,
        linear_velocity=R_wc @ step.t / dt,
        angular_velocity=rotations.log(step.R) / dt,
        covariance=covariance,
    )
    return replace(recording, start=moving)


def _variances(recording: Recording, now: Frame, found: CameraStep) -> FloatArray:
    """Variances (6,) of a step, by the noise of the recording where its measurements bring no covariance."""
    guessed = now.observation.R is None
    return found.variances * (float(np.trace(recording.noise.R) / np.trace(FIRST_GUESS.R)) if guessed else 1.0)


def require_gyro_units(recording: Recording) -> None:
    """Raise a `ValueError` where the gyro turns by degrees where the images turn by radians."""
    if not any(frame.inertial is not None for frame in recording.frames):
        return
    ratios = []
    for frame, found in zip(recording.frames[1:], camera_steps(recording.camera, recording.frames), strict=True):
        if frame.inertial is None or found is None:
            continue
        turn, samples = rotations.log(found.step.R), frame.inertial
        if np.linalg.norm(turn) > _TURNING:
            rates = samples.angular_rates @ rotations.matrix(samples.unit.orientation).T
            by_gyro = np.diff(samples.times, prepend=0.0) @ rates
            ratios.append(float(by_gyro @ turn / (turn @ turn)))
    if len(ratios) >= _TURNS and _AS_DEGREES[0] < (ratio := float(np.median(ratios))) < _AS_DEGREES[1]:
        raise ValueError(
            f"{recording.name}: the gyro turns {ratio:.1f} times as far as the images: are its rates in degrees per "
            "second? rad/s are expected"
        )
