"""Motions of the camera from tracks: what they show of accelerations, odometry's errors and doubtful references.

A step of the reference carries the tracked points of a frame to where they should be in the next. So does the motion
that fits the tracks best. Where the reference puts most of them much farther from where they were seen, its step is
doubtful, however good its poses are on the whole.
"""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from filters import BodyVelocity, ConstantVelocity, StereoCamera, StereoNoise, StereoObservation
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.audits import ReferenceAudit
from stereo_slam_env.frontend.ego_motion import Pairs, Step, robust_step, transfer
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
_LONGEST_DELAY = 0.3
"""s: what is looked for."""
_DELAY, _BIAS = 0.05, 0.01
"""Standard deviations of the delay, s, and of the bias of a rate, rad/s, beforehand."""
_FEWEST = 30
"""Steps with odometry and a motion by the tracks; with fewer nothing is measured."""
_RELATED = 25.0
"""Squared distances, in all, that the best delay must explain beyond those of the others: of a straight drive it is
none."""
_OUTLIER, _BLOCK = 3.0, 10
"""Robust standard deviations at which a difference is cut off; steps over which errors of tracks last."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class CameraStep:
    """Most likely motion of the camera between two frames."""

    step: Step
    """The motion."""
    variances: FloatArray
    """(6,): of its error, m^2 and rad^2."""
    pairs: Pairs
    """Tracks of both frames."""


def camera_steps(camera: StereoCamera, frames: tuple[Frame, ...]) -> tuple[CameraStep | None, ...]:
    """Robust motion to each frame but the first from the one before; None where too few tracks agree."""
    return _steps_between(camera, tuple(frame.observation for frame in frames))


@lru_cache(maxsize=2)
def _steps_between(camera: StereoCamera, observations: tuple[StereoObservation, ...]) -> tuple[CameraStep | None, ...]:
    """Steps kept for the tracks looked at last: noise, accelerations, odometry and the audit of a reference need them.

    Their key is the tracks alone, so that another odometry or truth beside them costs no second look.
    """
    steps: list[CameraStep | None] = []
    for before, now in pairwise(observations):
        pairs = Pairs.between(before, now, FIRST_GUESS)
        last = steps[-1] if steps else None
        step_found = robust_step(camera, pairs, None if last is None else last.step)
        if step_found is None:
            steps.append(None)
        else:
            steps.append(CameraStep(step_found.step, np.diag(step_found.estimate.covariance).copy(), pairs))
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
    for (before, now), step_found in zip(pairwise(recording.frames), steps, strict=True):
        if step_found is None:
            last = None
            continue
        dt, R = now.timestamp - before.timestamp, step_found.step.R
        velocity = np.concatenate([step_found.step.t, rotations.log(R)]) / dt
        variance = _variances(recording, now, step_found) / dt**2
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

    Tracks have outliers, which the joint test over each frame finds, and accelerations that they show themselves;
    odometry may be late and have a bias, see `with_corrected_odometry`.
    """
    if recording.stated_setup is not None or recording.truth_from.kind == "simulation":
        return recording
    recording = with_corrected_odometry(recording)
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
    for frame, step_found in zip(recording.frames[1:], camera_steps(recording.camera, recording.frames), strict=True):
        if frame.inertial is None or step_found is None:
            continue
        turn, samples = rotations.log(step_found.step.R), frame.inertial
        if np.linalg.norm(turn) > _TURNING:
            rates = samples.angular_rates @ rotations.matrix(samples.unit.orientation).T
            by_gyro = np.diff(samples.times, prepend=0.0) @ rates
            ratios.append(float(by_gyro @ turn / (turn @ turn)))
    if len(ratios) >= _TURNS and _AS_DEGREES[0] < (ratio := float(np.median(ratios))) < _AS_DEGREES[1]:
        raise ValueError(
            f"{recording.name}: the gyro turns {ratio:.1f} times as far as the images: are its rates in degrees per "
            "second? rad/s are expected"
        )


@dataclass(frozen=True, eq=False)
class OdometryErrors:
    """Errors of the odometry of a recording, the most likely ones with what is usual beforehand."""

    delay: float
    """By which odometry comes late, s; negative where it comes early."""
    delay_sigma: float
    """Its standard deviation, s."""
    bias: FloatArray
    """(3,) of the rates, camera frame, rad/s."""
    bias_sigma: FloatArray
    """(3,) its standard deviations, rad/s."""

    def __str__(self) -> str:
        bias = ", ".join(f"{1e3 * b:+.1f} ± {1e3 * s:.1f}" for b, s in zip(self.bias, self.bias_sigma, strict=True))
        return f"{1e3 * self.delay:+.0f} ± {1e3 * self.delay_sigma:.0f} ms late, rates off by {bias} mrad/s"


