"""Learning curves of several trainings in one picture, and when each was as good as a given policy.

Run it: for seed in 0 1 2 3 4; do stereo-slam train --seed $seed --out runs/$seed; done
        python benchmarks/learning_curves.py runs/0 runs/1 runs/2 runs/3 runs/4 --out learning_curve.png

It takes some eight minutes of two cores. Log det is that of the final pose, on the validation episodes.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

from harness import arguments
from stereo_slam_env.report.charts.policies import plot_learning
from stereo_slam_env.training.ppo import VALIDATION_SEEDS, LearningCurve, merit
from stereo_slam_env.training.task import GazeTask, evaluate


def main() -> None:
    """Print and draw."""
    given = arguments(__doc__, "runs", runs=[Path], log_det=-41.7, out=Path("learning_curve.png"))
    curves = [LearningCurve(run / "learning_curve.csv").rows for run in given.runs]
    for run, rows in zip(given.runs, curves, strict=True):
        best = max(rows, key=merit)
        reached = next((row["seconds"] for row in rows if row["final_pose_logdet"] <= given.log_det), float("nan"))
        print(
            f"{run}: {given.log_det:g} after {reached:.0f} s; best {best['final_pose_logdet']:.2f} "
            f"({best['decisions']:.0f} decisions, {best['seconds']:.0f} s), rmse {best['position_rmse_m']:.3f} m"
        )
    straight = dataclasses.asdict(evaluate(None, GazeTask(), VALIDATION_SEEDS))
    plot_learning(curves, straight, merit).save(given.out)


if __name__ == "__main__":
    main()
