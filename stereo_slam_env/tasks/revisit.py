"""`StereoSlam/Revisit-v0`: decide when it is worth closing a loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.validation import positive, whole_number
from stereo_slam_env.tasks.levels import inner_environment
from stereo_slam_env.training.task import GAZE_FILTER
from stereo_slam_env.world.routes import Route
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, InformationGain, SelectedKeys
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper, dict_space

KEYS = ("belief_sigmas", "panorama", "ahead", "price")
STOP, GO_ON = 0, 1
_FARTHEST = 1000.0
"""Bound of the key `ahead`, m."""
_AWAY, _PAST = 30.0, 3.0
"""m: a loop leads farther away from the start than the first, and passes it nearer than the second."""
_BEYOND, _KNOWN_AGAIN = 5.0, -48.0
"""Of `close_if_it_pays`: metres beyond the start, and the sum of 2 ln(sigma) that is left there."""


class LoopClosure(RecordedWrapper):
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
        env: gym.Env[Any, Any],
        begin: Sequence[float] = (0.5, 0.95),
        dearest: float = 0.4,
        hold: int = 10,
    ) -> None:
        super().__init__(env)
        low, high = (positive("begin", share, allow_zero=True) for share in begin)
        if not low <= high <= 1.0:
            raise ValueError(f"begin must be two shares that ascend to 1 at most, got {tuple(begin)}")
        self._begin, self._dearest = (low, high), positive("dearest", dearest)
        self._hold = whole_number("hold", hold, 1)
        self._closing = closing_distance(self.inner("route"))
        self._still = np.zeros(env.action_space.shape or (), dtype=np.float32)
        added = {
            "ahead": spaces.Box(-_FARTHEST, _FARTHEST, (1,), np.float32),
            "price": spaces.Box(0.0, dearest, (1,), np.float32),
        }
        self.observation_space = spaces.Dict({**dict_space(env, "LoopClosure").spaces, **added})
        self.action_space = spaces.Discrete(2)
        self._steps, self._price, self._driven, self._total = 0, 0.0, 0.0, 0.0
        self._observation: dict[str, Any] = {}
        self._info: dict[str, Any] = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Reset the environment, draw a place and a price, and drive there."""
        self._observation, self._info = self.env.reset(seed=seed, options=options)
        share = self.env.np_random.uniform(*self._begin)
        self._price = float(self.env.np_random.uniform(0.0, self._dearest))
        self._steps, self._total = 0, 0.0
        arc_length = self.inner("route").arc_length
        while arc_length[self._steps] < share * self._closing:
            self._drive()
        self._driven = float(self._info["distance"])
        return self._shown(), self._with_rewards(0.0, 0.0)

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Stop, or drive on for a second."""
        if action == STOP:
            self._observation, self._info = deepcopy((self._observation, self._info))  # nothing is handed out twice
            return self._shown(), 0.0, True, False, self._with_rewards(0.0, 0.0)
        learnt, over, left = 0.0, False, self._hold
        while left > 0 and not over:
            reward, over = self._drive()
            learnt, left = learnt + reward, left - 1
        driven = float(self._info["distance"])
        path, self._driven = self._price * (self._driven - driven), driven
        self._total += learnt + path
        return self._shown(), learnt + path, over, False, self._with_rewards(learnt, path)

    def _drive(self) -> tuple[float, bool]:
        """A step of the environment: its reward, and whether the episode is over."""
        self._observation, reward, terminated, truncated, self._info = self.env.step(self._still)
        self._steps += 1
        return float(reward), terminated or truncated

    @property
    def _ahead(self) -> float:
        return self._closing - float(self.inner("route").arc_length[self._steps])

    def _shown(self) -> dict[str, Any]:
        added = {"ahead": self._ahead, "price": self._price}
        return {**self._observation, **{key: np.array([value], dtype=np.float32) for key, value in added.items()}}

    def _with_rewards(self, learnt: float, path: float) -> dict[str, Any]:
        rewards = {"reward_information": np.float64(learnt), "reward_path": np.float64(path)}
        return {**self._info, **rewards, "is_success": np.bool_(self._ahead <= 0.0 and self._total > 0.0)}


def closing_distance(route: Route) -> float:
    """Distance along a route to the place where it passes its start again, m; a `ValueError` where it does not."""
    away = np.linalg.norm(route.positions, axis=1)
    left = away > _AWAY
    back = np.flatnonzero((away < _PAST) & (np.cumsum(left) > 0))
    if not len(back):
        raise ValueError(f"the route must come back to its start, as 'loop' does, and {route.name!r} does not")
    lap = back[: int(np.argmax(np.diff(back, append=route.frames + 1) > 1)) + 1]  # the first time that it comes back
    return float(route.arc_length[lap[away[lap].argmin()]])


def revisit(
    render_mode: str | None = None,
    *,
    level: str = "normal",
    arguments: Mapping[str, Any] | None = None,
    filter: str = "shared-anchor",
    filter_options: Mapping[str, Any] = GAZE_FILTER,
    begin: Sequence[float] = (0.5, 0.95),
    dearest: float = 0.4,
    hold: int = 10,
) -> gym.Env[Any, Any]:
    """`StereoSlam/Revisit-v0`: drive on to see the first landmarks again, or save the metres.

    A car has driven most of the way round a block, and the uncertainty of its pose has grown. Where the route passes
    its start, the filter meets its first landmarks again, and the uncertainty falls. The action is `Discrete(2)`: stop,
    or drive on for a second. The observation has `belief_sigmas` (6,), `panorama` (12, 6), `ahead` (1,), the metres to
    the start, and `price` (1,), that of a metre in this episode. The reward is the decrease of the log determinant of
    the covariance of the pose in nats (`InformationGain`), minus the price of the metres; who stops at once earns 0.
    The episode ends with the stop or 24 m beyond the start.

    Parameters
    ----------
    render_mode : str, optional
        That of `StereoSlam/Gaze-v0`.
    level : {"easy", "normal", "hard"}
        Difficulty, see `LEVELS`.
    arguments : mapping, optional
        Of `StereoSlam/Gaze-v0`; JSON-able. The route is "loop" unless given here.
    filter : str
        Name of the filter in the loop.
    filter_options : mapping
        Its options; one that drops what is out of view cannot close a loop.
    begin, dearest, hold
        Of `LoopClosure`.
    """
    own = {"render_mode": render_mode, "route": "loop"}
    env = inner_environment("StereoSlam/Gaze-v0", level, arguments or {}, **own)
    env = BeliefPanorama(BeliefObservation(env, filter, options=filter_options))
    paid = InformationGain(env, of="pose", resolution=(0.01, 0.001))
    return SelectedKeys(LoopClosure(paid, begin, dearest, hold), KEYS)


def close_if_it_pays(observation: Mapping[str, Any]) -> int:
    """A rule: drive on while what is expected of the closed loop is more than the price of the way.

    Expected is that the variances fall to those of a pose that was known again, as if they were independent.
    """
    ahead, price = float(observation["ahead"][0]), float(observation["price"][0])
    gain = 2.0 * float(np.log(np.asarray(observation["belief_sigmas"], dtype=np.float64)).sum()) - _KNOWN_AGAIN
    if ahead <= 0.0:
        return GO_ON if ahead > -_BEYOND else STOP
    return GO_ON if gain > price * (ahead + _BEYOND) else STOP
