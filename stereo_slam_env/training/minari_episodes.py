"""Episodes of a policy as a Minari data set, and back: for imitation and offline learning, or to replay them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest import mock

import gymnasium as gym
import numpy as np

from filters.contract.extras import require_module
from stereo_slam_env.policies.episode import rng_of_policy, run_episode
from stereo_slam_env.policies.interface import Action, Policy
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.world.routes import FRAME_PERIOD

if TYPE_CHECKING:
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer


def export_episodes(
    env: gym.Env[Any, Any],
    policy: Policy,
    seeds: Sequence[int],
    dataset_id: str,
    folder: str | Path,
    *,
    steps: int | None = None,
    algorithm: str = "",
) -> MinariDataset:
    """Run a policy and keep its observations, actions and rewards as a data set of Minari (HDF5, without loss).

    `infos` are kept too, so truth, right rows and covariances are there. Nothing is asked of the network. The episodes
    are in memory until the last one is over, and nothing is written before.

    Parameters
    ----------
    env : gymnasium.Env
        One of the environments, wrapped as the policy needs it; not closed here.
    policy : Policy
        The policy.
    seeds : sequence of int
        One episode each; they are kept with the episodes.
    dataset_id : str
        As Minari has it: "gaze/sweep-v0".
    folder : path
        Where data sets are; this one becomes `folder / dataset_id`.
    steps : int, optional
        Cut episodes off after so many; None: when they are over.
    algorithm : str
        Name of the policy, kept with the data.

    Returns
    -------
    minari.MinariDataset
        `recover_environment()` makes an environment in which the actions of an episode, with its seed, give the same
        observations and rewards to the bit.

    Raises
    ------
    ImportError
        The extra rl is missing.
    ValueError
        `dataset_id` is malformed or taken, there are no seeds, or a wrapper of `env` cannot be made again.
    """
    require_module("minari", "rl")
    import minari

    place = _place(dataset_id, folder)
    if place.exists():
        raise ValueError(f"dataset_id {dataset_id!r} is taken in {folder}: use another version, or delete {place}")
    if not len(seeds):
        raise ValueError("seeds must name at least one episode, got none")
    try:
        recipe = env.spec and env.spec.to_json()
    except (TypeError, ValueError) as error:
        raise ValueError(f"env cannot be made again from its spec: {error}") from error
    if not recipe:
        raise ValueError("env cannot be made again, as it has no spec: use gym.make and wrappers that keep arguments")
    episodes = [_episode(env, policy, seed, steps) for seed in seeds]
    with mock.patch.dict(os.environ, {"MINARI_DATASETS_PATH": str(folder)}), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # Minari asks for an author, an e-mail address and a link
        return minari.create_dataset_from_buffers(
            dataset_id,
            buffer=episodes,
            env=env,
            algorithm_name=algorithm or type(policy).__name__,
            description=f"{len(episodes)} episodes of {env.spec.id if env.spec else env}",
            jpeg_encoding=False,
        )


def load_episodes(dataset_id: str, folder: str | Path) -> MinariDataset:
    """A data set that `export_episodes` wrote, or any other of Minari's on this disk.

    Raises
    ------
    ImportError
        The extra rl is missing.
    ValueError
        It is not there, or `dataset_id` is malformed.
    """
    require_module("minari", "rl")
    import minari

    data = _place(dataset_id, folder) / "data"
    if not data.is_dir():
        raise ValueError(f"there is no data set {dataset_id!r} in {folder}")
    return minari.MinariDataset(data)


def seed_of(dataset: MinariDataset, index: int) -> int:
    """The seed of an episode."""
    (about,) = dataset.storage.get_episode_metadata([dataset.episode_indices[index]])
    return int(about["seed"])


def recording_of_episode(dataset: MinariDataset, index: int) -> Recording:
    """An episode as a recording for any filter: it is driven again, in full precision.

    Raises
    ------
    ValueError
        The environment skips frames (`hold` of `BeliefObservation`), or the episode cannot be driven again.
    """
    episode, seed = dataset[index], seed_of(dataset, index)
    env = dataset.recover_environment()
    try:
        driven = run_episode(env, _Recorded(episode.actions), seed, frames=len(episode) + 1)
    finally:
        env.close()
    if driven.failure is not None:
        raise ValueError(f"episode {index} cannot be driven again: {driven.failure}")
    frames = driven.recording.frames
    if round(frames[-1].timestamp / FRAME_PERIOD) != len(frames) - 1:
        raise ValueError(f"episode {index} of {dataset.id!r} skips frames: export with hold=1")
    return driven.recording


class _Recorded:
    """Policy that repeats recorded actions."""

    def __init__(self, actions: Action) -> None:
        self._actions = actions

    def reset(self, env: gym.Env[Any, Any], rng: np.random.Generator) -> None:
        self._step = 0

    def act(self, observation: Mapping[str, Any]) -> Action:
        self._step += 1
        action: Action = self._actions[self._step - 1]
        return action


def _episode(env: gym.Env[Any, Any], policy: Policy, seed: int, steps: int | None) -> EpisodeBuffer:
    from minari.data_collector import EpisodeBuffer

    observation, info = env.reset(seed=seed)
    policy.reset(env, rng_of_policy(seed))
    outcomes: list[tuple[Action, float, bool, bool]] = []
    observations, infos, over = [observation], [info], False
    while not over:
        action = policy.act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        truncated = truncated or (len(outcomes) + 1 == steps and not terminated)
        over = terminated or truncated
        observations.append(observation)
        infos.append(info)
        outcomes.append((action, float(reward), terminated, truncated))
    actions, rewards, terminations, truncations = zip(*outcomes, strict=True)
    return EpisodeBuffer(
        seed=seed,
        observations=_stacked(observations),
        actions=np.stack(actions),
        rewards=list(rewards),
        terminations=list(terminations),
        truncations=list(truncations),
        infos=_stacked(infos),
    )


def _stacked(values: Sequence[Any]) -> Any:
    """A row for each step; a mapping of them where each step has a mapping."""
    if isinstance(values[0], Mapping):
        return {key: _stacked([value[key] for value in values]) for key in values[0]}
    return np.stack(values)


def _place(dataset_id: str, folder: str | Path) -> Path:
    from minari.dataset.minari_dataset import DATASET_ID_RE

    match = DATASET_ID_RE.fullmatch(dataset_id)
    if match is None or match.group("version") is None:
        raise ValueError(f"dataset_id must be like 'gaze/sweep-v0', got {dataset_id!r}")
    return Path(folder) / dataset_id
