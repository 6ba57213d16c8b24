"""`RecordConsistency`: consistency (NEES and NIS) of the filter in the loop."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np

from filters.validation import FloatArray, whole_number
from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper

PARTS = ("position", "rotation", "pose")


@dataclass(frozen=True)
class EpisodeConsistency:
    """Consistency over the `steps` frames of an episode after the first one.

    `anees_*` are the mean NEES over them: 3, 3 and 6 where the filter is consistent; `pose_band` is the 95 % band of
    `anees_pose` for independent frames. `nis_ratio`, the sum of the NIS over that of its degrees of freedom, is then 1;
    0 without updates.
    """

    steps: int
    anees_position: float
    anees_rotation: float
    anees_pose: float
    pose_band: tuple[float, float]
    nis_ratio: float


class RecordConsistency(RecordedWrapper):
    """Compares the belief of `BeliefObservation` with the truth; observation and reward are left alone.

    `info` gains, from `reset` and every `step`:

    - `consistency_nees_position`, `_rotation`, `_pose`: NEES of the frame, chi-square with 3, 3 and 6 degrees of
      freedom if consistent (infinite without a sound covariance);
    - `consistency_anees`: mean pose NEES of the last `window` frames, between `consistency_low` and
      `consistency_high` with 95 % if consistent *and* frames were independent: errors last for many frames, so a
      consistent filter leaves this band more often. The first frame, of the known start, does not count;
    - `consistency_nis` and `consistency_nis_dof` of the frame, and `consistency_nis_ratio`, their sums over the same
      frames divided.

    At reset the means are 0.

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
        super().__init__(env)
        for name, value in (("window", window), ("buffer_length", buffer_length)):
            if value is not None:
                whole_number(name, value, 1)
        self.inner("slam")
        self.episodes: deque[EpisodeConsistency] = deque(maxlen=buffer_length)
        self._recent: deque[FloatArray] = deque(maxlen=window or 0)
        self._windowed = window is not None
        self._start_again()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._start_again()
        return observation, {**info, **self._figures(self._frame())}

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and compare the new belief with the truth."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        frame = self._frame()
        self._recent.append(frame)
        self._total += frame
        self._count += 1
        if terminated or truncated:
            means = _means(self._total, self._count)
            self.episodes.append(EpisodeConsistency(self._count, *means[:3], _band(self._count), means[3]))
        return observation, reward, terminated, truncated, {**info, **self._figures(frame)}

    def _start_again(self) -> None:
        self._recent.clear()
        self._total, self._count = np.zeros(5), 0

    def _frame(self) -> FloatArray:
        """NEES of position, rotation and pose, NIS and its degrees of freedom: of the current frame, (5,)."""
        belief = self.inner("belief")
        return np.append(belief.nees(self.inner("frame").truth), [belief.report.nis, belief.report.nis_dof])

    def _figures(self, frame: FloatArray) -> dict[str, Any]:
        """The keys of `info`."""
        total, count = self._total, self._count
        if self._windowed:
            total, count = np.array(self._recent).reshape(-1, 5).sum(axis=0), len(self._recent)
        means, (low, high) = _means(total, count), _band(count)
        *by_part, nis, dof = frame
        figures: dict[str, Any] = {
            f"consistency_nees_{part}": value for part, value in zip(PARTS, by_part, strict=True)
        }
        figures |= {"consistency_anees": means[2], "consistency_low": low, "consistency_high": high}
        figures |= {"consistency_nis": nis, "consistency_nis_ratio": means[3]}
        return {name: np.float64(value) for name, value in figures.items()} | {"consistency_nis_dof": np.int64(dof)}


def _means(total: FloatArray, count: int) -> tuple[float, float, float, float]:
    """Mean NEES of position, rotation and pose, and the NIS ratio; 0 without frames or updates."""
    position, rotation, pose = (total[:3] / max(count, 1)).tolist()
    return position, rotation, pose, float(total[3] / total[4]) if total[4] else 0.0


@cache
def _band(count: int) -> tuple[float, float]:
    """95 % band of the mean pose NEES of so many frames."""
    return mean_band(6, count) if count else (0.0, 0.0)
