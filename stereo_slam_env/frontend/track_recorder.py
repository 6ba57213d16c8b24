"""Measurements of the front end: recorded from image sequences, by active search of a filter, or in an environment."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np

from filters import ColouredNoise, LandmarkDrift, Pose, StereoCamera, StereoFilter, StereoObservation
from filters.contract.stereo_filter import LONGEST_STEP
from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.frontend.camera_motion import require_gyro_units, with_moving_start
from stereo_slam_env.frontend.ego_motion import Step
from stereo_slam_env.frontend.front_ends import FrontEnd, make_front_end
from stereo_slam_env.frontend.settings import DRIFT_SHARE, TrackerSettings, settings_for
from stereo_slam_env.frontend.track_noise import with_measured_noise
from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.recording import Frame, ImageSequence, LandmarkTruth, Recording, StereoPair
from stereo_slam_env.rendering.pinhole import StereoImages, grey, points_at
from stereo_slam_env.simulator.state import Kept
from stereo_slam_env.world.routes import FRAME_PERIOD

TYPICAL_NOISE = ColouredNoise(np.diag([0.09, 0.09, 0.09]), drift=LandmarkDrift(share=DRIFT_SHARE))
"""What a filter is told beforehand; every measurement then comes with a covariance of its own."""

Watch = Callable[[StereoPair, TrackedPair], None]


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
    frames_wanted = len(sequence) if frames is None else min(frames, len(sequence))
    first_step: Step | None = None
    for number, pair in enumerate(islice(sequence.pairs(), frames_wanted)):
        dt = pair.timestamp - taken[-1].timestamp if taken else None
        if dt is not None and dt > LONGEST_STEP:
            message = f"pair {number} comes {dt:.6g} s after the one before, more than {LONGEST_STEP:g} s"
            raise ValueError(
                f"{sequence.name}: {message}: the clock jumps, so read the part before or the one after it"
            )
        tracked = tracker.track(pair.left, pair.right, dt)
        if watch is not None:
            watch(pair, tracked)
        if number == 1 and (followed := getattr(tracker, "last_step", None)) is not None:
            first_step = followed[0]
        taken.append(Frame(pair.timestamp, tracked.observation, pair.odometry, pair.truth, inertial=pair.inertial))
        if progress is not None:
            progress(number + 1, frames_wanted)
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
        sequence.start,
        source={
            **sequence.source,
            "front_end": dataclasses.asdict(settings),
            **({"skipped": dict(sequence.skipped)} if sequence.skipped else {}),
        },
        truth_from=sequence.truth_from,
    )
    require_gyro_units(recording)
    return with_measured_noise(with_moving_start(recording, first_step), settings.disparity_offset_sigma)


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


class ImageSensor(Kept):
    """Measures landmarks in the pairs that `take_pair` renders; what `moves` (points of W (N, 3) -> (N,)) is none."""

    changes = ("_tracker", "_ids", "_points", "_moving_ids", "_seen", "tracked")

    def __init__(
        self,
        camera: StereoCamera,
        take_pair: Callable[[], StereoImages],
        front_end: FrontEnd,
        moves: Callable[[FloatArray], BoolArray] | None = None,
    ) -> None:
        self.camera = camera
        self._take_pair, self._moves = take_pair, moves
        self._tracker = front_end
        self._ids: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        self._points: list[FloatArray] = [np.zeros((0, 3))]
        self._moving_ids: list[IntArray] = [np.zeros(0, dtype=np.int64)]
        self._seen = np.zeros(0, dtype=np.int64)
        self.tracked: TrackedPair | None = None
        """Result of the front end in the last pair."""

    def observe(self, pose: Pose) -> StereoObservation:
        """Follow the landmarks to the pair taken now, from `pose`, one frame after the previous one."""
        images = self._take_pair()
        self.tracked = self._tracker.track(grey(images.left), grey(images.right), FRAME_PERIOD)
        corners = self.tracked.corners
        if corners is None:  # of those that are new to it
            observation = self.tracked.observation
            fresh = ~np.isin(observation.ids, self._seen)
            self._seen = np.union1d(self._seen, observation.ids)
            corners = StereoObservation(observation.ids[fresh], observation.uvd[fresh])
        points_w = points_at(self.camera, pose, images.depth, corners.uvd[:, :2])
        in_map = np.isfinite(points_w).all(axis=1)
        if self._moves is not None:
            moving = self._moves(points_w)
            self._moving_ids.append(corners.ids[moving])
            in_map &= ~moving
        self._ids.append(corners.ids[in_map])
        self._points.append(points_w[in_map])
        return self.tracked.observation

    @property
    def moving_ids(self) -> IntArray:
        """Corners found so far that are truly on moving bodies; ascending."""
        return np.concatenate(self._moving_ids)

    @property
    def landmarks(self) -> LandmarkTruth:
        """True positions of the corners found so far, as far as the render tells: not at the edges of things."""
        ids, points = np.concatenate(self._ids), np.concatenate(self._points)
        order = np.argsort(ids, kind="stable")
        return LandmarkTruth(ids[order], points[order])
