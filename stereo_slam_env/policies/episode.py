"""One episode of a policy, kept as a recording."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from filters.contract.validation import error_line
from filters.geometry.poses import Pose
from stereo_slam_env.envs.recorder import recording_of
from stereo_slam_env.envs.stereo_env import StereoEnv
from stereo_slam_env.policies.registry import Policy
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
    wanted = 0 if frames is None else frames
    collected: list[Frame] = []
    drive: list[Pose] = []

    def keep() -> None:
        collected.append(core.frame)
        drive.append(core.body)
        if progress is not None:
            progress(len(collected), max(wanted, len(collected)))

    asked = "environment"
    failure = None
    over = False
    try:
        observation, _ = env.reset(seed=seed)
        wanted = core.route.frames if frames is None else frames  # a random route is known from here on
        keep()
        asked = "policy"
        policy.reset(env, rng_of_policy(seed))
        while not over and len(collected) < wanted:
            asked = "policy"
            action = policy.act(observation)
            asked = "environment"
            observation, _, terminated, truncated, _ = env.step(action)
            keep()
            over = terminated or truncated
    except (KeyboardInterrupt, SystemExit):  # of the user, unless in a process of its own
        raise
    except BaseException as error:  # a stranger's policy may raise anything; the comparison goes on without it
        failure = f"frame {len(collected) - 1}: {asked}: {error_line(error)}"
        if not collected or core.frame is not collected[-1]:
            keep()  # what the filter in the loop did not survive
    straight_ahead = np.zeros(core.action_space.shape or (), dtype=np.float32)
    while failure is not None and not over and len(collected) < wanted:
        over = core.step(straight_ahead)[2]
        keep()
    return Episode(recording_of(core, collected, seed, about), tuple(drive), failure)
