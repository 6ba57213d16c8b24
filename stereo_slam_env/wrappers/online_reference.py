"""The reference belief of the episode that is going on."""

from __future__ import annotations

from collections import deque

import numpy as np

from filters.motion import ConstantVelocity
from filters.validation import BoolArray, IntArray
from stereo_slam_env.evaluation.cramer_rao import ReferenceBelief
from stereo_slam_env.recording.recording import Frame, LandmarkTruth
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper


class OnlineReference:
    """A `ReferenceBelief` fed with the frames of an environment; landmarks leave it by age.

    Parameters
    ----------
    env : RecordedWrapper
        Just reset.
    max_age : int or None
        Frames without a sighting after which a landmark leaves; None: never.
    use_odometry : bool
        Whether it is given the odometry.
    """

    def __init__(self, env: RecordedWrapper, max_age: int | None, use_odometry: bool) -> None:
        self._env, self._use_odometry = env, use_odometry
        self._recent: deque[IntArray] | None = None if max_age is None else deque(maxlen=max_age + 1)
        frame: Frame = env.inner("frame")
        assert frame.truth is not None
        self._timestamp = frame.timestamp
        self.belief = ReferenceBelief(
            env.inner("camera"), env.inner("noise"), ConstantVelocity(), env.inner("start"), frame.truth
        )
        self._see(frame)

    def go_on(self) -> None:
        """Use the current frame of the environment."""
        frame: Frame = self._env.inner("frame")
        assert frame.truth is not None
        self.belief.predict(
            frame.truth, frame.timestamp - self._timestamp, frame.odometry if self._use_odometry else None
        )
        self._timestamp = frame.timestamp
        self._see(frame)

    def _see(self, frame: Frame) -> None:
        seen, truth = frame.observation, self._env.inner("landmark_truth")()
        place, known = _places(seen.ids, truth)
        if not known.all():  # what is on nothing has no true position
            seen, place = seen.select(known), place[known]
        self.belief.see(seen, truth.positions[place])
        if self._recent is not None:
            self._recent.append(seen.ids)
            self.belief.keep(np.concatenate(self._recent))


def _places(ids: IntArray, truth: LandmarkTruth) -> tuple[IntArray, BoolArray]:
    """Where the landmarks are in the true map, and which of them are there."""
    if len(truth.ids) == 0:
        return np.zeros(len(ids), dtype=np.int64), np.zeros(len(ids), dtype=bool)
    place = np.minimum(np.searchsorted(truth.ids, ids), len(truth.ids) - 1)
    return place, truth.ids[place] == ids
