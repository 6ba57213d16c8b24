"""Policies in all rows of a vector at once, and their figures by the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.envs.rows import Rows
from stereo_slam_env.envs.stereo_env import row_of
from stereo_slam_env.envs.vector_env import RowsVectorEnv
from stereo_slam_env.policies.episode import rng_of_policy
from stereo_slam_env.policies.interface import ActsTogether, Policy

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
