"""`BeliefObservation`: a filter runs along, and what it believes is part of the observation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.interface import StereoFilter, UpdateReport
from stereo_slam_env.sensing.padding import NO_LANDMARK
from stereo_slam_env.wrappers.belief import Belief, FilterInTheLoop, assumed_noise
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper, dict_space

FARTHEST = 1e4
"""Bound of positions, m."""
LARGEST_COVARIANCE = 1e6
"""Bound of entries of covariances, m^2, m rad and rad^2."""


class BeliefObservation(RecordedWrapper):
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
        pixels), or R (3 x 3) of (u, v, d). None: what the sensor says of itself.
    options : mapping, optional
        Options of the filter, JSON-able, as in scenario files: {"drop_unseen": False, "motion": {...}}.

    Raises
    ------
    ValueError
        An argument is unknown or impossible, or the environment offers no frames.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        filter: str = "shared-anchor",
        max_landmarks: int = 64,
        use_odometry: bool = True,
        noise: float | list[list[float]] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(
            env,
            filter=filter,
            max_landmarks=max_landmarks,
            use_odometry=use_odometry,
            noise=noise,
            options=options,
        )
        if type(max_landmarks) is not int or max_landmarks < 1:
            raise ValueError(f"max_landmarks must be an integer >= 1, got {max_landmarks!r}")
        self._rows = max_landmarks
        self._loop = FilterInTheLoop(
            filter, self.inner("camera"), assumed_noise(noise, self.inner("noise")), dict(options or {}), use_odometry
        )
        self._belief: Belief | None = None
        bounds: dict[str, tuple[float, tuple[int, ...]]] = {
            "belief_position": (FARTHEST, (3,)),
            "belief_orientation": (1.0, (4,)),
            "belief_covariance": (LARGEST_COVARIANCE, (6, 6)),
            "belief_landmarks": (FARTHEST, (max_landmarks, 3)),
            "belief_landmark_covariances": (LARGEST_COVARIANCE, (max_landmarks, 3, 3)),
        }
        self._bounds = {key: bound for key, (bound, _) in bounds.items()}
        added: dict[str, spaces.Space[Any]] = {
            key: spaces.Box(-bound, bound, shape, np.float32) for key, (bound, shape) in bounds.items()
        }
        added["belief_landmark_ids"] = spaces.Box(NO_LANDMARK, np.iinfo(np.int32).max, (max_landmarks,), np.int64)
        added["belief_mask"] = spaces.MultiBinary(max_landmarks)
        self.observation_space = spaces.Dict({**dict_space(env, "BeliefObservation").spaces, **added})

    @property
    def slam(self) -> StereoFilter:
        """The filter, after the current frame."""
        return self._loop.slam

    @property
    def belief(self) -> Belief:
        """What it believes after the current frame."""
        if self._belief is None:
            raise RuntimeError("there is no belief yet: reset the environment first")
        return self._belief

    @property
    def report(self) -> UpdateReport:
        """What the filter did with the measurements of the current frame."""
        return self.belief.report

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, and start the filter."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._belief = self._loop.start(self.inner("start"), self.inner("frame"))
        return self._with_belief(observation), self._told(info)

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        """Step the environment, and let the filter use the new frame."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._belief = self._loop.go_on(self.inner("frame"))
        return self._with_belief(observation), reward, terminated, truncated, self._told(info)

    def _told(self, info: dict[str, Any]) -> dict[str, Any]:
        belief = self.belief
        told = {"belief_nis": belief.report.nis, "belief_nis_dof": belief.report.nis_dof}
        return {**info, **told, "belief_map_size": belief.map_size}

    def _with_belief(self, observation: dict[str, Any]) -> dict[str, Any]:
        belief, rows = self.belief, self._rows
        shown = belief.nearest(rows)
        count = len(shown)
        landmarks, covariances = np.zeros((rows, 3)), np.zeros((rows, 3, 3))
        ids, mask = np.full(rows, NO_LANDMARK, dtype=np.int64), np.zeros(rows, dtype=np.int8)
        ids[:count], mask[:count], landmarks[:count] = belief.ids[shown], 1, belief.points_c[shown]
        whole = count == len(belief)
        covariances[:count] = belief.relative_covariances if whole else belief.relative_covariances_of(shown)
        values = {
            "belief_position": belief.pose.position,
            "belief_orientation": belief.pose.orientation,
            "belief_covariance": belief.pose.covariance,
            "belief_landmarks": landmarks,
            "belief_landmark_covariances": covariances,
        }
        added = {
            key: value.clip(-self._bounds[key], self._bounds[key]).astype(np.float32) for key, value in values.items()
        }
        return {**observation, **added, "belief_landmark_ids": ids, "belief_mask": mask}
