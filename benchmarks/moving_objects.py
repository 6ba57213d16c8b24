"""What moving cars do to the trajectory: the same drives without and with them, measured in rendered images.

    python benchmarks/moving_objects.py                        # 10 seeds of the right turn by gl, about 10 minutes
    python benchmarks/moving_objects.py --seeds 3 --frames 60 --route straight --cars 20

For each seed the drive is rendered without traffic and with it. The third column leaves out, by the truth of the
render, every landmark that lies on a car: what a perfect detector would reach in the same pictures, in which cars also
hide a part of the street. The last line compares the root mean squares over all seeds.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from harness import arguments, show
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
    given = arguments(__doc__, route="right-turn", renderer="gl", cars=12, seeds=10, frames=80, filter="inverse-depth")
    street = {"route": given.route, "sensor": "images", "renderer": given.renderer}
    traffic = {**street, "moving_cars": given.cars}
    squares, shares, rows = [], [], []
    for seed in range(given.seeds):
        quiet = record(street, seed, given.frames)
        busy = record(traffic, seed, given.frames)
        on_cars, share = moving_ids(traffic, seed, given.frames)
        errors = [position_errors(r, given.filter) for r in (quiet, busy, without(busy, on_cars))]
        used = [np.isin(f.observation.ids, on_cars).mean() if len(f.observation) else 0.0 for f in busy.frames]
        squares.append([[np.mean(e**2), e[-1] ** 2] for e in errors])
        shares.append((share, np.mean(used)))
        cells = [f"{np.sqrt(np.mean(e**2)):.4f} / {e[-1]:.4f}" for e in errors]
        rows.append((str(seed), *cells, f"{share:.0%}", f"{np.mean(used):.1%}"))
    rms = np.sqrt(np.mean(squares, axis=0))
    share, used_share = np.mean(shares, axis=0)
    rows.append(("all", *(f"{a:.4f} / {b:.4f}" for a, b in rms), f"{share:.0%}", f"{used_share:.1%}"))
    cars = f"{given.cars} cars"
    heads = ("seed", "no cars", cars, "cars, perfect detector", "corners on cars", "given to filter")
    show(f"position rmse / end error, m: {given.filter}, {given.route}, {given.frames} frames", heads, rows)
    growth = rms[1] / rms[0] - 1, rms[1] / rms[2] - 1
    print(
        f"growth of rmse / end error: {growth[0][0]:+.0%} / {growth[0][1]:+.0%} against no cars, "
        f"{growth[1][0]:+.0%} / {growth[1][1]:+.0%} against the perfect detector"
    )


if __name__ == "__main__":
    main()
