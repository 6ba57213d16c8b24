"""Active search as in the paper: one filter's own forecast says where to look in the images."""

from __future__ import annotations

from collections.abc import Iterator

from filters.interface import StereoFilter, StereoObservation
from stereo_slam_env.frontend.recorder import Watch
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.frontend.tracker import StereoTracker
from stereo_slam_env.recording.recording import ImageSequence, StereoPair


class ActiveSearch:
    """Measures for one run of one filter: the images, and a front end that the filter guides.

    Two filters get different measurements this way; for identical ones see `frontend.recorder`.

    Parameters
    ----------
    sequence : ImageSequence
        The images.
    settings : TrackerSettings, optional
        Of the front end.
    watch : callable, optional
        Called with each pair and what was found in it.
    """

    def __init__(
        self, sequence: ImageSequence, settings: TrackerSettings | None = None, watch: Watch | None = None
    ) -> None:
        self._sequence = sequence
        self._settings = TrackerSettings() if settings is None else settings
        self._tracker = StereoTracker(sequence.camera, self._settings)
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
