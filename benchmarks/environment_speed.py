"""How fast an environment is: alone on one core, in vectors over processes, and in native vectors.

    python benchmarks/environment_speed.py                     # two minutes
    python benchmarks/environment_speed.py --env StereoSlam/Drive-v0 --kwargs '{"policy": "agent"}' --json speed.json

First table: one environment, this process pinned to one core, processor time. The same episode is driven several times
and the least time of each step counts: what it takes on an idle machine; "median" is what other processes left of it.
"Bare PyBullet" is what the calls of rayTestBatch, performCollisionDetection and the like took in these very steps, so
that the share holds on a busy machine, too. "With a filter in the loop" is `FilterInTheLoop` below, as somebody who
trains an agent on a filter's belief would have it.

Second table: vectors of environments, all cores, every environment on the same episode, so that it is the same work.
They take turns, some steps of each at a time; of each the quickest tenth of its turns counts, since in the others
somebody else had the cores.

Third table (`--native` alone: two minutes): native vectors on one thread and on two, mean over whole episodes, the best
of three; then what it takes to begin an episode, and memory of an environment.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

import stereo_slam_env  # noqa: F401 (registers the environments)
from filters import make_filter
from stereo_slam_env.world.physics import pybullet
from stereo_slam_env.world.routes import FRAME_PERIOD

DENSE = {"policy": "route", "max_landmarks": 100, "refill_below": 100}
"""100 landmarks in every frame; the scene of the route "town" has some 180 bodies of 1400 solids."""
IN_A_STEP = (
    "rayTestBatch",
    "performCollisionDetection",
    "resetBasePositionAndOrientation",
    "getContactPoints",
    "getAABB",
    "getOverlappingObjects",
)
FIRST_STEPS = 20  # not measured: caches are cold
BURST = 10  # steps of a vector in a row
QUICKEST = 0.1


class FilterInTheLoop(gym.Wrapper[Any, Any, Any, Any]):
    """Runs a filter on what the environment measures."""

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Reset both."""
        result = self.env.reset(**arguments)
        drive = self.env.unwrapped
        self.slam = make_filter("shared-anchor", camera=drive.camera, noise=drive.noise)
        self.slam.reset(drive.start)
        self.slam.update(drive.frame.observation)
        return result

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step both."""
        result = self.env.step(action)
        frame = self.env.unwrapped.frame
        self.slam.predict(FRAME_PERIOD, frame.odometry)
        self.slam.update(frame.observation)
        return result


class BareCalls:
    """Time spent inside some functions of PyBullet, s, and how often they were called."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.seconds, self.count = 0.0, 0
        self._originals = {name: getattr(pybullet, name) for name in names}

    def __enter__(self) -> BareCalls:
        for name, function in self._originals.items():
            setattr(pybullet, name, self._timed(function))
        return self

    def __exit__(self, *_: object) -> None:
        for name, function in self._originals.items():
            setattr(pybullet, name, function)

    def _timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            began = time.process_time()
            result = function(*arguments, **options)
            self.seconds += time.process_time() - began
            self.count += 1
            return result

        return call


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this process to one core meanwhile (Linux)."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def made(name: str, options: dict[str, Any], wrappers: tuple[Callable[..., Any], ...] = ()) -> gym.Env[Any, Any]:
    """The environment, wrapped."""
    env = gym.make(name, disable_env_checker=True, **options)
    for wrapper in wrappers:
        env = wrapper(env)
    return env


def idle(space: gym.spaces.Box) -> np.ndarray:
    """An action that does nothing."""
    return np.zeros(space.shape, dtype=space.dtype)


def measure_steps(env: gym.Env[Any, Any], steps: int, rounds: int) -> dict[str, float]:
    """Seconds of a step, undisturbed and typical; of the bare calls in it; landmarks in a frame."""
    action = idle(env.action_space)
    whole, bare = np.zeros((2, rounds, steps))
    landmarks = 0
    for k in range(rounds):
        env.reset(seed=0)
        for _ in range(FIRST_STEPS):
            env.step(action)
        for i in range(steps):
            with BareCalls(IN_A_STEP) as calls:
                began = time.process_time()
                observation = env.step(action)[0]
                whole[k, i] = time.process_time() - began
            bare[k, i] = calls.seconds
            landmarks += int(observation["mask"].sum())
    return {
        "step": float(whole.min(axis=0).mean()),
        "median": float(np.median(whole, axis=0).mean()),
        "bare": float(bare.min(axis=0).mean()),
        "landmarks": landmarks / (rounds * steps),
    }


