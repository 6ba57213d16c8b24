"""What an inertial unit is worth on smooth drives: images alone, with wheels, with samples of three units, with both.

    python benchmarks/inertial_worth.py --landmarks 8      # a minute; 25 and 100 take longer

`stereo-slam bench --preset inertial` runs the same drives with all the figures of a report.
"""

from __future__ import annotations

import numpy as np

from harness import arguments, mean_and_error, show
from stereo_slam_env import evaluate
from stereo_slam_env.benchmark.recordings.inertial_problem import inertial_drive
from stereo_slam_env.sensing.imu import DATA_SHEETS

INERTIAL = {"motion": "strapdown"}


def main() -> None:
    """Rows of filters: position error, m, rotation error, mrad, NEES/6, over the drives."""
    given = arguments(__doc__, landmarks=[8, 25, 100], seeds=6)
    first = next(iter(DATA_SHEETS))
    jobs = [("right-invariant", {}, False, first), ("right-invariant", {}, True, first), ("msckf", {}, False, first)]
    jobs += [
        (name, options, wheels, sheet)
        for sheet in DATA_SHEETS
        for name, options, wheels in (("inertial", {}, False), ("inertial", {}, True), ("msckf", INERTIAL, False))
    ]
    for landmarks in given.landmarks:
        drives = {
            sheet: [inertial_drive(seed, landmarks=landmarks, imu=sheet) for seed in range(given.seeds)]
            for sheet in DATA_SHEETS
        }
        rows = []
        for name, options, wheels, sheet in jobs:
            runs = [evaluate(name, drive, gate=None, use_odometry=wheels, **options).figures for drive in drives[sheet]]
            inputs = ["wheels"] * wheels + [sheet] * (name == "inertial" or bool(options))
            rotation = [1000.0 * np.deg2rad(run.rotation_rmse_deg) for run in runs]
            nees = mean_and_error(np.array([run.pose_anees / 6.0 for run in runs]), 2)
            position = mean_and_error(np.array([run.position_rmse_m for run in runs]))
            rows.append([name, ", ".join(inputs) or "images alone", position, f"{np.mean(rotation):.1f}", nees])
        show(
            f"{landmarks} landmarks, {given.seeds} drives of 160 m",
            ["filter", "with", "position, m", "rotation, mrad", "NEES/6"],
            rows,
        )


if __name__ == "__main__":
    main()
