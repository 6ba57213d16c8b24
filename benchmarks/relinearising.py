"""Consistency of a head that looks around, by what the update relinearises: nothing, all, or what its tangent misses.

    python benchmarks/relinearising.py                      # 64 drives, two rigs and worlds, straight on and sweeping
    python benchmarks/relinearising.py --drives 256 --first-seed 500000

NEES / 3 of the position at the end with the band of a consistent filter, the signed error along the road by its claim
(a bias where it is beyond 4 over the root of the drives), and the mean error.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from filters import nees
from filters.geometry.arrays import FloatArray
from harness import arguments, show
from stereo_slam_env.envs import GazeTask
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.policies import make_policy
from stereo_slam_env.policies.policy_rows import policy_in_rows
from stereo_slam_env.sensing.padding import TrackingPolicy

RIG = {"fx": 400.0, "fy": 400.0, "cx": 319.5, "cy": 199.5, "width": 640, "height": 400}
WORLDS: dict[str, dict[str, Any]] = {
    "groves": {},
    "clear street": {"surroundings": "street", "visibility": TrackingPolicy.farthest},
}
UPDATES: dict[str, dict[str, Any]] = {
    "one pass": {"iterations": 1},
    "two passes": {"iterations": 2, "relinearise_above": 0.0},
    "two where bent": {"iterations": 2, "relinearise_above": 1.0},
}


def ends(
    world: str, baseline: float, policy: str, options: dict[str, Any], drives: int, first_seed: int
) -> tuple[FloatArray, ...]:
    """Position errors (N, 3), m, and their claimed covariances (N, 3, 3) at the ends of the drives."""
    task = GazeTask(arguments={"rig": {**RIG, "baseline": baseline}, **WORLDS[world]}, pans=None, hold=1)
    task = replace(task, filter_options={**task.filter_options, **options})
    vector, seeds = task.make_vector(drives), range(first_seed, first_seed + drives)
    try:
        beliefs = vector.rows.get_attr("beliefs")
        observation, info = vector.reset(seed=list(seeds))
        act = policy_in_rows(vector, partial(make_policy, policy), seeds)
        going = np.ones(drives, dtype=bool)
        errors, covariances = np.zeros((drives, 3)), np.zeros((drives, 3, 3))
        while going.any():
            observation, _, terminated, truncated, info = vector.advance(act(observation, going), going)
            ended = going & (terminated | truncated)
            errors[ended] = (info["truth_position"] - beliefs.poses[:, :3])[ended]
            covariances[ended] = np.array(beliefs.pose_covariances)[ended, :3, :3]
            going &= ~ended
    finally:
        vector.close()
    return errors, covariances


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, drives=64, first_seed=910_000)
    low, high = (end / 3.0 for end in mean_band(3, given.drives))
    rows = []
    for world, baseline, policy in product(WORLDS, (0.57, 0.12), ("fixed", "sweep")):
        for name, options in UPDATES.items():
            errors, P = ends(world, baseline, policy, options, given.drives, given.first_seed)
            signed = float(np.mean(errors[:, 2] / np.sqrt(P[:, 2, 2])))
            size = float(np.linalg.norm(errors, axis=1).mean())
            figures = f"{nees(errors, P).mean() / 3:.2f}", f"{signed:+.2f}", f"{size:.3f}"
            rows.append((f"{world}, {baseline:g} m, {policy}", name, *figures))
    heads = (
        "world, rig, policy",
        "update",
        f"NEES / 3 ({low:.2f}–{high:.2f})",
        "signed error ahead, σ",
        "mean error, m",
    )
    show(f"{given.drives} drives from seed {given.first_seed}", heads, rows)


if __name__ == "__main__":
    main()
