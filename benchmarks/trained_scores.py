"""Trainings of several seeds on scenes that no training and no choice of a network has seen.

Run it: for s in 0 1 2 3 4; do stereo-slam train --environment StereoSlam/Revisit-v0 --seed $s --out runs/$s; done
        python benchmarks/trained_scores.py runs/0 runs/1 runs/2 runs/3 runs/4
        python benchmarks/trained_scores.py runs/0 runs/1 runs/2 runs/3 runs/4 --episodes 200 --at-once 50

A row for each training, means over the episodes; below, the interquartile mean over the trainings with its 95 %
bootstrap interval over them, and what agents have that act at random, or do nothing (look straight ahead, or have
action 0). Seconds are those of the training, decisions those of the network that was kept. Maps of all episodes that
are driven at once are in memory: in `Branches-v0` some 25 MB each.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import bootstrap, trim_mean

from harness import arguments, show
from stereo_slam_env.envs import GazeTask
from stereo_slam_env.policies.named_policies import Network
from stereo_slam_env.policies.policy_rows import normalised_score
from stereo_slam_env.policies.ppo import LearningCurve, Task
from stereo_slam_env.policies.registered_task import RegisteredTask, evaluate

SEED = 300_000
"""The first one."""


def task_of(run: Path) -> Task:
    """What a training was about."""
    task = json.loads((run / "run.json").read_text(encoding="utf-8"))["task"]
    return GazeTask(**task) if "filter" in task else RegisteredTask(**task)


def results_of(network: Any, task: Task, episodes: int, at_once: int) -> dict[str, float]:
    """Means over the episodes, so many at once, with the score where there is one."""
    seeds = range(SEED, SEED + episodes)
    parts = [seeds[first : first + at_once] for first in range(0, episodes, at_once)]
    found = [asdict(evaluate(network, task, part)) for part in parts]
    weights = [len(part) for part in parts]
    means = {name: float(np.average([part[name] for part in found], weights=weights)) for name in found[0]}
    if isinstance(task, RegisteredTask) and task.is_scored:
        means["score"] = float(normalised_score(task.environment, means["validation_return"]))
    return means


class AtRandom:
    """In the place of a network: each action is as likely."""

    def __init__(self, task: Task) -> None:
        vector = task.make_vector(1)
        self._choices, self._shape = task.choices, vector.single_action_space.shape or ()
        self._rng = np.random.default_rng(SEED)
        vector.close()

    def actions(self, observations: Any) -> Any:
        """(B, n), as `Network.actions`."""
        count = len(next(iter(observations.values())))
        if self._choices is None:
            return self._rng.uniform(-1.0, 1.0, (count, *self._shape)).astype(np.float32)
        return self._choices[self._rng.integers(len(self._choices), size=count)]


def interval(values: Any) -> str:
    """Interquartile mean, and its 95 % bootstrap interval."""
    middle = partial(trim_mean, proportiontocut=0.25)
    low, high = bootstrap((values,), middle, method="percentile", rng=0).confidence_interval
    return f"{middle(values):.3g} [{low:.3g}, {high:.3g}]"


def main() -> None:
    """Run everything."""
    given = arguments(__doc__, "runs", runs=[Path], episodes=500, at_once=100)
    task, found, rows = task_of(given.runs[0]), [], []
    for run in given.runs:
        if task_of(run) != task:
            raise SystemExit(f"{run} is a training of something else than {given.runs[0]}")
        curve = LearningCurve(run / "learning_curve.csv")
        found.append(results_of(Network.load(run / "policy.npz"), task, given.episodes, given.at_once))
        made = [f"{curve.best['decisions']:.0f}", f"{curve.seconds:.0f}"]
        rows.append([run.name, *(f"{value:.3g}" for value in found[-1].values()), *made])
    columns = {name: np.array([row[name] for row in found]) for name in found[0]}
    if len(found) > 1:
        rows.append(["interquartile mean", *map(interval, columns.values()), "", ""])
    for label, agent in {"at random": AtRandom(task), "does nothing": None}.items():
        has = results_of(agent, task, given.episodes, given.at_once)
        rows.append([label, *(f"{has[name]:.3g}" for name in columns), "", ""])
    show(f"{task.environment}, {given.episodes} episodes", ("training", *columns, "decisions", "s"), rows)


if __name__ == "__main__":
    main()
