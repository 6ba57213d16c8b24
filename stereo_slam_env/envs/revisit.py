"""`StereoSlam/Revisit-v0`: decide when it is worth closing a loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from gymnasium import spaces

from filters.contract.validation import positive, whole_number
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rewards import InformationGain
from stereo_slam_env.envs.row_wrapper import PaidRows
from stereo_slam_env.envs.rows import Arrays, Seeds, Step
from stereo_slam_env.envs.task_env import TaskEnv
from stereo_slam_env.world.routes import Route

STOP, GO_ON = 0, 1
DEAREST: Mapping[str, float] = MappingProxyType({"easy": 0.2, "normal": 0.4, "hard": 0.8})
"""Highest price of a metre at each level, nats."""
_FARTHEST = 1000.0
"""Bound of the key `ahead`, m."""
_AWAY, _PAST = 30.0, 3.0
"""m: a loop leads farther away from the start than the first, and passes it nearer than the second."""
_BEYOND, _KNOWN_AGAIN = 5.0, -48.0
"""Of `close_if_it_pays`: metres beyond the start, and the sum of 2 ln(sigma) that is left there."""


class LoopClosure(PaidRows):
    """The agent takes over on the way round a block, and decides every second whether to drive on or to stop.

    `reset` drives from the start of the route to a place somewhere between the shares `begin` of the way to the start
    pose, with the filter running, and draws a price for a metre, evenly between 0 and `dearest`. The action is
    `Discrete(2)`: 0 stops, which ends the episode, 1 drives on for `hold` steps, looking straight ahead. The reward is
    that of the environment, what was learnt, minus the price of the metres. The observation gains `ahead` (1,), the
    planned way to the place where the route passes its start, m, below 0 beyond it, and `price` (1,), per metre. `info`
    gains `reward_path`; `is_success` is whether the loop was closed and that has paid.

    Parameters
    ----------
    env : gymnasium.Env
        `StereoSlam/Gaze-v0` on a route that passes its start again, with a reward for what is learnt.
    begin : (2,) sequence of float
        Shares of the way.
    dearest : float
        Per metre, in units of the reward of `env`.
    hold : int
        Steps of a decision.

    Raises
    ------
    ValueError
        An argument is impossible, or the route does not come back to its start.
    """

    def __init__(
        self,
        env: Any,
        begin: Sequence[float] = (0.5, 0.95),
        dearest: float = 0.4,
        hold: int = 10,
    ) -> None:
        super().__init__(env, ["information", "path"])
        low, high = (positive("begin", share, allow_zero=True) for share in begin)
        if not low <= high <= 1.0:
            raise ValueError(f"begin must be two shares that ascend to 1 at most, got {tuple(begin)}")
        self._begin, self._dearest = (low, high), positive("dearest", dearest)
        self._hold = whole_number("hold", hold, 1)
        closing_distance(self.needed("route"))  # refused before the first episode
        self._closing = np.zeros(self.num_envs)
        self._still = np.zeros((self.num_envs, *env.action_space.shape), dtype=np.float32)
        added = {
            "ahead": spaces.Box(-_FARTHEST, _FARTHEST, (1,), np.float32),
            "price": spaces.Box(0.0, max(dearest, max(DEAREST.values())), (1,), np.float32),
        }
        self.observation_space = spaces.Dict({**self.dict_space(), **added})
        self.action_space = spaces.Discrete(2)
        self._steps = np.zeros(self.num_envs, dtype=np.int64)
        self._price, self._driven, self._total = (np.zeros(self.num_envs) for _ in range(3))

    def reset(self, chosen: BoolArray, seeds: Seeds, options: Mapping[str, Any]) -> None:
        """Draw a place and a price, and drive there."""
        super().reset(chosen, seeds, options)
        first = np.zeros(self.num_envs, dtype=np.int64)  # step of the first decision
        for b in np.flatnonzero(chosen).tolist():
            generator, route = self.world.generator(b), self.world.route_of(b)
            self._closing[b] = closing_distance(route)
            first[b] = np.searchsorted(route.arc_length, generator.uniform(*self._begin) * self._closing[b])
            self._price[b] = generator.uniform(0.0, self._dearest)
        for numbers in (self._steps, self._total):
            numbers[chosen] = 0
        while (undecided := chosen & (self._steps < first)).any():
            self._drive(undecided)
        self._driven[chosen] = self.world.told("distance")[chosen]

    def step(self, actions: Any, going: BoolArray) -> Step:
        """Stop, or drive on for a second."""
        stops = going & (np.asarray(actions) == STOP)
        still, learnt = going & ~stops, np.zeros(self.num_envs)
        over = stops.copy()
        driving = still
        for _ in range(self._hold):
            if not driving.any():
                break
            rewards, terminated, truncated = self._drive(driving)
            learnt = learnt + rewards
            over |= terminated | truncated
            driving = driving & ~(terminated | truncated)
        driven = self.world.told("distance")
        path = np.where(still, self._price * (self._driven - driven), 0.0)
        self._driven[still] = driven[still]
        paid = self.paid(going, {"information": learnt, "path": path})
        self._total = self._total + paid
        return paid, over, np.zeros(self.num_envs, dtype=np.bool_)

    def observe(self) -> tuple[Arrays, Arrays]:
        observation, info = super().observe()
        ahead = self._closing - self._driven_by_script()
        added = {"ahead": ahead[:, None].astype(np.float32), "price": self._price[:, None].astype(np.float32)}
        return {**observation, **added}, {**info, "is_success": (ahead <= 0.0) & (self._total > 0.0)}

    def _driven_by_script(self) -> FloatArray:
        """Planned distances of all rows along their routes, m; (B,)."""
        lengths = (self.world.route_of(b).arc_length[step] for b, step in enumerate(self._steps.tolist()))
        return np.fromiter(lengths, dtype=np.float64, count=self.num_envs)

    def _drive(self, going: BoolArray) -> Step:
        """A step of the rows inside."""
        step = self.rows.step(self._still, going)
        self._steps[going] += 1
        return step


def closing_distance(route: Route) -> float:
    """Distance along a route to the place where it passes its start again, m; a `ValueError` where it does not."""
    away = np.linalg.norm(route.positions, axis=1)
    left = away > _AWAY
    back = np.flatnonzero((away < _PAST) & (np.cumsum(left) > 0))
    if not len(back):
        raise ValueError(f"the route must come back to its start, as 'loop' does, and {route.name!r} does not")
    lap = back[: int(np.argmax(np.diff(back, append=route.frames + 1) > 1)) + 1]  # the first time that it comes back
    return float(route.arc_length[lap[away[lap].argmin()]])


class Revisit(TaskEnv):
    """`StereoSlam/Revisit-v0`: drive on to see the first landmarks again, or save the metres.

    A car has driven most of the way round a block, and the uncertainty of its pose has grown. Where the route passes
    its start, the filter meets its first landmarks again, and the uncertainty falls. The action is `Discrete(2)`: stop,
    or drive on for a second. The observation has `belief_sigmas` (6,), `panorama` (12, 6), `ahead` (1,), the metres to
    the start, and `price` (1,), that of a metre in this episode. The reward is the decrease of the log determinant of
    the covariance of the pose in nats (`InformationGain`), minus the price of the metres; who stops at once earns 0.
    The episode ends with the stop or 24 m beyond the start.

    Parameters
    ----------
    **arguments
        Those of `LoopClosure`, whose `dearest` is that of the level in `DEAREST`, and of `InformationGain`, of every
        task, see `TaskEnv`, and of `StereoSlam/Gaze-v0`: the route is "random-loop", and the odometry the same at each
        level: the worse it is, the more there is to learn where a loop closes.
    """

    world = "StereoSlam/Gaze-v0"
    settings = MappingProxyType({"route": "random-loop"})
    parts = ((InformationGain, {"of": "pose", "resolution": (0.01, 0.001)}), (LoopClosure, {}))
    levels = MappingProxyType({name: {"dearest": dearest} for name, dearest in DEAREST.items()})
    keys = ("belief_sigmas", "panorama", "ahead", "price")

    @classmethod
    def at_level(cls, level: str) -> Mapping[str, Any]:
        return {name: value for name, value in super().at_level(level).items() if not name.startswith("odometry")}


revisit_vector = Revisit.vector


def close_if_it_pays(observation: Mapping[str, Any]) -> int:
    """A rule: drive on while what is expected of the closed loop is more than the price of the way.

    Expected is that the variances fall to those of a pose that was known again, as if they were independent.
    """
    ahead, price = float(observation["ahead"][0]), float(observation["price"][0])
    gain = 2.0 * float(np.log(np.asarray(observation["belief_sigmas"], dtype=np.float64)).sum()) - _KNOWN_AGAIN
    if ahead <= 0.0:
        return GO_ON if ahead > -_BEYOND else STOP
    return GO_ON if gain > price * (ahead + _BEYOND) else STOP