def odometry_errors(recording: Recording) -> OdometryErrors | None:
    """Delay and bias of the odometry of a recording against its tracks; None where too little can be compared.

    The delay is that at which rates of odometry and of tracks differ least, between steps by a parabola; the bias is
    the mean difference that is left.
    """
    times, odometry, by_tracks = _velocities(recording)
    rates, turned = odometry[:, 3:], by_tracks[:, 3:]
    if np.isfinite(rates + turned).all(axis=1).sum() < _FEWEST:
        return None
    sigma = 1.4826 * np.nanmedian(np.abs(rates - turned - np.nanmedian(rates - turned, axis=0)), axis=0) + 1e-9
    frame = float(np.median(np.diff(times)))
    most = min(round(_LONGEST_DELAY / frame), len(times) // 4)
    costs = np.array([_misfit(rates, turned, sigma, frames) for frames in range(-most, most + 1)])
    delay, delay_sigma = 0.0, _DELAY
    best = 1 + int(np.argmin(costs[1:-1])) if len(costs) > 2 else 0
    around = costs[best - 1 : best + 2] if best else costs[:0]
    if len(around) and np.isfinite(around).all():
        below, at, above = around
        curvature = below - 2.0 * at + above
        if curvature > 0.0 and np.median(costs[np.isfinite(costs)]) - at > _RELATED:
            frames = best - most - 0.5 * (above - below) / curvature
            variance = 2.0 / curvature * at / (3 * len(times)) * frame**2
            share = _DELAY**2 / (_DELAY**2 + variance)
            delay, delay_sigma = share * frames * frame, float(np.sqrt(share * variance))
    rates_left = _at(times, rates, times + delay) - turned
    rates_left = rates_left[np.isfinite(rates_left).all(axis=1)]
    rates_left = rates_left[(np.abs(rates_left - np.median(rates_left, axis=0)) < 2.0 * _OUTLIER * sigma).all(axis=1)]
    blocks = np.array([block.mean(axis=0) for block in np.array_split(rates_left, max(len(rates_left) // _BLOCK, 2))])
    # Of few blocks the scatter may be small by chance: no less than that of white noise.
    variances = np.maximum(blocks.var(axis=0, ddof=1) / len(blocks), rates_left.var(axis=0) / len(rates_left))
    share = _BIAS**2 / (_BIAS**2 + variances)
    return OdometryErrors(delay, delay_sigma, share * blocks.mean(axis=0), np.sqrt(share * variances))


def with_corrected_odometry(recording: Recording) -> Recording:
    """The recording with its odometry read when it was measured, less its bias; what is unsure is in its covariance."""
    errors = odometry_errors(recording)
    if errors is None:
        return recording
    _log.info("%s: its odometry is %s", recording.name, errors)
    times, odometry, by_tracks = _velocities(recording)
    read = _at(times, odometry, times + errors.delay)
    read[:, 3:] -= errors.bias
    changes = np.diff(by_tracks, axis=0) / np.diff(times)[:, None]
    unsure = np.nanmedian(changes**2, axis=0) * errors.delay_sigma**2
    unsure[3:] += errors.bias_sigma**2
    frames = list(recording.frames)
    for k, velocity in enumerate(read, start=1):
        stated = frames[k].odometry
        if stated is not None:
            corrected = BodyVelocity(velocity[:3], velocity[3:], stated.covariance + np.diag(unsure))
            frames[k] = replace(frames[k], odometry=corrected)
    return replace(recording, frames=tuple(frames), source={**recording.source, "odometry": str(errors)})


def _velocities(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Middles of the K steps, s, and velocities over them (K, 6) by odometry and by tracks; NaN: unknown."""
    stamps = np.array([frame.timestamp for frame in recording.frames])
    odometry, by_tracks = np.full((2, max(len(stamps) - 1, 0), 6), np.nan)
    for k, (frame, step) in enumerate(
        zip(recording.frames[1:], camera_steps(recording.camera, recording.frames), strict=True)
    ):
        if frame.odometry is not None:
            odometry[k] = np.concatenate([frame.odometry.linear, frame.odometry.angular])
        if step is not None:
            moved = np.concatenate([step.step.t, rotations.log(step.step.R)])
            by_tracks[k] = moved / (stamps[k + 1] - stamps[k])
    return 0.5 * (stamps[1:] + stamps[:-1]), odometry, by_tracks


def _misfit(rates: FloatArray, turned: FloatArray, sigma: FloatArray, frames: int) -> float:
    """Squared distance of rates so many frames later from those of the tracks, as if all K were there."""
    later = np.full_like(rates, np.nan)
    if frames >= 0:
        later[: len(rates) - frames] = rates[frames:]
    else:
        later[-frames:] = rates[:frames]
    difference = later - turned
    difference = difference[np.isfinite(difference).all(axis=1)]
    if len(difference) < _FEWEST:
        return np.inf
    distances = np.minimum(((difference - np.median(difference, axis=0)) / sigma) ** 2, _OUTLIER**2)
    return float(distances.sum(axis=1).mean() * len(rates))


def _at(times: FloatArray, velocities: FloatArray, when: FloatArray) -> FloatArray:
    """Velocities at other times, linear in between; unknown ones are bridged."""
    finite = np.isfinite(velocities).all(axis=1)
    return np.column_stack([np.interp(when, times[finite], column[finite]) for column in velocities.T])


def median_residual(camera: StereoCamera, pairs: Pairs, step: Step) -> float:
    """Median distance in the left image of points from where a step carries them, px."""
    off = (pairs.second - transfer(camera, pairs.first, step).uvd)[:, :2]
    return float(np.median(np.linalg.norm(off, axis=1)))


def audit_of(recording: Recording) -> ReferenceAudit | None:
    """Hold each step of the reference against the motion of the tracks, where both are known.

    None where there is no reference, an exact one, or one that is an odometry of the same images.
    """
    reference = recording.reference
    if not reference.counts_as_truth or reference.kind == "simulation":
        return None
    rows = []
    steps = camera_steps(recording.camera, recording.frames)
    for k, ((before, now), step_found) in enumerate(zip(pairwise(recording.frames), steps, strict=True), start=1):
        if step_found is None or before.truth is None or now.truth is None:
            continue
        true = before.truth.inverse() @ now.truth
        of_both = (Step(true.R_wc, true.position), step_found.step)
        rows.append((k, *(median_residual(recording.camera, step_found.pairs, step) for step in of_both)))
    return ReferenceAudit(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)
