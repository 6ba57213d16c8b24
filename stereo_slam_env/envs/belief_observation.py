"""`BeliefObservation`: a filter runs along, and its belief is part of the observation."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from filters.catalogue.registry import make_filter
from filters.contract.noise import StereoNoise
from filters.contract.outputs import UpdateReport
from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import positive, whole_number
from filters.engine.batch import RelativeLandmarks
from filters.geometry.arrays import BoolArray
from stereo_slam_env.envs.filter_rows import Belief, filter_rows
from stereo_slam_env.envs.row_wrapper import RowsWrapper
from stereo_slam_env.envs.rows import Arrays, Seeds, Step
from stereo_slam_env.sensing.padding import NO_LANDMARK

FARTHEST = 1e4
"""Bound of positions, m."""
LARGEST_COVARIANCE = 1e6
"""Bound of entries of covariances, m^2, m rad and rad^2."""


class BeliefObservation(RowsWrapper):
    """Runs a filter on the frames of the environment, and adds its belief to the observation.

    At every reset the filter is started from `start` of the environment. It sees `frame`, in full precision, not the
    float32 observation. Added keys, float32 unless said; **values beyond the bounds are clipped to them**:

    | Key | Shape | Bounds | Meaning |
    |-----|-------|--------|---------|
    | `belief_position` | (3,) | 1e4 | left camera in W, m |
    | `belief_orientation` | (4,) | 1 | quaternion xyzw, camera to W |
    | `belief_covariance` | (6, 6) | 1e6 | of position (W, m) and rotation (camera frame, rad) |
    | `belief_landmark_ids` | (M,) int64 | | ascending; -1 in padding |
    | `belief_landmarks` | (M, 3) | 1e4 | positions in the **camera frame** (x right, y down, z forward), m |
    | `belief_landmark_covariances` | (M, 3, 3) | 1e6 | of those, m^2: errors of the pose count, with correlations |
    | `belief_mask` | (M,) int8 | | 1 where there is a landmark |

    Of more than M landmarks those nearest to the camera are shown. Landmarks without a finite position in front of
    where they were first seen are left out. `info` gains `belief_nis` and `belief_nis_dof` of the frame, and
    `belief_map_size`, the number of all landmarks in the map.

    A filter that raises, or whose pose is not finite, ends the episode with a RuntimeError from `reset` or `step` that
    names the filter, the frame and the cause; after `reset` it goes on.

    Parameters
    ----------
    env : gymnasium.Env
        With a Dict observation, and `camera`, `noise`, `start` and `frame`.
    filter : str
        A name of `filters.available_filters()`.
    max_landmarks : int
        M.
    use_odometry : bool
        Whether the filter is given the odometry.
    noise : float or nested list, optional
        Noise to assume of measurements that come without a covariance: a standard deviation in px (independent
        pixels), or R (3 x 3) of (u, v, d). None: the noise of the sensor.
    options : mapping, optional
        Options of the filter, JSON-able, as in scenario files: {"drop_unseen": False, "motion": {...}}.
    hold : int
        Frames for which an action holds. The filter uses all of them, the belief is read after the last one, and the
        reward is the sum; `info` is that of the last one.

    Raises
    ------
    ValueError
        An argument is unknown or impossible, or the environment offers no frames.
    """

    changes = ("beliefs",)
    shared = ("beliefs", "slam", "belief", "report")

    def __init__(
        self,
        env: Any,
        filter: str = "shared-anchor",
        max_landmarks: int = 64,
        use_odometry: bool = True,
        noise: float | list[list[float]] | None = None,
        options: Mapping[str, Any] | None = None,
        hold: int = 1,
    ) -> None:
        super().__init__(env)
        self._hold, self._most = whole_number("hold", hold, 1), whole_number("max_landmarks", max_landmarks, 1)
        camera, assumed = self.needed("camera"), assumed_noise(noise, self.needed("noise"))
        filter_options = dict(options or {})
        self.beliefs = filter_rows(
            lambda: make_filter(filter, camera=camera, noise=assumed, **filter_options),
            filter,
            self.num_envs,
            int(getattr(env.world, "threads", 1)),
            use_odometry=bool(use_odometry),
        )
        """The filters and their beliefs."""
        most = self._most
        bounds: dict[str, tuple[float, tuple[int, ...]]] = {
            "belief_position": (FARTHEST, (3,)),
            "belief_orientation": (1.0, (4,)),
            "belief_covariance": (LARGEST_COVARIANCE, (6, 6)),
            "belief_landmarks": (FARTHEST, (most, 3)),
            "belief_landmark_covariances": (LARGEST_COVARIANCE, (most, 3, 3)),
        }
        self._bounds = {key: bound for key, (bound, _) in bounds.items()}
        added: dict[str, spaces.Space[Any]] = {
            key: spaces.Box(-bound, bound, shape, np.float32) for key, (bound, shape) in bounds.items()
        }
        added["belief_landmark_ids"] = spaces.Box(NO_LANDMARK, np.iinfo(np.int32).max, (most,), np.int64)
        added["belief_mask"] = spaces.Box(0, 1, (most,), np.int8)
        self.observation_space = spaces.Dict({**self.dict_space(), **added})
        self._map_shown = True

    def select_keys(self, keys: Collection[str]) -> None:
        self._map_shown = any(key.startswith(("belief_landmark", "belief_mask")) for key in keys)
        self.rows.select_keys(keys)

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        self.rows.reset(chosen, seeds, options)
        self.beliefs.use_frames(self.world, chosen, chosen)

    def step(self, actions: Any, going: BoolArray) -> Step:
        nobody = np.zeros(self.num_envs, dtype=np.bool_)
        total, terminated, truncated, still = np.zeros(self.num_envs), nobody, nobody, going
        for _ in range(self._hold):
            rewards, ended, late = self.rows.step(actions, still)
            total, terminated, truncated = total + rewards, terminated | ended, truncated | late
            self.beliefs.use_frames(self.world, still, nobody)
            still = still & ~(ended | late)
            if not still.any():
                break
        return total, terminated, truncated

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = self.rows.observe()
        beliefs = self.beliefs
        poses = beliefs.poses
        values: Arrays = {
            "belief_position": poses[:, :3],
            "belief_orientation": poses[:, 3:],
            "belief_covariance": beliefs.pose_covariances,
        }
        if self._map_shown:
            values |= _nearest(beliefs.maps, self.num_envs, self._most)
        for key, bound in self._bounds.items():
            if key in values:
                values[key] = np.clip(values[key], -bound, bound).astype(np.float32)
        added = {"belief_nis": beliefs.nis.copy(), "belief_nis_dof": beliefs.nis_dof.copy()}
        return {**observation, **values}, {**info, **added, "belief_map_size": beliefs.map_sizes}

    @property
    def slam(self) -> StereoFilter:
        """The filter of one environment, after the current frame."""
        slam: StereoFilter = self.beliefs.filters[self.only_row("slam")]
        return slam

    @property
    def belief(self) -> Belief:
        """Belief of that filter after the current frame."""
        return self.beliefs.belief(self.only_row("belief"))

    @property
    def report(self) -> UpdateReport:
        """Report of its update with the current frame."""
        return self.beliefs.report(self.only_row("report"))


def assumed_noise(given: Any, noise_of_sensor: StereoNoise) -> StereoNoise:
    """Noise that a filter assumes: None for the sensor's own, a standard deviation in px, or R as nested lists."""
    if given is None:
        return noise_of_sensor
    if np.ndim(given) == 0:
        return StereoNoise.independent_pixels(positive("noise", given))
    return StereoNoise(given)


