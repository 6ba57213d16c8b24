"""Does looking well help, by the truth? Policies in `ActiveGaze-v0`, claim beside truth and consistency.

    python benchmarks/active_policies.py                                    # 500 drives, white errors
    python benchmarks/active_policies.py --world lasting --belief coloured-noise --options '{"landmark": "euclidean"}'
    python benchmarks/active_policies.py --policies fixed,oracle --drives 64
    python benchmarks/active_policies.py --policies fixed,sweep --level hard

For each policy, in the same drives: change against `fixed` of the mean true final error, of its root mean square over
the drive and of the claimed sigma, paired, with 95 % bootstrap intervals; mean log det of the final pose, position
NEES / 3, score (0 is `fixed`, 100 the oracle, by the return of minus squared true error) and processor seconds. Worlds
are those of `envs.make_vec.WORLDS`; options of the belief come on top of those of `GazeTask`. A policy is a name, or a
checkpoint of `stereo-slam train`.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from harness import arguments, show
from stereo_slam_env.envs.active_gaze import GazeTask
from stereo_slam_env.envs.make_vec import LEVELS, WORLDS
from stereo_slam_env.policies import make_policy
from stereo_slam_env.policies.policy_rows import Oracle, TrueFigures, normalised_score, policy_in_rows, true_figures

SEED = 200_000
"""The first one: nothing was tuned or chosen on these."""
ID = "StereoSlam/ActiveGaze-v0"


def figures_of(policy: str, task: GazeTask, seeds: Sequence[int]) -> TrueFigures:
    """The episodes of a policy, all at once; returns are those of `TrueError`."""
    if policy == "oracle":
        vector = task.make_vector(len(seeds))
        oracle = Oracle(vector.rows)
        made = true_figures(vector, lambda _: lambda __, going: oracle.act(going), seeds)
        vector.close()
        return made
    checkpoint = {"checkpoint": policy} if policy.endswith(".npz") else {}
    make = partial(make_policy, "ppo" if checkpoint else policy, **checkpoint)
    every_step = replace(task, pans=None, hold=1)
    vector = every_step.make_vector(len(seeds))
    made = true_figures(vector, lambda _: policy_in_rows(vector, make, seeds), seeds)
    vector.close()
    return replace(made, returns=made.returns / task.hold)


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
    seeds = range(given.seed, given.seed + given.drives)
    world = {**WORLDS[given.world], **LEVELS[given.level]}
    task = GazeTask(arguments=world, filter=given.belief, reward="error")
    task = replace(task, filter_options={**task.filter_options, **given.options})
    belief = " ".join([given.belief, *(f"{name}={value}" for name, value in given.options.items())])
    about_all = f"{given.world}, {given.level}, {belief}, {given.drives} drives"
    rows, kept, base = [], [], None
    for policy in given.policies.split(","):
        began = time.process_time()
        figures = figures_of(policy, task, seeds)
        base = base or figures
        names = "final_position_error_m", "position_rmse_m", "final_position_sigma_m"
        changes = [change(getattr(figures, name), getattr(base, name)) for name in names]
        means = dict(zip([part.name for part in fields(figures)], figures.table.mean(axis=0), strict=True))
        label = Path(policy).parent.name if policy.endswith(".npz") else policy
        score = normalised_score(ID, figures.returns).mean()
        rows.append(
            [
                label,
                f"{means['final_position_error_m']:.3f}",
                *(text for text, _ in changes),
                f"{means['final_pose_logdet']:.1f}",
                f"{means['final_position_nees']:.2f}",
                f"{means['returns']:.2f}",
                f"{score:.0f}" if task == GazeTask(arguments=dict(WORLDS["white"])) else "",
                f"{time.process_time() - began:.0f}",
            ]
        )
        claimed = dict(zip(("claimed", "claimed_low", "claimed_high"), changes[2][1], strict=True))
        true = dict(zip(("true", "true_low", "true_high"), changes[0][1], strict=True))
        about = {"world": given.world, "belief": belief, "policy": label, "drives": given.drives}
        kept.append({**about, **means, **true, **claimed})
        with given.out.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(kept[0]))
            writer.writeheader()
            writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()} for row in kept)
        show(about_all, HEADS, rows[-1:])
    show(about_all, HEADS, rows)


HEADS = (
    *("policy", "true end error, m", "end error, %", "rmse, %", "claimed sigma, %"),
    *("claimed log det", "NEES / 3", "return", "score", "s"),
)


if __name__ == "__main__":
    main()
