"""`StereoSlam/ActiveGaze-v0`: decide where to look; the environment, the filter in the loop, and the reward."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from filters.contract.validation import one_of, positive, whole_number
from filters.geometry.arrays import FloatArray
from stereo_slam_env.envs.arguments import HeadOptions
from stereo_slam_env.envs.belief_observation import BeliefObservation
from stereo_slam_env.envs.belief_panorama import BeliefPanorama
from stereo_slam_env.envs.information import CRITERIA, Criterion
from stereo_slam_env.envs.make_vec import kind_of
from stereo_slam_env.envs.rewards import BeliefOf, InformationGain, TrueError
from stereo_slam_env.envs.row_wrapper import DirectionOfGaze, SelectedKeys, directions, moving_head
from stereo_slam_env.envs.rows import MixedRows, Rows
from stereo_slam_env.envs.task_env import GAZE_FILTER, Make, TaskEnv, arguments_of, of_level, of_world
from stereo_slam_env.envs.vector_env import RowsVectorEnv, core_rows, limited

WORLD: Mapping[str, Any] = MappingProxyType({"surroundings": "copses", "pan_rate": 0.6})
"""Arguments of the environment under those that are given: what can be seen is on one side, and the head is slow."""
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
    """Of the environment, over those of `WORLD`."""
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
        if not issubclass(kind_of(self.environment), HeadOptions):
            moving_head(None)
        object.__setattr__(self, "worlds", tuple(self.worlds))
        one_of("reward", self.reward, get_args(Reward))
        one_of("criterion", self.criterion, CRITERIA)
        one_of("belief", self.belief, get_args(BeliefOf))
        whole_number("hold", self.hold, 1)
        if self.pans is not None:
            whole_number("pans", self.pans, 2)
        object.__setattr__(self, "resolution", tuple(positive("resolution", value) for value in self.resolution))

    @property
    def world(self) -> dict[str, Any]:
        """Arguments of the environment, those of the task included."""
        return {**WORLD, **self.arguments}

    @property
    def each_world(self) -> tuple[GazeTask, ...]:
        """The task in each of its worlds."""
        further = ({**self.arguments, **world} for world in self.worlds)
        return tuple(replace(self, arguments=arguments, worlds=()) for arguments in (self.arguments, *further))

    def make(self, hold: int = 1) -> gym.Env[Any, Any]:
        """The environment for rules and planners: with the belief in the observation; actions hold for some steps."""
        believing: gym.Env[Any, Any] = self._believing(gym.make(self.environment, **self.world), hold)
        return believing

    def around(self, inside: gym.Env[Any, Any] | Rows) -> Any:
        """The task on an environment, or on rows: `POLICY_KEYS` alone, decisions that hold, its reward and choices."""
        paid: Any = self._believing(inside, self.hold)
        if self.reward == "error":
            paid = TrueError(paid)
        else:
            paid = InformationGain(
                paid,
                criterion=self.criterion,
                of="pose",
                resolution=self.resolution,
                belief=self.belief,
                nees_gate=self.nees_gate,
            )
        held = SelectedKeys(paid, keys=POLICY_KEYS)
        return held if self.pans is None else DirectionOfGaze(held, pans=self.pans)

    def make_rows(self, num_envs: int, scenes: int | None = None, threads: int = 1) -> Rows:
        """So many of the task as rows, spread over its worlds; see `envs.make_vec.stereo_vector`."""
        if self.worlds:
            counts = [num_envs * (k + 1) // len(self.each_world) for k in range(-1, len(self.each_world))]
            shares = zip(self.each_world, np.diff(counts).tolist(), strict=True)
            return MixedRows([task.make_rows(count, scenes, threads) for task, count in shares if count])
        arguments = self.world
        limit = arguments.pop("max_episode_steps", gym.spec(self.environment).max_episode_steps)
        inside = core_rows(kind_of(self.environment), arguments, num_envs=num_envs, scenes=scenes, threads=threads)
        gaze_rows: Rows = self.around(limited(inside, limit))
        return gaze_rows

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
        return BeliefPanorama(BeliefObservation(inside, filter=self.filter, options=self.filter_options, hold=hold))

    @property
    def choices(self) -> FloatArray | None:
        """Pan and tilt to choose from, as shares of the largest; (pans, 2)."""
        return None if self.pans is None else directions(self.pans)


class ActiveGaze(TaskEnv):
    """Decide where to look, so that the estimate of the pose is as true as it can be.

    ## Description

    A car with a stereo head follows a straight road of 98 m, and a SLAM filter follows the car. Things to see stand in
    groups on one side of the road, for a stretch of 30 to 110 m, then on the other; how densely, how far aside, and on
    which side first is drawn for each episode. There is fog: nothing is seen beyond 30 m. The head turns slowly, 0.6
    rad/s, so that a look to the wrong side costs seconds, and no fixed schedule of looking is right. World, sensors and
    truth are those of `StereoSlam/Gaze-v0`.

    ![Both views with the head turned right, and the map of the measured landmarks](../images/gaze.jpg)

    ## Action Space

    `Discrete(9)`: the direction to look in, from the head's farthest left (-2 rad) to its farthest right, for five
    steps of 0.1 s. With `pans=None` it is the `Box(-1, 1, (2,))` of `StereoSlam/Gaze-v0`.

    ## Observation Space

    `Dict`, what the filter believes:

    | Key | Shape | Type | Meaning |
    |-----|-------|------|---------|
    | `belief_sigmas` | (6,) | float32 | standard deviations of the pose: position in W, m; rotation, rad |
    | `head` | (2,) | float32 | pan and tilt, rad, without error |
    | `panorama` | (12, 6) | float32 | the map around the car in twelve sectors, see `BeliefPanorama` |

    ## Rewards

    *reward_error*: minus the squared true error of the position after the decision, m^2 (`TrueError`). With
    `reward="information"` it is *reward_information*, the decrease of the log determinant of the covariance of the
    pose, by the filter's claim or by a reference (`InformationGain`).

    ## Episode End

    - Termination: the end of the road, after 40 decisions.
    - Truncation: after 600 steps.

    ## Arguments

    Those of `GazeTask` (`filter`, `filter_options`, `reward`, `criterion`, `belief`, `nees_gate`, `resolution`, `hold`,
    `pans`), `level`, `keys`, `observation`, `arguments`, and those of `StereoSlam/Gaze-v0`, of which
    `surroundings="copses"` and `pan_rate=0.6` differ there.

    ## Training

    `stereo-slam train --environment StereoSlam/ActiveGaze-v0`; how the network of the package was made, and what
    looking is worth here and in other worlds, is on the page on active perception.

    ## Version History

    * v0: first version.
    """

    world = "StereoSlam/Gaze-v0"
    keys = POLICY_KEYS

    @classmethod
    def make_rows(cls, make: Make, **task: Any) -> Rows:
        selection = arguments_of(SelectedKeys, task)
        gaze = gaze_task(**task)
        rows: Rows = gaze.around(make(kind_of(gaze.environment), gaze.world))
        return SelectedKeys(rows, **{"keys": POLICY_KEYS, **selection}) if selection else rows


def gaze_task(level: str = "normal", arguments: Mapping[str, Any] | None = None, **task: Any) -> GazeTask:
    """The task of `ActiveGaze`, with its arguments."""
    task_arguments = {name: task.pop(name) for name in [field.name for field in fields(GazeTask)] if name in task}
    return GazeTask(arguments={**of_level(level, scripted=True), **of_world(arguments, task)}, **task_arguments)


active_gaze_vector = ActiveGaze.vector
