"""`RecordConsistency`: consistency (NEES and NIS) of the filter in the loop."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import gymnasium as gym
import numpy as np

from filters.contract.validation import whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rows import Arrays, Rows, RowsWrapper, Seeds, Step
from stereo_slam_env.evaluation.consistency import mean_band
from stereo_slam_env.wrappers.filter_rows import FilterRows
from stereo_slam_env.wrappers.recorded_wrapper import RowWrapper

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


class RecordConsistencyRows(RowsWrapper):
    """What `RecordConsistency` does, on rows; see there."""

    changes = ("episodes", "_recent", "_total", "_count", "_now")

    def __init__(self, rows: Rows, window: int | None, buffer_length: int) -> None:
        super().__init__(rows)
        for name, value in (("window", window), ("buffer_length", buffer_length)):
            if value is not None:
                whole_number(name, value, 1)
        self._beliefs: FilterRows = self.needed("beliefs")
        self.episodes: deque[EpisodeConsistency] = deque(maxlen=buffer_length)
        self._recent: list[deque[FloatArray]] = [deque(maxlen=window or 0) for _ in range(rows.count)]
        self._windowed = window is not None
        self._total, self._count = np.zeros((rows.count, 5)), np.zeros(rows.count, dtype=np.int64)
        self._now = np.zeros((rows.count, 5))
        """NEES of position, rotation and pose, NIS and its degrees of freedom, of the current frames."""

    def begin(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """See `Rows`; the means begin again."""
        self.rows.begin(chosen, seeds, options)
        self._total[chosen], self._count[chosen] = 0.0, 0
        for b in np.flatnonzero(chosen).tolist():
            self._recent[b].clear()
            self._compare(b)

    def advance(self, actions: Any, going: BoolArray) -> Step:
        """See `Rows`; compare the new beliefs with the truth."""
        rewards, terminated, truncated = self.rows.advance(actions, going)
        for b in np.flatnonzero(going).tolist():
            self._compare(b)
            self._recent[b].append(self._now[b].copy())
            self._total[b] += self._now[b]
            self._count[b] += 1
            if terminated[b] or truncated[b]:
                count = int(self._count[b])
                means = _means(self._total[b], count)
                self.episodes.append(EpisodeConsistency(count, *means[:3], _band(count), means[3]))
        return rewards, terminated, truncated

    def look(self) -> tuple[Arrays, Arrays]:
        """See `Rows`."""
        observation, info = self.rows.look()
        figures = np.array([self._figures(b) for b in range(self.count)]).T
        names = ("anees", "low", "high", "nis_ratio")
        by_part = {f"nees_{part}": values for part, values in zip(PARTS, self._now.T, strict=False)}
        told = {**by_part, **dict(zip(names, figures, strict=True)), "nis": self._now[:, 3]}
        added = {f"consistency_{name}": values.copy() for name, values in told.items()}
        return observation, {**info, **added, "consistency_nis_dof": self._now[:, 4].astype(np.int64)}

    def _compare(self, b: int) -> None:
        belief, truth = self._beliefs.belief(b), self.world.frame(b).truth
        assert truth is not None
        self._now[b] = np.append(belief.nees(truth), [belief.report.nis, belief.report.nis_dof])

    def _figures(self, b: int) -> tuple[float, float, float, float]:
        """Mean pose NEES, its band, and the NIS ratio of a row."""
        total, count = self._total[b], int(self._count[b])
        if self._windowed:
            total, count = np.array(self._recent[b]).reshape(-1, 5).sum(axis=0), len(self._recent[b])
        means = _means(total, count)
        return means[2], *_band(count), means[3]


class RecordConsistency(RowWrapper):
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
        Episodes that `episodes` keeps, of all rows of a vector together.

    Raises
    ------
    ValueError
        An argument is not positive, or there is no filter in the loop.
    """

    OnRows = RecordConsistencyRows

    def __init__(self, env: gym.Env[Any, Any], window: int | None = None, buffer_length: int = 100) -> None:
        super().__init__(env)

    @property
    def episodes(self) -> deque[EpisodeConsistency]:
        """Of the episodes that ended, latest last; over the whole episode, whatever the window."""
        episodes: deque[EpisodeConsistency] = self.rows.episodes
        return episodes


def _means(total: FloatArray, count: int) -> tuple[float, float, float, float]:
    """Mean NEES of position, rotation and pose, and the NIS ratio; 0 without frames or updates."""
    position, rotation, pose = (total[:3] / max(count, 1)).tolist()
    return position, rotation, pose, float(total[3] / total[4]) if total[4] else 0.0


@cache
def _band(count: int) -> tuple[float, float]:
    """95 % band of the mean pose NEES of so many frames."""
    return mean_band(6, count) if count else (0.0, 0.0)
