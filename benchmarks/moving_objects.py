"""What moving cars do to the trajectory: the same drives without and with them, measured in rendered images.

    python benchmarks/moving_objects.py                        # 10 seeds of the right turn by gl, about 10 minutes
    python benchmarks/moving_objects.py --seeds 3 --frames 60 --route straight --cars 20

For each seed the drive is rendered without traffic and with it. The third column leaves out, by the truth of the
render, every landmark that lies on a car: what a perfect detector would reach in the same pictures, in which cars also
hide a part of the street. The last line compares the root mean squares over all seeds.
"""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from stereo_slam_env.envs.drive import StereoDriveEnv
from stereo_slam_env.envs.recorder import record
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.recording.recording import Recording

OPTIONS: dict[str, Any] = {
    "gate": 0.99,
    "consensus": True,
    "motion": {"sigma_acceleration": 3.0, "sigma_angular_acceleration": 0.6},
}


def moving_ids(arguments: dict[str, Any], seed: int, frames: int) -> tuple[np.ndarray, float]:
    """Ids of corners that are truly on cars, and their share of all corners."""
    env = StereoDriveEnv(**arguments, policy="route")
    try:
        env.reset(seed=seed)
        corners = len(env.tracked.corners)
        for _ in range(frames - 1):
            env.step(np.zeros(2, dtype=np.float32))
            corners += len(env.tracked.corners)
        return env.moving_ids, len(env.moving_ids) / corners
    finally:
        env.close()


def without(recording: Recording, ids: np.ndarray) -> Recording:
    """The recording without the measurements of some landmarks."""
    frames = tuple(
        dataclasses.replace(f, observation=f.observation.select(~np.isin(f.observation.ids, ids)))
        for f in recording.frames
    )
    return dataclasses.replace(recording, frames=frames)


def position_errors(recording: Recording, name: str) -> np.ndarray:
    """Distance from the truth in each frame, m."""
    run = run_filter(recording, name, common_options=OPTIONS)
    return np.linalg.norm(run.positions - run.true_positions, axis=1)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--route", default="right-turn")
    parser.add_argument("--renderer", default="gl")
    parser.add_argument("--cars", type=int, default=12)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--frames", type=int, default=80)
    parser.add_argument("--filter", default="inverse-depth")
    chosen = parser.parse_args()
    street = {"route": chosen.route, "sensor": "images", "renderer": chosen.renderer}
    traffic = {**street, "moving_cars": chosen.cars}

    table = Table(title=f"position rmse / end error, m: {chosen.filter}, {chosen.route}, {chosen.frames} frames")
    for heading in (
        "seed",
        "no cars",
        f"{chosen.cars} cars",
        "cars, perfect detector",
        "corners on cars",
        "given to filter",
    ):
        table.add_column(heading, justify="right")
    squares, shares = [], []
    for seed in range(chosen.seeds):
        quiet = record(street, seed, chosen.frames)
        busy = record(traffic, seed, chosen.frames)
        on_cars, share = moving_ids(traffic, seed, chosen.frames)
        errors = [position_errors(r, chosen.filter) for r in (quiet, busy, without(busy, on_cars))]
        given = [np.isin(f.observation.ids, on_cars).mean() if len(f.observation) else 0.0 for f in busy.frames]
        squares.append([[np.mean(e**2), e[-1] ** 2] for e in errors])
        shares.append((share, np.mean(given)))
        cells = [f"{np.sqrt(np.mean(e**2)):.4f} / {e[-1]:.4f}" for e in errors]
        table.add_row(str(seed), *cells, f"{share:.0%}", f"{np.mean(given):.1%}")
    rms = np.sqrt(np.mean(squares, axis=0))
    cells = [f"{a:.4f} / {b:.4f}" for a, b in rms]
    table.add_row("all", *cells, f"{np.mean(shares, axis=0)[0]:.0%}", f"{np.mean(shares, axis=0)[1]:.1%}")
    Console().print(table)
    growth = rms[1] / rms[0] - 1, rms[1] / rms[2] - 1
    Console().print(
        f"growth of rmse / end error: {growth[0][0]:+.0%} / {growth[0][1]:+.0%} against no cars, "
        f"{growth[1][0]:+.0%} / {growth[1][1]:+.0%} against the perfect detector"
    )


if __name__ == "__main__":
    main()