def measure_resets(env: gym.Env[Any, Any], resets: int) -> dict[str, float]:
    """Seconds of a reset, the quickest and the median of several scenes; bodies of a scene."""
    with BareCalls(("createMultiBody",)) as calls:
        times = []
        for seed in range(resets):
            began = time.process_time()
            env.reset(seed=seed)
            times.append(time.process_time() - began)
    return {"reset": min(times), "reset_median": float(np.median(times)), "bodies": calls.count / resets}


def measure_vectors(vectors: dict[str, gym.vector.VectorEnv], turns: int) -> dict[str, float]:
    """Steps of single environments a second, of each vector."""
    for vector in vectors.values():
        vector.reset(seed=[0] * vector.num_envs)
        for _ in range(FIRST_STEPS):
            vector.step(idle(vector.action_space))
    times: dict[str, list[float]] = {name: [] for name in vectors}
    for _ in range(turns):
        for name, vector in vectors.items():
            action = idle(vector.action_space)
            began = time.perf_counter()
            for _ in range(BURST):
                vector.step(action)
            times[name].append(time.perf_counter() - began)
    return {name: BURST * vectors[name].num_envs / float(np.quantile(times[name], QUICKEST)) for name in vectors}


def vector_rates(name: str, options: dict[str, Any], wrappers: tuple[Any, ...], turns: int) -> dict[str, float]:
    """`measure_vectors` of one after another, and of one and two processes."""
    kinds = {
        "sync, 2 in this process": ("sync", 2),
        "async, 1 process": ("async", 1),
        "async, 2 processes": ("async", 2),
    }
    vectors: dict[str, gym.vector.VectorEnv] = {}
    try:
        for label, (mode, count) in kinds.items():
            vectors[label] = gym.make_vec(
                name, num_envs=count, vectorization_mode=mode, wrappers=wrappers, disable_env_checker=True, **options
            )
        return measure_vectors(vectors, turns)
    finally:
        for vector in vectors.values():
            vector.close()


NATIVE = {
    "Gaze, scenes from a pool": ("Gaze", 256, {"scenes": 64}),
    "Gaze, a new scene for every episode": ("Gaze", 256, {}),
    "Drive on its route, 100 landmarks": ("Drive", 64, {**DENSE, "scenes": 8}),
    "Drive by an agent that crashes, scenes from a pool": ("Drive", 64, {"scenes": 64}),
    "Drive by an agent that crashes, new scenes": ("Drive", 64, {}),
    "ActiveGaze, scenes from a pool": ("ActiveGaze", 64, {"scenes": 64}),
    "ActiveGaze, a new scene for every episode": ("ActiveGaze", 64, {}),
}
"""Native vectors: task, number of environments, arguments."""


def native_rate(task: str, count: int, arguments: dict[str, Any], threads: int) -> float:
    """Frames a second of all environments, over whole episodes: the best of three, after one."""
    env = gym.make_vec(f"StereoSlam/{task}-v0", num_envs=count, threads=threads, **arguments)
    env.action_space.seed(0)
    frames = 5 if task == "ActiveGaze" else 1  # of a step
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(16)]
    steps = 200 // frames  # an episode, and the step that resets it
    times = []
    for _ in range(4):
        began = time.perf_counter()
        for k in range(steps):
            env.step(actions[k % 16])
        times.append(time.perf_counter() - began)
    env.close()
    return count * frames * steps / min(times[1:])


def native_table() -> Table:
    """Frames a second of native vectors."""
    table = Table(title=f"native vectors: frames/s of all environments; load {os.getloadavg()[0]:.1f}")
    for head in ("", "environments", "one thread", "two threads", "ratio"):
        table.add_column(head, justify="left" if not head else "right")
    for label, (task, count, arguments) in NATIVE.items():
        rates = [native_rate(task, count, arguments, threads) for threads in (1, 2)]
        table.add_row(label, str(count), *(f"{rate:,.0f}" for rate in rates), f"{rates[1] / rates[0]:.2f}")
    return table


