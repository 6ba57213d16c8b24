"""The task of a training, with information gain as the reward, and how well a network does in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from filters.contract.known_names import one_of
from filters.validation import FloatArray, positive, whole_number
from stereo_slam_env.policies.interface import directions, gaze_action, require_head
from stereo_slam_env.policies.network import Network
from stereo_slam_env.wrappers import BeliefObservation, BeliefPanorama, InformationGain, SelectedKeys
from stereo_slam_env.wrappers.information import Criterion
from stereo_slam_env.wrappers.recorded_wrapper import RecordedWrapper

if TYPE_CHECKING:
    from stereo_slam_env.vector.stereo_vector_env import StereoVectorEnv

GAZE_FILTER: Mapping[str, Any] = {"drop_unseen": False, "motion": "velocity-driven", "iterations": 2}
"""Options of a filter for a head that turns: it keeps what is out of view, believes the odometry, and linearises twice,
because landmarks that come back into view correct it by a lot at once."""
POLICY_KEYS = ("belief_sigmas", "head", "panorama")
"""Keys of the observation that a network decides by, in their order."""


@dataclass(frozen=True)
class GazeTask:
    """An environment, the filter in the loop, and the reward; JSON-able.

    Attributes
    ----------
    environment : str
        An id with a head.
    arguments : mapping
        Of the environment.
    filter : str
        Name of the filter in the loop.
    filter_options : mapping
        Of the filter.
    criterion : {"log-det", "entropy", "d-optimality", "a-optimality", "e-optimality"}
        Of `InformationGain`, on the pose.
    resolution : (2,) tuple
        Of `InformationGain`: knowing the position better than this, m, and the rotation, rad, is worth nothing.
    hold : int
        Steps for which a decision holds.
    pans : int, optional
        Directions to choose from, from the head's farthest left to its farthest right, at no tilt; nothing else is then
        decided. None: the action is that of the environment. Where left and right are as good, a choice can be learnt,
        and the mean of a continuous action ends up between them.
    """

    environment: str = "StereoSlam/Gaze-v0"
    arguments: Mapping[str, Any] = field(default_factory=dict)
    filter: str = "shared-anchor"
    filter_options: Mapping[str, Any] = field(default_factory=lambda: dict(GAZE_FILTER))
    criterion: Criterion = "log-det"
    resolution: tuple[float, float] = (0.01, 0.001)
    hold: int = 5
    pans: int | None = 9

    def __post_init__(self) -> None:
        whole_number("hold", self.hold, 1)
        if self.pans is not None:
            whole_number("pans", self.pans, 2)
        object.__setattr__(self, "resolution", tuple(positive("resolution", value) for value in self.resolution))

    def make(self, hold: int = 1) -> gym.Env[Any, Any]:
        """The environment for rules and planners: with the belief in the observation; actions hold for some steps."""
        env = gym.make(self.environment, **self.arguments)
        require_head(env)
        return BeliefPanorama(BeliefObservation(env, self.filter, options=self.filter_options, hold=hold))

    def make_held(self) -> gym.Env[Any, Any]:
        """The environment for networks: `POLICY_KEYS` alone, decisions hold, the reward is information on the pose."""
        paid = InformationGain(self.make(self.hold), self.criterion, of="pose", resolution=self.resolution)
        return SelectedKeys(paid, POLICY_KEYS)

    def make_for_learning(self) -> gym.Env[Any, Any]:
        """`make_held`, with the number of one of `choices` for an action if there are any."""
        env = self.make_held()
        return env if self.pans is None else DirectionOfGaze(env, self.pans)

    def make_vector(self, count: int, **arguments: Any) -> StereoVectorEnv:
        """`count` times `make_for_learning` in lock-step; further arguments are of `StereoVectorEnv`."""
        from stereo_slam_env.vector import DriveGazeVectorEnv, GazeVectorEnv

        kinds = {"StereoSlam/Gaze-v0": GazeVectorEnv, "StereoSlam/DriveGaze-v0": DriveGazeVectorEnv}
        one_of("environment", self.environment, kinds)
        return kinds[self.environment](
            count,
            belief={"filter": self.filter, "options": self.filter_options, "hold": self.hold},
            panorama={},
            information={"criterion": self.criterion, "resolution": self.resolution},
            keys=POLICY_KEYS,
            pans=self.pans,
            **arguments,
            **self.arguments,
        )

    @property
    def choices(self) -> FloatArray | None:
        """Pan and tilt to choose from, as shares of the largest; (pans, 2)."""
        return None if self.pans is None else directions(self.pans)


class DirectionOfGaze(RecordedWrapper, gym.ActionWrapper[Any, Any, Any]):
    """The action is the number of a direction to look in, from the farthest left to the farthest right.

    Parameters
    ----------
    env : gymnasium.Env
        With a head.
    pans : int
        Number of directions.
    """

    def __init__(self, env: gym.Env[Any, Any], pans: int = 9) -> None:
        super().__init__(env)
        self._actions = [gaze_action(env, direction) for direction in directions(whole_number("pans", pans, 2))]
        self.action_space = spaces.Discrete(pans)

    def action(self, action: Any) -> Any:
        """The action of the environment."""
        return self._actions[int(action)]


def active_gaze(render_mode: str | None = None, **arguments: Any) -> gym.Env[Any, Any]:
    """`StereoSlam/ActiveGaze-v0`: decide where to look so that the filter knows the most about the pose in the end.

    The head of `StereoSlam/Gaze-v0` is turned to one of nine directions (`Discrete(9)`, from the farthest left to the
    farthest right), for five steps. The observation has `belief_sigmas` (6,), `head` (2,) and `panorama` (12, 6), the
    landmarks of the filter's map around the car, see `BeliefPanorama`; the reward is the decrease of the log
    determinant of the covariance of the pose (`InformationGain`). `info` is that of `StereoSlam/Gaze-v0` and of these
    wrappers.

    Parameters
    ----------
    render_mode : str, optional
        That of `StereoSlam/Gaze-v0`.
    **arguments
        Of `GazeTask`: `arguments` of the environment, `filter`, `filter_options`, `criterion`, `resolution`, `hold`,
        `pans`; JSON-able.

    Raises
    ------
    TypeError
        There is no argument of that name.
    """
    task = GazeTask(**arguments)
    return replace(task, arguments={**task.arguments, "render_mode": render_mode}).make_for_learning()


def active_gaze_vector(num_envs: int = 1, max_episode_steps: int | None = None, **arguments: Any) -> StereoVectorEnv:
    """Many `StereoSlam/ActiveGaze-v0` in lock-step, see `StereoVectorEnv`.

    Parameters
    ----------
    num_envs : int
        Number of environments.
    max_episode_steps : int, optional
        Truncate episodes after so many decisions.
    **arguments
        Of `GazeTask`, and `autoreset_mode`, `scenes` and `threads` of `StereoVectorEnv`.
    """
    own = {name: arguments.pop(name) for name in ("autoreset_mode", "scenes", "threads") if name in arguments}
    task = GazeTask(**arguments)
    limit = None if max_episode_steps is None else task.hold * max_episode_steps
    return task.make_vector(num_envs, max_episode_steps=limit, **own)


@dataclass(frozen=True)
class Evaluation:
    """Means over episodes.

    Attributes
    ----------
    final_position_sigma_m : float
        Root of the trace of the position covariance at the end.
    final_pose_logdet : float
        Natural logarithm of the determinant of the pose covariance at the end (m, rad).
    position_rmse_m : float
        Root mean square of the true position error over each episode.
    final_position_error_m : float
        True position error at the end.
    """

    final_position_sigma_m: float
    final_pose_logdet: float
    position_rmse_m: float
    final_position_error_m: float


def evaluate(network: Network | None, task: GazeTask, seeds: Sequence[int], *, threads: int = 1) -> Evaluation:
    """Run an episode for each seed, all in lock-step; without a network the head looks straight ahead."""
    env = replace(task, pans=None).make_vector(len(seeds), threads=threads)
    try:
        observation, info = env.reset(seed=list(seeds))
        actions = np.zeros(env.action_space.shape or (), dtype=np.float32)
        going, figures, squares, steps = np.ones(len(seeds), dtype=np.bool_), np.zeros((len(seeds), 4)), 0.0, 0
        while going.any():
            if network is not None:
                actions[:, -2:] = network.actions(observation)
            observation, _, terminated, truncated, info = env.step(actions)
            errors = np.linalg.norm(env.filters.poses[:, :3] - info["truth_position"], axis=1)
            squares, steps = squares + errors**2, steps + 1
            ended = going & (terminated | truncated)
            P = env.filters.pose_covariances[ended]
            sigmas = np.sqrt(np.einsum("bii->b", P[:, :3, :3]))
            rmse = np.sqrt(squares[ended] / steps) if ended.any() else np.zeros(0)
            figures[ended] = np.column_stack([sigmas, np.linalg.slogdet(P)[1], rmse, errors[ended]])
            going &= ~ended
    finally:
        env.close()
    return Evaluation(*figures.mean(axis=0).tolist())
