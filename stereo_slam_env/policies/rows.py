"""Policies in all rows of a vector at once, their figures by the truth, and normalised scores of the tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from filters.contract.validation import require_known
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rows import Rows
from stereo_slam_env.envs.stereo_env import row_of
from stereo_slam_env.envs.vector_env import RowsVectorEnv
from stereo_slam_env.policies.episode import rng_of_policy
from stereo_slam_env.policies.registry import Action, ActsTogether, Policy
from stereo_slam_env.world.routes import FRAME_PERIOD
from stereo_slam_env.world.vehicle import Car

Actions = Callable[[Any, BoolArray], Any]
"""Actions of all rows (B, ...), by the observation and which rows go on."""


@dataclass(frozen=True, eq=False)
class TrueFigures:
    """What came out of B episodes, by the truth beside the claim; each (B,)."""

    final_position_error_m: FloatArray
    """True position error at the end."""
    position_rmse_m: FloatArray
    """Root mean square of the true position error over the episode."""
    final_position_sigma_m: FloatArray
    """Claimed: root of the trace of the position covariance at the end."""
    final_pose_logdet: FloatArray
    """Claimed: natural logarithm of the determinant of the pose covariance at the end (m, rad)."""
    final_position_nees: FloatArray
    """NEES of the position at the end, over its 3 degrees of freedom: more than 1 is claimed than is true."""
    returns: FloatArray
    """Sums of the rewards."""

    @property
    def table(self) -> FloatArray:
        """All of them, (B, 6)."""
        return np.column_stack([getattr(self, field.name) for field in fields(self)])


class RowOfVector:
    """A row of a vector as policies ask a single environment: `get_wrapper_attr`, and its action space.

    Parameters
    ----------
    vector : RowsVectorEnv
        With a filter in the loop.
    b : int
        Number of the row.
    """

    def __init__(self, vector: RowsVectorEnv, b: int) -> None:
        self.action_space = vector.single_action_space
        self._rows, self._b = vector.rows, b

    def get_wrapper_attr(self, name: str) -> Any:
        """What the single environment has under that name; an `AttributeError` where there is none."""
        rows, b = self._rows, self._b
        if name == "slam":
            return rows.inner("beliefs").filters[b]
        if name == "belief":
            return rows.inner("beliefs").belief(b)
        if name == "head_angles":
            return rows.world.angles()[b].copy()
        if name == "route":
            return rows.world.route_of(b)
        if name == "row":  # of `beliefs`, which are those of all rows
            return b
        return rows.inner(name)

    def has_wrapper_attr(self, name: str) -> bool:
        """Whether there is something under that name."""
        try:
            self.get_wrapper_attr(name)
        except AttributeError:
            return False
        return True


def policy_in_rows(vector: RowsVectorEnv, make: Callable[[], Policy], seeds: Sequence[int]) -> Actions:
    """One policy for each row; in the episode of a seed each decides as in the single environment.

    Simulator and filters run in lock-step. Call it after `vector.reset(seed=seeds)`.
    """
    policies = [make() for _ in seeds]
    for b, (policy, seed) in enumerate(zip(policies, seeds, strict=True)):
        policy.reset(RowOfVector(vector, b), rng_of_policy(seed))  # type: ignore[arg-type]
    actions = np.zeros(vector.action_space.shape or (), dtype=np.float32)

    first, alike = policies[0], len(set(map(type, policies))) == 1
    together = first.act_together if alike and isinstance(first, ActsTogether) else None

    def act(observation: Any, going: BoolArray) -> Any:
        index = np.flatnonzero(going).tolist()
        asked, seen = [policies[b] for b in index], [row_of(observation, b) for b in index]
        if index and together is not None:
            actions[index] = together(asked, seen)
        elif index:
            actions[index] = [policy.act(each) for policy, each in zip(asked, seen, strict=True)]
        return actions

    return act


def true_figures(vector: RowsVectorEnv, begin: Callable[[Any], Actions], seeds: Sequence[int]) -> TrueFigures:
    """Run an episode for each seed, all at once.

    Parameters
    ----------
    vector : RowsVectorEnv
        As many environments as seeds, with a filter in the loop; without a reset in the same step.
    begin : callable
        Called with the first observation; returns what acts.
    seeds : sequence of int
        Of the episodes.
    """
    observation, info = vector.reset(seed=list(seeds))
    act, count, beliefs = begin(observation), len(seeds), vector.rows.inner("beliefs")
    going, figures = np.ones(count, dtype=np.bool_), np.zeros((count, 6))
    squares, returns, steps = np.zeros(count), np.zeros(count), np.zeros(count)
    while going.any():
        observation, rewards, terminated, truncated, info = vector.advance(act(observation, going), going)
        offsets = beliefs.poses[:, :3] - info["truth_position"]
        errors = np.linalg.norm(offsets, axis=1)
        squares, steps, returns = squares + going * errors**2, steps + going, returns + np.where(going, rewards, 0.0)
        ended = going & (terminated | truncated)
        if ended.any():
            P, e = beliefs.pose_covariances[ended], offsets[ended]
            sigmas, logdets = np.sqrt(np.einsum("bii->b", P[:, :3, :3])), np.linalg.slogdet(P)[1]
            nees = np.einsum("bi,bi->b", e, np.linalg.solve(P[:, :3, :3], e[:, :, None])[..., 0]) / 3.0
            rmse = np.sqrt(squares[ended] / steps[ended])
            figures[ended] = np.column_stack([errors[ended], rmse, sigmas, logdets, nees, returns[ended]])
        going &= ~ended
    return TrueFigures(*figures.T)


class Oracle:
    """Tree search on the true reward: an upper bound that no policy can reach, for it knows the noise that comes.

    Before each decision every row is copied, with its filter, and tries each choice and then the same choice again,
    `depth` decisions in all; the row goes back, and takes the choice with the largest sum of rewards.

    Parameters
    ----------
    rows : Rows
        With a discrete action, and a reward that is the truth, as of `TrueError`.
    depth : int
        Decisions to look ahead.
    """

    def __init__(self, rows: Rows, depth: int = 3) -> None:
        self._rows, self._depth = rows, depth

    def act(self, going: BoolArray) -> Any:
        """The choices of all rows, (B,)."""
        rows, state = self._rows, self._rows.snapshot()
        choices = int(rows.action_space.n)
        sums = np.zeros((choices, rows.count))
        for choice in range(choices):
            alive = going.copy()
            for _ in range(self._depth):
                if not alive.any():
                    break
                rewards, terminated, truncated = rows.advance(np.full(rows.count, choice), alive)
                sums[choice] += rewards
                alive &= ~(terminated | truncated)
            rows.restore(state)
        return sums.argmax(axis=0)


_STEER_BY, _BRAKE_BY = 1, 3
"""Points of the observation `route`: the one to steer to, and the farthest one to be slow enough for."""

_AT_RANDOM = {
    "StereoSlam/Drive-v0": -9.63,
    "StereoSlam/ActiveGaze-v0": -5.26,
    "StereoSlam/Explore-v0": 0.08,
    "StereoSlam/Revisit-v0": -0.77,
    "StereoSlam/ClosedLoop-v0": -10.1,
    "StereoSlam/Branches-v0": 13.2,
}
REFERENCE_RETURNS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {name: (least, float(gym.spec(name).reward_threshold or 0.0)) for name, least in _AT_RANDOM.items()}
)
"""Mean returns of actions at random and of the best policy known (`reward_threshold`), by id, with default arguments;
measured by `python benchmarks/task_scores.py`. Of `ActiveGaze-v0` a fixed gaze in 500 drives, and the oracle by its
ratio to that in 16 of them (0.13); measured by `python benchmarks/active_policies.py`. Of `Branches-v0` five trained
networks in 200 scenes, which beat the rule (20.2); measured by `python benchmarks/trained_scores.py`."""


def normalised_score(environment: str, returns: ArrayLike) -> FloatArray:
    """Score of returns in an environment with its default arguments: 0 is random, 100 the best policy known.

    Parameters
    ----------
    environment : str
        A Gymnasium id of this package.
    returns : array_like
        Sums of the rewards of whole episodes, of any shape.

    Raises
    ------
    ValueError
        There is no score for that id.
    """
    require_known("there is no score for", [environment], REFERENCE_RETURNS)
    random, best = REFERENCE_RETURNS[environment]
    return 100.0 * (np.asarray(returns, dtype=np.float64) - random) / (best - random)


def follow_route(
    observation: Mapping[str, Any],
    actions: int = 2,
    *,
    speed: float | FloatArray = Car.max_speed,
    lateral: float = 3.0,
    beside: float = 0.0,
) -> Action:
    """Action that drives along the route that the observation shows (pure pursuit); the head looks straight ahead.

    Steers along the circle through the rear axle and the point 5 m ahead, and keeps slow enough for the circles to all
    points up to 20 m ahead.

    Parameters
    ----------
    observation : mapping
        With `car` (..., 2) and `route` (..., 5, 2), from environments in which the agent drives.
    actions : int
        Entries of the action; those after the first two are 0.
    speed : float or (...)
        Largest one, m/s.
    lateral : float
        Largest acceleration across the direction of travel, m/s^2.
    beside : float
        How far to the right of the route to drive, m.
    """
    car = Car()
    now = np.asarray(observation["car"], dtype=np.float64)[..., 0]
    right, forward = np.moveaxis(np.asarray(observation["route"], dtype=np.float64), -1, 0)
    right, forward = right + beside, forward + car.camera_forward
    curvatures = 2.0 * right / np.maximum(right**2 + forward**2, 1.0)
    bend = np.abs(curvatures[..., _STEER_BY : _BRAKE_BY + 1]).max(axis=-1)
    wanted = np.minimum(speed, np.sqrt(lateral / np.maximum(bend, 1e-6)))
    action = np.zeros((*now.shape, actions), dtype=np.float32)
    action[..., 0] = np.clip((wanted - now) / (car.max_acceleration * FRAME_PERIOD), -1.0, 1.0)
    action[..., 1] = np.clip(np.arctan(car.wheelbase * curvatures[..., _STEER_BY]) / car.max_steering, -1.0, 1.0)
    return action