def _nearest(maps: RelativeLandmarks, count: int, rows: int) -> Arrays:
    """The landmarks of each map that are nearest to the camera, in the order of their ids, padded."""
    owner = np.repeat(np.arange(count), np.diff(maps.offsets))
    index = np.flatnonzero(maps.located)
    squares = np.einsum("ni,ni->n", maps.points_c[index], maps.points_c[index])
    order = index[np.lexsort((squares, owner[index]))]
    rank = np.arange(len(order)) - np.searchsorted(owner[order], np.arange(count))[owner[order]]
    row_order = np.sort(order[rank < rows])
    b = owner[row_order]
    column = np.arange(len(row_order)) - np.searchsorted(b, np.arange(count))[b]
    arrays: Arrays = {
        "belief_landmarks": np.zeros((count, rows, 3)),
        "belief_landmark_covariances": np.zeros((count, rows, 3, 3)),
        "belief_landmark_ids": np.full((count, rows), NO_LANDMARK),
        "belief_mask": np.zeros((count, rows), dtype=np.int8),
    }
    arrays["belief_landmark_ids"][b, column] = maps.ids[row_order]
    arrays["belief_landmarks"][b, column] = maps.points_c[row_order]
    arrays["belief_landmark_covariances"][b, column] = maps.covariances[row_order]
    arrays["belief_mask"][b, column] = 1
    return arrays
