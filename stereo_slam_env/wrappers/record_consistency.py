"""`RecordConsistency`: whether the filter in the loop is as sure as it is right."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper

PARTS = ("position", "rotation", "pose")


@dataclass(frozen=True)
class EpisodeConsistency:
    """An episode that is over.

    Attributes
    ----------
    steps : int
        Frames after the first one.
    anees_position, anees_rotation, anees_pose : float
        Mean NEES over them; 3, 3 and 6 where the filter is consistent.
    pose_band : (float, float)
        95 % band of `anees_pose` for independent frames.
    nis_ratio : float
        Sum of the NIS over the sum of its degrees of freedom: 1 where the filter is consistent; 0 without updates.
    """

    steps: int
    anees_position: float
    anees_rotation: float
    anees_pose: float
    pose_band: tuple[float, float]
    nis_ratio: float


class RecordConsistency(RecordedWrapper):
    """Judges the filter of `BeliefObservation` by the truth; observation and reward are left alone.

    `info` gains, from `reset` and every `step`:

    - `consistency_nees_position`, `_rotation`, `_pose`: NEES of the frame, chi-square with 3, 3 and 6 degrees of
      freedom if consistent (infinite without a sound covariance);
    - `consistency_anees`: mean pose NEES of the last `window` frames, between `consistency_low` and
      `consistency_high` with 95 % if consistent *and* frames were independent: errors last for many frames, so a
      consistent filter leaves this band more often. The first frame, of the known start, does not count;
    - `consistency_nis` and `consistency_nis_dof` of the frame, and `consistency_nis_ratio`, their sums over the same
      frames divided.

    At reset the means are 0: nothing has been judged.

    Parameters
    ----------
    env : gymnasium.Env
        With `BeliefObservation` inside.
    window : int, optional
        Frames of the running means; None: the whole episode.
    buffer_length : int
        Episodes that `episodes` keeps.

    Attributes
    ----------
    episodes : deque of EpisodeConsistency
        Of the episodes that ended, latest last; over the whole episode, whatever the window.

    Raises
    ------
    ValueError
        An argument is not positive, or there is no filter in the loop.
    """

    def __init__(self, env: gym.Env[Any, Any], window: int | None = None, buffer_length: int = 100) -> None:
        super().__init__(env, window=window, buffer_length=buffer_length)
        for name, value in (("window", window), ("buffer_length", buffer_length)):
            if value is not None and (type(value) is not int or value < 1):
                raise ValueError(f"{name} must be an integer >= 1, got {value!r}")
        self.inner("slam")
        self.episodes: deque[EpisodeConsistency] = deque(maxlen=buffer_length)
        self._window = window
        self._frames = _Frames(window)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and judge the start."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._frames = _Frames(self._window)
        return observation, {**info, **self._told(self._judged())}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and judge the new belief."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        frame = self._judged()
        self._frames.add(frame)
        if terminated or truncated:
            count, means = self._frames.count, _means(self._frames.total, self._frames.count)
            self.episodes.append(EpisodeConsistency(count, *means[:3], _band(count), means[3]))
        return observation, reward, terminated, truncated, {**info, **self._told(frame)}

    def _judged(self) -> tuple[float, ...]:
        """NEES of position, rotation and pose; NIS and its degrees of freedom."""
        belief = self.inner("belief")
        position, rotation, pose = belief.nees(self.inner("frame").truth).tolist()
        return position, rotation, pose, belief.report.nis, belief.report.nis_dof

    def _told(self, frame: tuple[float, ...]) -> dict[str, Any]:
        told: dict[str, Any] = {f"consistency_nees_{part}": value for part, value in zip(PARTS, frame, strict=False)}
        total, count = self._frames.recent
        means, (low, high) = _means(total, count), _band(count)
        told |= {"consistency_anees": means[2], "consistency_low": low, "consistency_high": high}
        told |= {"consistency_nis": frame[3], "consistency_nis_dof": int(frame[4]), "consistency_nis_ratio": means[3]}
        return told


class _Frames:
    """Sums over the frames of the episode, and over the last `window` of them."""

    def __init__(self, window: int | None) -> None:
        self.total, self.count = np.zeros(5), 0
        self._last: deque[tuple[float, ...]] | None = None if window is None else deque(maxlen=window)

    def add(self, frame: tuple[float, ...]) -> None:
        """One more frame."""
        self.total += frame
        self.count += 1
        if self._last is not None:
            self._last.append(frame)

    @property
    def recent(self) -> tuple[FloatArray, int]:
        """Sums over the window, and the number of frames in it."""
        if self._last is None:
            return self.total, self.count
        return np.array(self._last).reshape(-1, 5).sum(axis=0), len(self._last)


def _means(total: FloatArray, count: int) -> tuple[float, float, float, float]:
    """Mean NEES of position, rotation and pose, and the NIS ratio; 0 where there is nothing to take it of."""
    position, rotation, pose = (total[:3] / max(count, 1)).tolist()
    return position, rotation, pose, float(total[3] / total[4]) if total[4] else 0.0


@cache
def _band(count: int) -> tuple[float, float]:
    """95 % band of the mean pose NEES of so many frames."""
    return mean_band(6, count) if count else (0.0, 0.0)
