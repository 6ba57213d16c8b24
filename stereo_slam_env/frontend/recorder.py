"""Measurements from image sequences: recorded once for every filter, or by active search of one."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np

from filters import ColouredNoise, LandmarkDrift, Start, StereoCamera, StereoFilter, StereoObservation
from filters.geometry import rotations
from stereo_slam_env.frontend.camera_motion import require_gyro_units
from stereo_slam_env.frontend.ego_motion import Pairs, Step, robust_step
from stereo_slam_env.frontend.front_ends import make_front_end
from stereo_slam_env.frontend.settings import DRIFT_SHARE, TrackerSettings, settings_for
from stereo_slam_env.frontend.track_noise import with_measured_noise
from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.recording import Frame, ImageSequence, Recording, StereoPair

TYPICAL_NOISE = ColouredNoise(np.diag([0.09, 0.09, 0.09]), drift=LandmarkDrift(share=DRIFT_SHARE))
"""What a filter is told beforehand; every measurement then comes with a covariance of its own."""

Watch = Callable[[StereoPair, TrackedPair], None]
_START_SIGMAS = np.repeat([1e-6, 1e-6, 0.5, 0.05], 3)
"""Of position, rotation, linear and angular velocity at the start: m, rad, m/s, rad/s."""


def record_tracks(
    sequence: ImageSequence,
    settings: TrackerSettings | None = None,
    *,
    frames: int | None = None,
    watch: Watch | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Follow landmarks through a sequence without a filter.

    Parameters
    ----------
    sequence : ImageSequence
        The images.
    settings : TrackerSettings, optional
        Of the front end. None: `settings_for` the sequence, so that rendered images bring what their renderer says of
        its blur and noise.
    frames : int, optional
        Stop after so many pairs.
    watch : callable, optional
        Called with each pair and what was found in it.
    progress : callable, optional
        Called with (pairs done, pairs) after each.

    Returns
    -------
    Recording
        With the truth and odometry of the sequence, and with what the tracks say of their noise.

    Raises
    ------
    ValueError
        No landmark was found in any pair.
    """
    settings = settings_for(sequence) if settings is None else settings
    tracker = make_front_end(sequence.camera, settings)
    taken: list[Frame] = []
    wanted = len(sequence) if frames is None else min(frames, len(sequence))
    start = sequence.start
    for number, pair in enumerate(islice(sequence.pairs(), wanted)):
        dt = pair.timestamp - taken[-1].timestamp if taken else None
        tracked = tracker.track(pair.left, pair.right, dt)
        if watch is not None:
            watch(pair, tracked)
        if number == 1 and start.covariance is None:
            moved = getattr(tracker, "last_step", None) or _step_between(sequence.camera, taken[0], tracked, dt)
            start = start if moved is None else _moving_start(start, *moved)
        taken.append(Frame(pair.timestamp, tracked.observation, pair.odometry, pair.truth, inertial=pair.inertial))
        if progress is not None:
            progress(number + 1, wanted)
    if not any(len(frame.observation) for frame in taken):
        raise ValueError(
            f"{sequence.name} shows no landmark in any of its {len(taken)} pairs: are the images dark, blurred or "
            "wrongly rectified?"
        )
    recording = Recording(
        sequence.name,
        sequence.camera,
        tuple(taken),
        TYPICAL_NOISE,
        start,
        source={
            **sequence.source,
            "front_end": dataclasses.asdict(settings),
            **({"skipped": dict(sequence.skipped)} if sequence.skipped else {}),
        },
        truth_from=sequence.truth_from,
    )
    require_gyro_units(recording)
    return with_measured_noise(recording)


def _step_between(
    camera: StereoCamera, before: Frame, tracked: TrackedPair, dt: float | None
) -> tuple[Step, float] | None:
    """Motion of the camera from a frame to a pair by the landmarks of both, and the time between them, s."""
    seen = before.observation
    _, i, j = np.intersect1d(seen.ids, tracked.ids, assume_unique=True, return_indices=True)
    if dt is None or seen.R is None:
        return None
    found = robust_step(camera, Pairs(seen.uvd[i], tracked.uvd[j], seen.R[i], tracked.R[j]), None)
    return None if found is None else (found.step, dt)


def _moving_start(start: Start, step: Step, dt: float) -> Start:
    """The start with the velocity that the first two pairs show; a filter from rest would have to guess 10 m/s."""
    R_wc = rotations.matrix(start.orientation)
    return dataclasses.replace(
        start,
        linear_velocity=R_wc @ step.t / dt,
        angular_velocity=rotations.log(step.R) / dt,
        covariance=np.diag(_START_SIGMAS**2),
    )


class ActiveSearch:
    """Measures for one run of one filter: the images, and a front end that the filter guides.

    Two filters get different measurements this way; for identical ones see `frontend.recorder`.

    Parameters
    ----------
    sequence : ImageSequence
        The images.
    settings : TrackerSettings, optional
        Of the front end. None: `settings_for` the sequence, so that rendered images bring what their renderer says of
        its blur and noise.
    watch : callable, optional
        Called with each pair and what was found in it.
    """

    def __init__(
        self, sequence: ImageSequence, settings: TrackerSettings | None = None, watch: Watch | None = None
    ) -> None:
        self._sequence = sequence
        self._settings = settings_for(sequence) if settings is None else settings
        self._tracker = make_front_end(sequence.camera, self._settings)
        self._pairs: Iterator[StereoPair] = iter(())
        self._ahead: StereoPair | None = None  # taken from the sequence, but not yet searched
        self._number = -1
        self._time = 0.0
        self._watch = watch

    def observe(self, number: int, estimator: StereoFilter) -> StereoObservation:
        """Search pair `number` where `estimator`, already predicted, expects its landmarks; 0 starts again.

        Raises
        ------
        ValueError
            `number` does not follow the last one, the sequence has ended, or the filter's forecast is refused; the
            same number may be asked for again.
        """
        if number == 0:
            self._tracker.reset()
            self._pairs, self._ahead, self._number = self._sequence.pairs(), None, -1
        if number != self._number + 1:
            raise ValueError(f"number must be 0 or {self._number + 1}, the next pair, got {number}")
        pair = self._ahead = next(self._pairs, None) if self._ahead is None else self._ahead
        if pair is None:
            raise ValueError(f"number must be less than {number}: the sequence has no more pairs")
        forecast = estimator.forecast() if number else None
        dt = pair.timestamp - self._time if number else None
        tracked = self._tracker.track(pair.left, pair.right, dt, forecast)
        self._ahead, self._number, self._time = None, number, pair.timestamp
        if self._watch is not None:
            self._watch(pair, tracked)
        return tracked.observation
