"""Memory of an environment over many episodes: it must not grow.

    python benchmarks/environment_memory.py                # 500 resets and 50,000 steps, some minutes
    python benchmarks/environment_memory.py --resets 50
    python benchmarks/environment_memory.py --env StereoSlam/Drive-v0 --kwargs '{"policy": "agent", "route": "town"}'

100 random actions with each seed; where an episode ends before, another one begins. Prints what the process holds (RSS)
on the way, its growth after the first tenth, and the slope of a straight line through it.
"""

from __future__ import annotations

import argparse
import gc
import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import stereo_slam_env  # noqa: F401 (registers the environments)

CHEAP = {"route": "straight", "policy": "route", "rig": "qvga"}
WANTED = 5.0
"""MB of growth at most."""


def resident_megabytes() -> float:
    """RSS of this process (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def drive(env: gym.Env[Any, Any], seed: int, steps: int) -> int:
    """So many steps of an episode (or more than one, where it ends before); the number of resets."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    resets = 1
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
            resets += 1
    return resets


def measure(env: gym.Env[Any, Any], seeds: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Resets so far and MB held after the steps with each seed; (seeds,) each."""
    resets, held = [], []
    for seed in range(seeds):
        resets.append(drive(env, seed, steps))
        gc.collect()
        held.append(resident_megabytes())
    return np.cumsum(resets), np.array(held)


def growth(held: np.ndarray) -> tuple[float, float]:
    """MB gained after the warm-up (the first tenth), and kB a seed by least squares."""
    after = held[len(held) // 10 :]
    slope = float(np.polyfit(np.arange(len(after)), after, 1)[0]) if len(after) > 1 else 0.0
    return float(after[-1] - after[0]), 1e3 * slope


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--env", default="StereoSlam/Drive-v0", help="id of the environment")
    parser.add_argument("--kwargs", type=json.loads, default=CHEAP, help="its arguments, as JSON")
    parser.add_argument("--resets", type=int, default=500, help="each with a new seed")
    parser.add_argument("--steps", type=int, default=100, help="after each")
    arguments = parser.parse_args()
    env = gym.make(arguments.env, disable_env_checker=True, **arguments.kwargs)
    with threadpool_limits(1):
        resets, held = measure(env, arguments.resets, arguments.steps)
    env.close()
    table = Table(title=f"{arguments.env} {json.dumps(arguments.kwargs)}")
    for head in ("resets", "steps", "process, MB"):
        table.add_column(head, justify="right")
    for k in np.unique(np.linspace(0, arguments.resets - 1, 11).astype(int)):
        table.add_row(f"{resets[k]:,}", f"{(k + 1) * arguments.steps:,}", f"{held[k]:.1f}")
    gained, slope = growth(held)
    console = Console(width=120)
    console.print(table)
    verdict = "met" if gained < WANTED else "not met"
    console.print(
        f"growth after the first tenth: {gained:.2f} MB (wanted: < {WANTED:.0f} MB, {verdict}); "
        f"slope {slope:.2f} kB a seed"
    )


if __name__ == "__main__":
    main()
