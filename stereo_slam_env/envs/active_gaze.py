"""`StereoSlam/ActiveGaze-v0`: decide where to look; the environment, the filter in the loop, and the reward."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, cast, get_args

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from filters.contract.validation import one_of, positive, whole_number
from filters.geometry.arrays import FloatArray
from stereo_slam_env.envs import (
    BeliefObservation,
    BeliefPanorama,
    DirectionOfGaze,
    InformationGain,
    SelectedKeys,
    TrueError,
)
from stereo_slam_env.envs.information import CRITERIA, Criterion
from stereo_slam_env.envs.make_vec import arguments_of, of_level, of_world, rows_of, vector_of
from stereo_slam_env.envs.mixed_rows import MixedRows
from stereo_slam_env.envs.rewards import BeliefOf
from stereo_slam_env.envs.row_wrapper import directions, moving_head
from stereo_slam_env.envs.rows import Rows
from stereo_slam_env.envs.vector_env import RowsVectorEnv, limited

GAZE_FILTER: Mapping[str, Any] = {
    "drop_unseen": False,
    "motion": "velocity-driven",
    "iterations": 2,
    "relinearise_above": 1.0,
}
"""Options of a filter for a head that turns: it keeps what is out of view, believes the odometry, and linearises a
second time what its first tangent misses by more than its noise: landmarks that come back into view correct it by a lot
at once, and all others, relinearised, would stretch the way."""
POLICY_KEYS = ("belief_sigmas", "head", "panorama")
"""Keys of the observation that a network decides by, in their order."""
Reward = Literal["information", "error"]
"""What is paid for: what a belief gained (`InformationGain`), or the true error after a decision (`TrueError`)."""


@dataclass(frozen=True)
class GazeTask:
    """An environment, the filter in the loop, and the reward; JSON-able."""

    environment: str = "StereoSlam/Gaze-v0"
    """An id with a head."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Of the environment."""
    worlds: tuple[Mapping[str, Any], ...] = ()
    """Arguments of further environments, over those of the first: rows are spread over all of them, so that a network
    is learnt in all worlds at once."""
    filter: str = "shared-anchor"
    """Name of the filter in the loop."""
    filter_options: Mapping[str, Any] = field(default_factory=lambda: dict(GAZE_FILTER))
    """Of the filter."""
    reward: Reward = "error"
    """For "error" the four arguments of `InformationGain` that follow have no effect."""
    criterion: Criterion = "log-det"
    """Of `InformationGain`, on the pose."""
    belief: BeliefOf = "filter"
    """Of `InformationGain`."""
    nees_gate: float | None = None
    """Of `InformationGain`."""
    resolution: tuple[float, float] = (0.01, 0.001)
    """Of `InformationGain`: knowing the position better than this, m, and the rotation, rad, is worth nothing."""
    hold: int = 5
    """Steps for which a decision holds."""
    pans: int | None = 9
    """Directions to choose from, from the head's farthest left to its farthest right, at no tilt; nothing else is then
    decided. None: the action is that of the environment. Where left and right are as good, a choice can be learnt, and
    the mean of a continuous action ends up between them."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "worlds", tuple(self.worlds))
        one_of("reward", self.reward, get_args(Reward))
        one_of("criterion", self.criterion, CRITERIA)
        one_of("belief", self.belief, get_args(BeliefOf))
        whole_number("hold", self.hold, 1)
        if self.pans is not None:
            whole_number("pans", self.pans, 2)
        object.__setattr__(self, "resolution", tuple(positive("resolution", value) for value in self.resolution))

    def make(self, hold: int = 1) -> gym.Env[Any, Any]:
        """The environment for rules and planners: with the belief in the observation; actions hold for some steps."""
        env = gym.make(self.environment, **self.arguments)
        moving_head(env.get_wrapper_attr("head"))
        believing: gym.Env[Any, Any] = self._believing(env, hold)
        return believing

    def make_held(self) -> gym.Env[Any, Any]:
        """The environment for networks: `POLICY_KEYS` alone, decisions hold, the reward is that of the task."""
        held: gym.Env[Any, Any] = self._held(gym.make(self.environment, **self.arguments))
        return held

    def make_for_learning(self) -> gym.Env[Any, Any]:
        """`make_held`, with the number of one of `choices` for an action if there are any."""
        env: Any = self.make_held()
        return cast("gym.Env[Any, Any]", env if self.pans is None else DirectionOfGaze(env, self.pans))

    def make_rows(self, num_envs: int, scenes: int | None = None, threads: int = 1) -> Rows:
        """So many times `make_for_learning` as rows, spread over the worlds; see `envs.make_vec.stereo_vector`."""
        if self.worlds:
            counts = [num_envs * (k + 1) // len(self.each_world) for k in range(-1, len(self.each_world))]
            shares = zip(self.each_world, np.diff(counts).tolist(), strict=True)
            return MixedRows([task.make_rows(count, scenes, threads) for task, count in shares if count])
        arguments = dict(self.arguments)
        limit = arguments.pop("max_episode_steps", gym.spec(self.environment).max_episode_steps)
        arguments.pop("disable_env_checker", None)
        rows = rows_of(self.environment, num_envs, arguments, scenes=scenes, threads=threads)
        held = self._held(limited(rows, limit))
        gaze_rows: Rows = held if self.pans is None else DirectionOfGaze(held, pans=self.pans)
        return gaze_rows

    @property
    def each_world(self) -> tuple[GazeTask, ...]:
        """The task in each of its worlds."""
        further = ({**self.arguments, **world} for world in self.worlds)
        return tuple(replace(self, arguments=arguments, worlds=()) for arguments in (self.arguments, *further))

    def make_vector(
        self,
        count: int,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        scenes: int | None = None,
        threads: int = 1,
    ) -> RowsVectorEnv:
        """`make_rows` as a vector of Gymnasium."""
        return RowsVectorEnv(self.make_rows(count, scenes, threads), autoreset_mode)

    def _believing(self, inside: gym.Env[Any, Any] | Rows, hold: int) -> Any:
        believing = BeliefObservation(inside, filter=self.filter, options=self.filter_options, hold=hold)
        return BeliefPanorama(believing)

    def _held(self, inside: gym.Env[Any, Any] | Rows) -> Any:
        believing = self._believing(inside, self.hold)
        paid: Any
        if self.reward == "error":
            paid = TrueError(believing)
        else:
            paid = InformationGain(
                believing,
                criterion=self.criterion,
                of="pose",
                resolution=self.resolution,
                belief=self.belief,
                nees_gate=self.nees_gate,
            )
        return SelectedKeys(paid, keys=POLICY_KEYS)

    @property
    def training(self) -> Mapping[str, Any]:
        """Settings that the task states: the defaults of `PPOSettings` are its own."""
        return {}

    @property
    def choices(self) -> FloatArray | None:
        """Pan and tilt to choose from, as shares of the largest; (pans, 2)."""
        return None if self.pans is None else directions(self.pans)


def active_gaze(
    render_mode: str | None = None,
    *,
    level: str = "normal",
    arguments: Mapping[str, Any] | None = None,
    many: Mapping[str, Any] | None = None,
    **task: Any,
) -> Any:
    """`StereoSlam/ActiveGaze-v0`: decide where to look so that the estimate of the pose is as true as it can be.

    The head of `StereoSlam/Gaze-v0` is turned to one of nine directions (`Discrete(9)`, from the farthest left to the
    farthest right), for five steps. The observation has `belief_sigmas` (6,), `head` (2,) and `panorama` (12, 6), the
    landmarks of the filter's map around the car, see `BeliefPanorama`; the reward is minus the squared true error of
    the position after the decision (`TrueError`), or with `reward="information"` the decrease of the log determinant of
    the covariance of the pose (`InformationGain`). `info` is that of `StereoSlam/Gaze-v0` and of these
    wrappers.

    Parameters
    ----------
    render_mode : str, optional
        That of `StereoSlam/Gaze-v0`.
    level : {"easy", "normal", "hard"}
        Difficulty, see `LEVELS`.
    arguments : mapping, optional
        Of `StereoSlam/Gaze-v0`; JSON-able.
    many : mapping, optional
        Arguments of `GazeTask.make_rows`: that many in rows, instead of one environment.
    **task
        Others of `GazeTask`: `filter`, `filter_options`, `reward`, `criterion`, `belief`, `nees_gate`, `resolution`,
        `hold`, `pans`; `observation` and `keys` of `SelectedKeys`; and arguments of `StereoSlam/Gaze-v0`, as in
        `arguments`. JSON-able.

    Raises
    ------
    TypeError
        There is no argument of that name.
    """
    bare = {"render_mode": render_mode, "max_episode_steps": -1, "disable_env_checker": True}  # the task has its own
    selection = arguments_of(SelectedKeys, task)
    gaze = gaze_task(level, arguments, **task)
    gaze = replace(gaze, arguments={**bare, **gaze.arguments})
    task_env: Any = gaze.make_for_learning() if many is None else gaze.make_rows(**many)
    return SelectedKeys(task_env, **{"keys": POLICY_KEYS, **selection}) if selection else task_env


def gaze_task(level: str = "normal", arguments: Mapping[str, Any] | None = None, **task: Any) -> GazeTask:
    """The task of `active_gaze`, with its arguments."""
    task_arguments = {name: task.pop(name) for name in [field.name for field in fields(GazeTask)] if name in task}
    return GazeTask(arguments={**of_level(level, scripted=True), **of_world(arguments, task)}, **task_arguments)


active_gaze_vector = vector_of(active_gaze)
