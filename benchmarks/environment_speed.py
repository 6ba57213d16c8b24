"""How fast environments are: one alone, and vectors on one thread and on two.

    python benchmarks/environment_speed.py                          # three minutes
    python benchmarks/environment_speed.py --only Gaze --rounds 7

Environments and thread counts take turns, a whole episode of each at a time (the step that resets it included), and the
quickest episode counts: what it takes on an idle machine. CartPole's vector by Gymnasium is the yardstick. Then what it
takes to begin an episode, and the memory of an environment. Wall time, because threads are among what is compared; with
`--processor` the processor time of one thread instead, for a machine that others use.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from threadpoolctl import threadpool_limits

import stereo_slam_env  # noqa: F401 (registers the environments)
from harness import arguments, in_turns, show

DENSE = {"policy": "route", "max_landmarks": 100, "refill_below": 100}
"""100 landmarks in every frame; the scene of the route "town" has some 180 bodies of 1400 solids."""
KINDS: dict[str, tuple[str, int, dict[str, Any]]] = {
    "CartPole": ("CartPole-v1", 64, {}),
    "one Gaze": ("StereoSlam/Gaze-v0", 1, {}),
    "one Drive on its route, 100 landmarks": ("StereoSlam/Drive-v0", 1, DENSE),
    "the same Drive by PyBullet's rays": ("StereoSlam/Drive-v0", 1, {**DENSE, "physics": "bullet"}),
    "one ActiveGaze (two iterations, panorama, reward)": ("StereoSlam/ActiveGaze-v0", 1, {}),
    "Gaze, scenes from a pool": ("StereoSlam/Gaze-v0", 256, {"scenes": 64}),
    "Gaze, a new scene for every episode": ("StereoSlam/Gaze-v0", 256, {}),
    "Drive on its route, 100 landmarks": ("StereoSlam/Drive-v0", 64, {**DENSE, "scenes": 8}),
    "Drive by an agent that crashes, scenes from a pool": ("StereoSlam/Drive-v0", 64, {"scenes": 64}),
    "Drive by an agent that crashes, new scenes": ("StereoSlam/Drive-v0", 64, {}),
    "ActiveGaze, scenes from a pool": ("StereoSlam/ActiveGaze-v0", 64, {"scenes": 64}),
    "ActiveGaze, a new scene for every episode": ("StereoSlam/ActiveGaze-v0", 64, {}),
}
"""Id, number of environments (1: by `gym.make`) and arguments."""


class Episodes:
    """Steps of an environment or of a vector, with random actions."""

    def __init__(self, name: str, count: int, arguments: dict[str, Any], threads: int = 1) -> None:
        if count == 1:
            self.env: Any = gym.make(name, disable_env_checker=True, **arguments)
        elif "CartPole" in name:
            self.env = gym.make_vec(name, num_envs=count, vectorization_mode="vector_entry_point")
        else:
            self.env = gym.make_vec(name, num_envs=count, threads=threads, **arguments)
        self.single, frames = count == 1, 5 if "ActiveGaze" in name else 1  # of a step
        self.steps = 200 // frames
        self.frames = self.steps * frames * count
        self.env.action_space.seed(0)
        self.env.reset(seed=0)
        self.actions = [self.env.action_space.sample() for _ in range(16)]

    def run(self) -> None:
        """As many steps as an episode has."""
        for k in range(self.steps):
            _, _, terminated, truncated, _ = self.env.step(self.actions[k % 16])
            if self.single and (terminated or truncated):
                self.env.reset()


def rates(chosen: str, rounds: int, clock: Callable[[], float], threads: tuple[int, ...]) -> list[list[str]]:
    """Frames a second of all environments of each kind, and their ratio to CartPole's vector."""
    rows: list[list[str]] = []
    yardstick = Episodes(*KINDS["CartPole"])
    for label, (name, count, options) in KINDS.items():
        if chosen not in name:
            continue
        several = threads if count > 1 and name.startswith("StereoSlam") else (1,)
        episodes = {str(number): Episodes(name, count, options, number) for number in several}
        calls: dict[str, Callable[[], object]] = {"CartPole": yardstick.run}
        times = in_turns(calls | {key: each.run for key, each in episodes.items()}, 1 + rounds, clock=clock)
        found = {key: each.frames / min(times[key][1:]) for key, each in episodes.items()}
        for each in episodes.values():
            each.env.close()
        one = next(iter(found.values()))
        ratio = f"{found['2'] / one:.2f}" if "2" in found else ""
        by_yardstick = one * min(times["CartPole"][1:]) / yardstick.frames
        cells = [f"{found[str(number)]:,.0f}" if str(number) in found else "" for number in (1, 2)]
        rows.append([label, str(count), *cells, ratio, f"{by_yardstick:.2g}"])
    return rows


def beginnings(clock: Callable[[], float]) -> list[list[str]]:
    """Times of a reset, and memory of an environment in a vector."""
    rows = []
    for task in ("Drive", "Gaze"):
        single = gym.make(f"StereoSlam/{task}-v0").unwrapped
        vector: Any = gym.make_vec(f"StereoSlam/{task}-v0", num_envs=1).unwrapped
        row = [task]
        for env in (single, vector):
            env.reset(seed=0)
            taken = [in_turns({"": partial(env.reset, seed=seed)}, 1, clock=clock)[""][0] for seed in range(1, 13)]
            row.append(f"{1e3 * float(np.median(taken)):.1f}")
            env.close()
        rows.append([*row, f"{vector.nbytes / 2**20:.2f}"])
    return rows


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, only="", rounds=3, processor=False)
    clock, threads = (time.process_time, (1,)) if given.processor else (time.perf_counter, (1, 2))
    with threadpool_limits(1):
        rows, begun = rates(given.only, given.rounds, clock, threads), beginnings(clock)
    heads = ("", "environments", "one thread", "two threads", "ratio", "times CartPole's vector of 64")
    show(f"frames/s of all environments; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", heads, rows)
    heads = ("", "single", "in a vector", "MB")
    show("an episode begins: ms (median of 12); memory of an environment", heads, begun)


if __name__ == "__main__":
    main()
