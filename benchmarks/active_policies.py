"""Does looking well help, by the truth? Policies in `ActiveGaze-v0`, claim beside truth and consistency.

    python benchmarks/active_policies.py                                    # 500 drives, the world of the task
    python benchmarks/active_policies.py --world all --drives 200 --policies fixed,sweep,ppo      # where it helps
    python benchmarks/active_policies.py --policies fixed,1-7x2,2-6x4,3-5x3            # blind schedules of directions
    python benchmarks/active_policies.py --world lasting --belief coloured-noise --options '{"landmark": "euclidean"}'
    python benchmarks/active_policies.py --policies fixed,oracle --drives 64
    python benchmarks/active_policies.py --policies fixed,sweep --level hard

For each policy, in the same drives: change against the first one of the mean true final error, of its root mean square
over the drive and of the claimed sigma, paired, with 95 % bootstrap intervals; mean log det of the final pose, position
NEES / 3, score with its paired interval (0 is `fixed`, 100 the oracle, by the return of minus squared true error) and
processor seconds. Worlds are those of `envs.task_env.WORLDS`; options of the belief come on top of those of `GazeTask`.
A policy is a name, a checkpoint of `stereo-slam train`, or "a-bxn": directions a and b of nine in turn, each for n
decisions.
"""

from __future__ import annotations

import csv
import re
import time
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from harness import arguments, show
from stereo_slam_env.envs.active_gaze import GazeTask
from stereo_slam_env.envs.task_env import LEVELS, WORLDS
from stereo_slam_env.policies import make_policy
from stereo_slam_env.policies.policy_rows import Oracle, TrueFigures, paired_score, policy_in_rows, true_figures

SEED = 200_000
"""The first one: nothing was tuned or chosen on these."""
ID = "StereoSlam/ActiveGaze-v0"


def figures_of(policy: str, task: GazeTask, seeds: Sequence[int]) -> TrueFigures:
    """The episodes of a policy, all at once; returns are those of `TrueError`."""
    schedule = re.fullmatch(r"(\d)-(\d)x(\d+)", policy)
    if schedule or policy == "oracle":
        vector = task.make_vector(len(seeds))
        choose: Any = partial(blind, *map(int, schedule.groups())) if schedule else partial(look_ahead, vector)
        made = true_figures(vector, lambda _: choose(), seeds)
        vector.close()
        return made
    checkpoint = {"checkpoint": policy} if policy.endswith(".npz") else {}
    make = partial(make_policy, "ppo" if checkpoint else policy, **checkpoint)
    every_step = replace(task, pans=None, hold=1)
    vector = every_step.make_vector(len(seeds))
    made = true_figures(vector, lambda _: policy_in_rows(vector, make, seeds), seeds)
    vector.close()
    return replace(made, returns=made.returns / task.hold)


def blind(first: int, second: int, decisions: int) -> Any:
    """Two directions in turn, whatever is seen."""
    steps = count()
    return lambda _, going: np.full(len(going), (first, second)[next(steps) // decisions % 2])


def look_ahead(vector: Any) -> Any:
    """The oracle of a vector."""
    oracle = Oracle(vector.rows, depth=6)  # the head takes nearly seven seconds from side to side
    return lambda _, going: oracle.act(going)


def change(of: np.ndarray, against: np.ndarray) -> tuple[str, tuple[float, float, float]]:
    """Change of the mean, paired, % and its 95 % interval."""

    def ratio(a: np.ndarray, b: np.ndarray, axis: int = -1) -> Any:
        return 100.0 * (a.mean(axis=axis) / b.mean(axis=axis) - 1.0)

    if np.array_equal(of, against):
        return "", (0.0, 0.0, 0.0)
    found = bootstrap((of, against), ratio, paired=True, method="percentile", n_resamples=2000, rng=0)
    low, high = found.confidence_interval
    value = float(ratio(of, against))
    return f"{value:+.0f} [{low:+.0f}, {high:+.0f}]", (value, float(low), float(high))


def main() -> None:
    """Run everything."""
    given = arguments(
        __doc__,
        drives=500,
        seed=SEED,
        world="white",
        level=("normal", "easy", "hard"),
        belief="shared-anchor",
        options={},
        policies="fixed,random,sweep,greedy,lookahead,ppo",
        out=Path("active_policies.csv"),
    )
    worlds = list(WORLDS) if given.world == "all" else [given.world]
    kept: list[dict[str, Any]] = []
    for world in worlds:
        rows = rows_of(world, given, kept)
        with given.out.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(kept[0]))
            writer.writeheader()
            writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in kept)
        show(f"{world}, {given.level}, {given.belief}, {given.drives} drives", HEADS, rows)


def rows_of(world: str, given: Any, kept: list[dict[str, Any]]) -> list[list[str]]:
    """Rows of the policies in a world; their figures come to those that are kept."""
    seeds = range(given.seed, given.seed + given.drives)
    own = GazeTask(arguments={**WORLDS[world], **LEVELS[given.level]}, filter=given.belief, reward="error")
    task = replace(own, filter_options={**own.filter_options, **given.options})
    belief = " ".join([given.belief, *(f"{name}={value}" for name, value in given.options.items())])
    rows: list[list[str]] = []
    base: TrueFigures | None = None
    for policy in given.policies.split(","):
        began = time.process_time()
        figures = figures_of(policy, task, seeds)
        base = base or figures
        names = "final_position_error_m", "position_rmse_m", "final_position_sigma_m"
        changes = [change(getattr(figures, name), getattr(base, name)) for name in names]
        means = dict(zip([part.name for part in fields(figures)], figures.table.mean(axis=0), strict=True))
        label = Path(policy).parent.name if policy.endswith(".npz") else policy
        score, low, high = paired_score(ID, figures.returns, base.returns)
        rows.append(
            [
                label,
                f"{means['final_position_error_m']:.3f}",
                *(text for text, _ in changes),
                f"{means['final_pose_logdet']:.1f}",
                f"{means['final_position_nees']:.2f}",
                f"{means['returns']:.2f}",
                f"{score:.0f} [{low:.0f}, {high:.0f}]" if world == "white" and given.level == "normal" else "",
                f"{time.process_time() - began:.0f}",
            ]
        )
        claimed = dict(zip(("claimed", "claimed_low", "claimed_high"), changes[2][1], strict=True))
        true = dict(zip(("true", "true_low", "true_high"), changes[0][1], strict=True))
        about = {"world": world, "belief": belief, "policy": label, "drives": given.drives}
        kept.append({**about, **means, **true, **claimed})
    return rows


HEADS = (
    *("policy", "true end error, m", "end error, %", "rmse, %", "claimed sigma, %"),
    *("claimed log det", "NEES / 3", "return", "score", "s"),
)


if __name__ == "__main__":
    main()
