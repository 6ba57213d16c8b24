"""Which error definition stays consistent when the orientation is uncertain? The simulation of Zhang et al. 2017.

    python benchmarks/large_rotation.py --seeds 40               # 15 min on two cores
    python benchmarks/large_rotation.py --seeds 20 --sight 30    # fewer landmarks in view, larger uncertainty

500 steps, 300 landmarks, odometry and points with errors of 1 % and of 5 % of their values. XYZ landmarks, kept when
unseen; no gate. Next to each figure the published one (RA-L 2017, Table II; 100 runs, another sensor).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from harness import arguments, by_seed, mean_and_error, show
from stereo_slam_env.benchmark.recordings.reference_problem import SIGHT, relative_noise_loop
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun

OPTIONS = {"motion": "velocity-driven", "gate": None, "drop_unseen": False}


@dataclass(frozen=True)
class Published:
    """Normalised pose NEES and position RMS in m, by level."""

    nees: dict[float, float]
    rms: dict[float, float]


PUBLISHED = {
    "right-invariant": Published({0.01: 1.01, 0.05: 1.01}, {0.01: 0.25, 0.05: 1.16}),
    "first-estimates": Published({0.01: 1.14, 0.05: 1.13}, {0.01: 0.29, 0.05: 1.24}),
    "so3": Published({0.01: 1.35, 0.05: 3.1}, {0.01: 0.32, 0.05: 2.0}),
}


def run_seed(seed: int, level: float, sight: float, frames: int) -> list[FilterRun]:
    """All error definitions on the recording of one seed."""
    recording = relative_noise_loop(seed, level, frames, sight=sight)
    return [run_filter(recording, "euclidean", {**OPTIONS, "error": error}, seed=seed) for error in PUBLISHED]


def row(runs: list[FilterRun], published: Published, level: float) -> list[str]:
    """The figures of one filter over all seeds."""
    whole = [run for run in runs if run.failure is None]
    nees = np.array([run.pose_nees[1:].mean() / 6 for run in whole])
    errors = [run.positions - run.true_positions for run in whole]
    rms = np.sqrt(np.mean([np.mean(np.sum(e**2, axis=1)) for e in errors]))
    claimed = np.sqrt(np.mean([np.trace(run.pose_covariances[:, :3, :3], axis1=1, axis2=2).mean() for run in whole]))
    turn = np.sqrt(np.mean([np.mean(np.sum(run.pose_errors[1:, 3:] ** 2, axis=1)) for run in whole]))
    return [
        mean_and_error(nees),
        f"{np.median(nees):.3f}",
        f"{published.nees.get(level, float('nan')):.2f}",
        f"{rms:.3f} / {claimed:.3f}",
        f"{published.rms.get(level, float('nan')):.2f}",
        f"{turn:.4f}",
        f"{sum(run.nis.sum() for run in whole) / sum(run.nis_dof.sum() for run in whole):.3f}",
        f"{len(runs) - len(whole)}",
    ]


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, seeds=40, jobs=2, frames=500, levels=[0.01, 0.05], sight=SIGHT)
    low, high = mean_band(6, given.seeds)
    heads = ("error", "ANEES/6 ± its error", "median run", "published", "position rms / claimed m", "published")
    for level in given.levels:
        runs = by_seed(run_seed, given.seeds, given.jobs, level, given.sight, given.frames)
        rows = [
            (error, *row([of[number] for of in runs], published, level))
            for number, (error, published) in enumerate(PUBLISHED.items())
        ]
        title = f"noise {100 * level:g} %, {given.seeds} seeds, sight {given.sight:g} m"
        band = f"ANEES/6 band of one frame [{low / 6:.2f}, {high / 6:.2f}]"
        show(f"{title}; {band}", (*heads, "rotation rms rad", "NIS/dof", "failed"), rows)


if __name__ == "__main__":
    main()
