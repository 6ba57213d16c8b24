"""`StereoSlam/Explore-v0`: drive and look until the map is complete enough."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from filters.contract.validation import positive
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.closed_loop import DriveChoices, RouteByEstimate, follow_route
from stereo_slam_env.envs.filter_rows import FilterRows
from stereo_slam_env.envs.row_wrapper import PaidRows
from stereo_slam_env.envs.rows import Arrays, Seeds, Step
from stereo_slam_env.envs.task_env import TaskEnv, Wrappers

STOP = 2
"""Entry of the action: above `_STOP_ABOVE` the agent ends the episode."""
_STOP_ABOVE = 0.5
_SINCERE = 3.0
"""Standard deviations: an estimate that is farther off than that is not on the map, whatever the filter claims."""
_FAST, _PAN, _FRONT, _CLEAR = 8.0, 0.35, 1.6, 0.02
"""Of `explore_by_looking`: speed, m/s; how far it looks aside, as a share of the farthest; the sectors compared, rad
from straight ahead; and how large a difference has to be."""


class Coverage(PaidRows):
    """Pays for landmarks that enter the map, and lets the agent stop.

    The landmarks to be mapped are those of the scene no farther from the route than the sensor sees. One is *mapped*
    once the filter knows its position in W with a standard deviation (root of the trace of the covariance) below
    `accuracy`, and the estimate is within three times that of the true position; it then stays mapped. So neither a map
    that is claimed nor a map that is forgotten pays.

    The action has one more entry, number 2: above 0.5 it ends the episode. The observation gains `coverage` (1,), the
    share that the filter claims to have mapped, 0 to 1: landmarks that it knows that well, where it believes them to be
    so near the route. `info` gains `coverage`, the true share, `path_length` (m), `reward_coverage` and `reward_path`;
    `is_success` is whether that has reached `goal` without a collision, and without leaving the lane.

    Parameters
    ----------
    env : gymnasium.Env
        `StereoSlam/DriveGaze-v0` with `BeliefObservation` around it.
    accuracy : float
        m.
    goal : float
        Share of the landmarks, above 0.
    coverage_weight : float
        Paid for the whole map.
    path_weight : float
        Price of each metre.
    """

    def __init__(
        self,
        env: Any,
        accuracy: float = 0.8,
        goal: float = 0.5,
        coverage_weight: float = 20.0,
        path_weight: float = 0.01,
    ) -> None:
        super().__init__(env, ["coverage", "path"])
        self._beliefs: FilterRows = self.needed("beliefs")
        options = self.needed("options")
        if options.sensor != "landmarks":
            raise ValueError("sensor must be 'landmarks': image sensors have no list of true landmarks")
        self._farthest = options.tracking.farthest
        self._accuracy, self._goal = positive("accuracy", accuracy), positive("goal", goal)
        weights = positive("coverage_weight", coverage_weight), positive("path_weight", path_weight, allow_zero=True)
        self._coverage_weight, self._path_weight = weights
        coverage = spaces.Box(0.0, 1.0, (1,), np.float32)
        self.observation_space = spaces.Dict({**self.dict_space(), "coverage": coverage})
        self.action_space = spaces.Box(-1.0, 1.0, (env.action_space.shape[0] + 1,), np.float32)
        self._in_reach = [np.zeros(0, dtype=np.bool_)] * self.num_envs
        self._mapped, self._claimed = list(self._in_reach), list(self._in_reach)
        self._shown = np.zeros((self.num_envs, 1), dtype=np.float32)
        """Claimed coverage."""
        self._now = np.zeros((self.num_envs, 2))
        """Coverage and metres driven."""

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """Start with an empty map."""
        super().reset(chosen, seeds, options)
        for b in np.flatnonzero(chosen).tolist():
            places = self.world.landmark_truth(b).positions
            self._in_reach[b] = self._by_the_road(b, places)
            self._mapped[b], self._claimed[b] = np.zeros((2, len(places)), dtype=np.bool_)
        self._now[chosen] = self._looked(chosen)[chosen]

    def step(self, actions: Any, going: BoolArray) -> Step:
        """Drive, look, and be paid for what is new on the map."""
        stops = going & (actions[:, STOP] > _STOP_ABOVE)
        rewards, terminated, truncated = self.rows.step(np.delete(actions, STOP, axis=1), going)
        now = self._looked(going)
        mapped, driven = (now - self._now).T
        self._now[going] = now[going]
        paid = self.paid(going, {"coverage": mapped * self._coverage_weight, "path": driven * -self._path_weight})
        return rewards + paid, terminated | stops, truncated

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = super().observe()
        coverage, driven = self._now.T
        success = (coverage >= self._goal) & ~np.asarray(info["failed"])
        added = {"coverage": coverage.copy(), "path_length": driven.copy(), "is_success": success}
        return {**observation, "coverage": self._shown.copy()}, {**info, **added}

    def _looked(self, which: BoolArray) -> FloatArray:
        """The share of the landmarks that is mapped, after a look at the maps of some rows, and metres; (B, 2).

        What is shown of it is what the filter claims: with its own positions, by its own covariances.
        """
        now = self._now.copy()
        now[:, 1] = self.world.told("distance")
        maps = self._beliefs.world_maps()
        accurate = np.sqrt(np.einsum("nii->n", maps.covariances)) < self._accuracy
        for b in np.flatnonzero(which).tolist():
            mine, truth = slice(*maps.offsets[b : b + 2]), self.world.landmark_truth(b).positions
            counted = accurate[mine] & (maps.ids[mine] < len(truth))  # the others are on moving bodies
            ids, positions = maps.ids[mine][counted], maps.positions[mine][counted]
            errors = np.linalg.norm(positions - truth[ids], axis=1)
            mapped, in_reach = self._mapped[b], self._in_reach[b]
            mapped[ids[errors < _SINCERE * self._accuracy]] = True
            now[b, 0] = mapped[in_reach].mean() if in_reach.any() else 0.0
            claimed, new = self._claimed[b], ~self._claimed[b][ids]
            claimed[ids[new][self._by_the_road(b, positions[new])]] = True
            self._shown[b] = min(claimed.sum() / max(in_reach.sum(), 1), 1.0)
        return now

    def _by_the_road(self, b: int, positions: FloatArray) -> BoolArray:
        """Mask (N,) of positions (N, 3) no farther from the route than the sensor sees."""
        road = self.world.route_of(b).positions[:, [0, 2]]
        away: FloatArray = np.linalg.norm(positions[:, None, [0, 2]] - road, axis=-1)
        return np.asarray(away.min(axis=1, initial=np.inf) <= self._farthest)


class Explore(TaskEnv):
    """`StereoSlam/Explore-v0`: drive round a block and look about, until the map is worth no further metre.

    The action is `Box(-1, 1, (5,))`: acceleration, steering, stop (above 0.5), pan and tilt. The observation has
    `belief_sigmas` (6,) and `panorama` (12, 6), see `BeliefPanorama`, `head` (2,), `car` (2,), `route` (5, 2),
    `progress` (1,) and `coverage` (1,), the last three by the filter's estimate. The reward is 20 for the whole map
    (`Coverage`), minus 0.01 for each metre, 0.05 for each second, and 10 for a collision; nothing is paid for progress
    along the route. The episode ends with the stop, a collision, the end of the route, or after 1200 steps.

    Parameters
    ----------
    choices : mapping, optional
        Arguments of `DriveChoices`: the action is then a speed and a gaze for a second, or the stop, and a script
        steers. None: it is that of above.
    **arguments
        Those of `Coverage` and `RouteByEstimate`, of every task, see `TaskEnv`, and of `StereoSlam/DriveGaze-v0`: the
        route is "random-loop", things to see are on one side at a time, and the head is slow, as in
        `StereoSlam/ActiveGaze-v0`: it matters where one looks.
    """

    world = "StereoSlam/DriveGaze-v0"
    settings = MappingProxyType(
        {
            **{"route": "random-loop", "surroundings": "copses", "pan_rate": 0.6, "time_weight": 0.05, "slowest": 0.0},
            **dict.fromkeys((f"{name}_weight" for name in ("progress", "tracking", "goal", "jerk", "effort")), 0.0),
        }
    )
    parts = ((RouteByEstimate, {}), (Coverage, {}))
    keys = ("belief_sigmas", "panorama", "head", "car", "route", "progress", "coverage")

    @classmethod
    def wrappers(cls, level: str, given: dict[str, Any]) -> Wrappers:
        choices = given.pop("choices", None)
        wrappers = super().wrappers(level, given)
        return wrappers if choices is None else [*wrappers, (DriveChoices, choices)]


explore_vector = Explore.vector


def explore_by_looking(observation: Mapping[str, Any]) -> NDArray[np.float32]:
    """A rule: follow the route at up to 8 m/s, and look to the side ahead that has more and nearer landmarks."""
    action = follow_route(observation, 5, speed=_FAST)
    panorama = np.asarray(observation["panorama"], dtype=np.float64)
    azimuths = np.pi * ((2.0 * np.arange(len(panorama)) + 1.0) / len(panorama) - 1.0)
    worth = panorama[:, 0] * panorama[:, 3] * (np.abs(azimuths) < _FRONT)
    more = float(worth[azimuths > 0.0].sum() - worth[azimuths < 0.0].sum())
    action[3] = _PAN * np.sign(more) if abs(more) > _CLEAR else 0.0
    return action
