"""The monocular inertial window, `msckf` with `measurement="left"`, with its gate and without.

python benchmarks/monocular_inertial.py flights               # 20 flights of 15 s, three minutes
python benchmarks/monocular_inertial.py drives --frames 200
"""

from __future__ import annotations

import numpy as np

from harness import arguments, show
from stereo_slam_env import evaluate
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_drive, inertial_flight

PROBLEMS = {"flights": inertial_flight, "drives": inertial_drive}
OPTIONS = {"motion": "strapdown", "measurement": "left", "map_landmarks": 0}
LOST, FALSE = 10.0, 10.0
"""Position error, m, of a run that has diverged, and NEES/6 of one whose claim is false."""


def main() -> None:
    """Rows of gates: median and largest position error, m, median NEES/6, runs that are lost or false."""
    given, rows = arguments(__doc__, "problem", problem=tuple(PROBLEMS), seeds=20, frames=150, landmarks=40), []
    recordings = [
        PROBLEMS[given.problem](seed, frames=given.frames, landmarks=given.landmarks) for seed in range(given.seeds)
    ]
    for gate in (0.99, None):
        runs = [evaluate("msckf", one, gate=gate, use_odometry=False, **OPTIONS).figures for one in recordings]
        errors, nees = np.array([(run.position_rmse_m, run.pose_anees / 6.0) for run in runs]).T
        cells = f"{np.median(errors):.2f}", f"{errors.max():.2f}", f"{np.median(nees):.1f}"
        rows.append([str(gate), *cells, str(np.sum(errors > LOST)), str(np.sum(nees > FALSE))])
    show(
        f"{given.seeds} {given.problem} of {given.frames / 10:.0f} s",
        ["gate", "median error, m", "largest", "NEES/6", "lost", "false"],
        rows,
    )


if __name__ == "__main__":
    main()