def scene_seconds() -> Table:
    """Times of a reset, and memory of an environment in a vector."""
    table = Table(title="an episode begins: ms (median of 12); memory of an environment")
    for head in ("", "single", "in a vector", "MB"):
        table.add_column(head, justify="left" if not head else "right")
    for task in ("Drive", "Gaze"):
        times = []
        single = gym.make(f"StereoSlam/{task}-v0").unwrapped
        vector = gym.make_vec(f"StereoSlam/{task}-v0", num_envs=1).unwrapped
        for env in (single, vector):
            env.reset(seed=0)
            each = []
            for seed in range(1, 13):
                began = time.perf_counter()
                env.reset(seed=seed)
                each.append(time.perf_counter() - began)
            env.close()
            times.append(f"{1e3 * float(np.median(each)):.1f}")
        table.add_row(task, *times, f"{vector.nbytes / 2**20:.2f}")
    return table


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--env", default="StereoSlam/Drive-v0", help="id of the environment")
    parser.add_argument("--kwargs", type=json.loads, default={}, help="its arguments beyond 100 landmarks, as JSON")
    parser.add_argument("--steps", type=int, default=200, help="of an episode, at most those of the route")
    parser.add_argument("--rounds", type=int, default=7, help="how often the episode is driven")
    parser.add_argument("--turns", type=int, default=100, help="of each vector")
    parser.add_argument("--native", action="store_true", help="only the table of native vectors")
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    arguments = parser.parse_args()
    if arguments.native:
        Console(width=120).print(native_table(), scene_seconds())
        return
    options = {**DENSE, **arguments.kwargs}
    kinds: dict[str, tuple[Any, ...]] = {"environment": (), "with a filter in the loop": (FilterInTheLoop,)}

    figures: dict[str, dict[str, float]] = {}
    with threadpool_limits(1), one_core():
        for label, wrappers in kinds.items():
            env = made(arguments.env, options, wrappers)
            figures[label] = measure_steps(env, arguments.steps, arguments.rounds)
            if not wrappers:
                figures[label] |= measure_resets(env, arguments.rounds)
            env.close()
    with threadpool_limits(1):
        rates = {label: vector_rates(arguments.env, options, w, arguments.turns) for label, w in kinds.items()}

    load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
    alone = Table(title=f"{arguments.env}, one core; {load}")
    for head in ("", "steps/s", "ms a step", "median, ms", "bare PyBullet", "landmarks", "bodies", "reset, s (median)"):
        alone.add_column(head, justify="left" if not head else "right")
    for label, seconds in figures.items():
        reset = f"{seconds['reset']:.2f} ({seconds['reset_median']:.2f})" if "reset" in seconds else ""
        alone.add_row(
            label,
            f"{1.0 / seconds['step']:.0f}",
            f"{1e3 * seconds['step']:.2f}",
            f"{1e3 * seconds['median']:.2f}",
            f"{100 * seconds['bare'] / seconds['step']:.0f} %",
            f"{seconds['landmarks']:.0f}",
            f"{seconds['bodies']:.0f}" if "bodies" in seconds else "",
            reset,
        )
    together = Table(title="vectors: steps/s of all environments (ratio to one process)")
    for head in ("", *next(iter(rates.values()))):
        together.add_column(head, justify="left" if not head else "right")
    for label, found in rates.items():
        one = found["async, 1 process"]
        together.add_row(label, *(f"{rate:.0f} ({rate / one:.2f})" for rate in found.values()))
    for table in (alone, together, native_table(), scene_seconds()):
        Console(width=120).print(table)
    if arguments.json:
        summary = {
            "environment": arguments.env,
            "arguments": options,
            "one_core_seconds": figures,
            "steps_a_second": rates,
        }
        arguments.json.write_text(json.dumps(summary, indent=2) + "\n")


if __name__ == "__main__":
    main()
