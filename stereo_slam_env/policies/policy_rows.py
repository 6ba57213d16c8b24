"""Policies for an episode and in all rows of a vector, their figures by the truth, normalised scores of the tasks."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import bootstrap

from filters.contract.validation import error_line, require_known
from filters.geometry.arrays import BoolArray, FloatArray
from filters.geometry.poses import Pose
from stereo_slam_env.envs.recorder import recording_of
from stereo_slam_env.envs.rows import Rows
from stereo_slam_env.envs.stereo_env import StereoEnv, row_of
from stereo_slam_env.envs.vector_env import RowsVectorEnv
from stereo_slam_env.policies.named_policies import ActsTogether, Policy
from stereo_slam_env.recording.recording import Frame, Recording

_STREAM = 6
"""Keeps the randomness of policies apart from that of the environment, whose seed is the same."""


@dataclass(frozen=True, eq=False)
class Episode:
    """An episode of a policy."""

    recording: Recording
    """The measurements, for any filter; with the angles of the head."""
    drive: tuple[Pose, ...]
    """Of the car, frame by frame: where the left camera would be if the head looked straight ahead."""
    failure: str | None = None
    """One line where the policy, or the filter in the loop, raised something. The drive goes on then, with the head
    turned straight ahead, so that it can still be told to be the same."""

    @property
    def drive_digest(self) -> str:
        """SHA-256 of the scene and of the drive through it: equal for all policies in the same world."""
        landmarks = self.recording.landmarks
        digest = hashlib.sha256()
        for pose in self.drive:
            digest.update(pose.position.tobytes() + pose.orientation.tobytes())
        if landmarks is not None and self.recording.source.get("arguments", {}).get("sensor") != "images":
            digest.update(landmarks.ids.tobytes() + landmarks.positions.tobytes())
        return digest.hexdigest()


def rng_of_policy(seed: int) -> np.random.Generator:
    """Random generator of the policy in the episode of a seed."""
    return np.random.default_rng([_STREAM, seed])


def run_episode(
    env: gym.Env[Any, Any],
    policy: Policy,
    seed: int,
    *,
    frames: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    about: Mapping[str, Any] | None = None,
) -> Episode:
    """Run a policy for one episode.

    Parameters
    ----------
    env : gymnasium.Env
        One of the environments, with the wrappers that the policy needs: most need `BeliefObservation`.
    policy : Policy
        The policy.
    seed : int
        Of the episode: same seed, same scene, drive and noise, and the same chance for the policy.
    frames : int, optional
        Stop after this many; None: when the episode is over.
    progress : callable, optional
        Called after each frame with (frames done, frames wanted).
    about : mapping, optional
        Further entries of the `source` of the recording; JSON-able.

    Returns
    -------
    Episode
        Whatever the policy or the filter raises on the way is its `failure`.

    Raises
    ------
    ValueError
        `env` is none of the environments of this package.
    """
    core = env.unwrapped
    if not isinstance(core, StereoEnv):
        raise ValueError(f"env must be one of the environments of this package, got {core}")
    frames_wanted = 0 if frames is None else frames
    collected: list[Frame] = []
    drive: list[Pose] = []

    def keep() -> None:
        collected.append(core.frame)
        drive.append(core.body)
        if progress is not None:
            progress(len(collected), max(frames_wanted, len(collected)))

    failing_part = "environment"
    failure = None
    over = False
    try:
        observation, _ = env.reset(seed=seed)
        frames_wanted = core.route.frames if frames is None else frames  # a random route is known from here on
        keep()
        failing_part = "policy"
        policy.reset(env, rng_of_policy(seed))
        while not over and len(collected) < frames_wanted:
            failing_part = "policy"
            action = policy.act(observation)
            failing_part = "environment"
            observation, _, terminated, truncated, _ = env.step(action)
            keep()
            over = terminated or truncated
    except (KeyboardInterrupt, SystemExit):  # of the user, unless in a process of its own
        raise
    except BaseException as error:  # a stranger's policy may raise anything; the comparison goes on without it
        failure = f"frame {len(collected) - 1}: {failing_part}: {error_line(error)}"
        if not collected or core.frame is not collected[-1]:
            keep()  # what the filter in the loop did not survive
    straight_ahead = np.zeros(core.action_space.shape or (), dtype=np.float32)
    while failure is not None and not over and len(collected) < frames_wanted:
        over = core.step(straight_ahead)[2]
        keep()
    return Episode(recording_of(core, collected, seed, about), tuple(drive), failure)


Actions = Callable[[Any, BoolArray], Any]
"""Actions of all rows (B, ...), by the observation and which rows go on."""


@dataclass(frozen=True, eq=False)
class TrueFigures:
    """Results of B episodes, by the truth beside the claim; each (B,)."""

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
        """Attribute of the single environment; an `AttributeError` where there is none."""
        rows, b = self._rows, self._b
        if name == "slam":
            return rows.get_attr("beliefs").filters[b]
        if name == "belief":
            return rows.get_attr("beliefs").belief(b)
        if name == "head_angles":
            return rows.world.angles()[b].copy()
        if name == "route":
            return rows.world.route_of(b)
        if name == "row":  # of `beliefs`, which are those of all rows
            return b
        return rows.get_attr(name)

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
        row_policies, row_observations = [policies[b] for b in index], [row_of(observation, b) for b in index]
        if index and together is not None:
            actions[index] = together(row_policies, row_observations)
        elif index:
            actions[index] = [policy.act(each) for policy, each in zip(row_policies, row_observations, strict=True)]
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
    act, count, beliefs = begin(observation), len(seeds), vector.rows.get_attr("beliefs")
    active, figures = np.ones(count, dtype=np.bool_), np.zeros((count, 6))
    squares, returns, steps = np.zeros(count), np.zeros(count), np.zeros(count)
    while active.any():
        observation, rewards, terminated, truncated, info = vector.advance(act(observation, active), active)
        offsets = beliefs.poses[:, :3] - info["truth_position"]
        errors = np.linalg.norm(offsets, axis=1)
        squares, steps, returns = squares + active * errors**2, steps + active, returns + np.where(active, rewards, 0.0)
        ended = active & (terminated | truncated)
        if ended.any():
            P, e = beliefs.pose_covariances[ended], offsets[ended]
            sigmas, logdets = np.sqrt(np.einsum("bii->b", P[:, :3, :3])), np.linalg.slogdet(P)[1]
            nees = np.einsum("bi,bi->b", e, np.linalg.solve(P[:, :3, :3], e[:, :, None])[..., 0]) / 3.0
            rmse = np.sqrt(squares[ended] / steps[ended])
            figures[ended] = np.column_stack([errors[ended], rmse, sigmas, logdets, nees, returns[ended]])
        active &= ~ended
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
        sums = np.zeros((choices, rows.num_envs))
        for choice in range(choices):
            alive = going.copy()
            for _ in range(self._depth):
                if not alive.any():
                    break
                rewards, terminated, truncated = rows.step(np.full(rows.num_envs, choice), alive)
                sums[choice] += rewards
                alive &= ~(terminated | truncated)
            rows.restore(state)
        return sums.argmax(axis=0)


_AT_RANDOM = {
    "StereoSlam/Drive-v0": -10.7,
    "StereoSlam/ActiveGaze-v0": -4.52,
    "StereoSlam/Explore-v0": 0.19,
    "StereoSlam/Revisit-v0": -0.77,
    "StereoSlam/ClosedLoop-v0": -11.2,
    "StereoSlam/Branches-v0": 21.7,
    "StereoSlam/Follow-v0": -3.07,
}
REFERENCE_RETURNS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {name: (least, float(gym.spec(name).reward_threshold or 0.0)) for name, least in _AT_RANDOM.items()}
)
"""Mean returns of actions at random and of the best policy known (`reward_threshold`), by id, with default arguments;
measured by `python benchmarks/task_scores.py`. Of `ActiveGaze-v0` a fixed gaze in 500 drives, and the oracle by its
ratio to that in 32 of them (0.33); measured by `python benchmarks/active_policies.py`. Of `Branches-v0` three
trained networks in 100 scenes, which beat the rule (27.8), of `Explore-v0` one in 60 (4.9); measured by `python
benchmarks/trained_scores.py`. Of `Follow-v0` its rule, which is shown the truth, in 40 scenes."""


def paired_score(environment: str, returns: ArrayLike, baseline: ArrayLike) -> tuple[float, float, float]:
    """Score of returns against those of the agent whose score is 0, in the same episodes, and its 95 % interval.

    Parameters
    ----------
    environment : str
        A Gymnasium id of this package.
    returns, baseline : (N,) array_like
        Sums of the rewards of whole episodes of two agents, of the same seeds.

    Returns
    -------
    tuple of float
        Score, and the ends of its interval by the percentile bootstrap over the episodes.
    """
    gains = normalised_score(environment, returns) - normalised_score(environment, baseline)
    if np.ptp(gains) == 0.0:
        return (float(gains[0]),) * 3
    resampled = bootstrap((gains,), np.mean, method="percentile", n_resamples=2000, rng=0).confidence_interval
    return float(gains.mean()), float(resampled.low), float(resampled.high)


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
