"""Does a filter end where smoothing everything ends? Final positions on the reference drive, seed by seed.

    python benchmarks/against_batch.py                    # 20 seeds, 10 min on two idle cores
    python benchmarks/against_batch.py --right-row        # with the row of the right image: stacked against batch
    python benchmarks/against_batch.py --frames 200 --seeds 40

800 frames, 350 m, independent pixel noise of 1 px that filter and smoother know; no gate. All are given the same
measurements and the same motion model. The ratio of the root mean square errors has a 95 % bootstrap interval over the
seeds (pairs are drawn together); at 1.05 and below the filter gives nothing away. chi2/dof says whether a solution of
the smoother is the right minimum: far from 1 it is not. Needs the extra `gtsam`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from stereo_slam_env.baselines.batch import BatchSmoother
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.trajectory_metrics import ate_rigid
from stereo_slam_env.recording.recording import Recording

FILTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "shared-anchor": ("shared-anchor", {}),
    "right-invariant": ("right-invariant", {}),
    "unscented": ("unscented", {}),
    "frame-to-frame": ("frame-to-frame", {}),
    "dead-reckoning": ("dead-reckoning", {}),
}
WITH_RIGHT_ROW: dict[str, tuple[str, dict[str, Any]]] = {
    "stacked": ("shared-anchor", {"measurement": "stacked"}),
    "dual-bearing": ("dual-bearing", {"landmark": "shared-anchor"}),
}
BATCH = "batch"
RESAMPLES = 10_000


@dataclass(frozen=True)
class Outcome:
    """Of one run: the last position error (3,) m, the rigid ATE in m, and chi2/dof where there is one."""

    end: np.ndarray
    ate: float
    chi2: float = float("nan")


def outcome(positions: np.ndarray, recording: Recording, chi2: float = float("nan")) -> Outcome:
    """Compare with the truth."""
    truth = np.array([frame.truth.position for frame in recording.frames if frame.truth is not None])
    return Outcome(positions[-1] - truth[-1], ate_rigid(positions, truth), chi2)


def run_batch(recording: Recording, right_row: bool) -> Outcome:
    """All frames, solved now and then and at the end."""
    start = recording.start
    smoother = BatchSmoother(recording.camera, recording.noise, gate=None, right_row=right_row)
    smoother.reset(start)
    last = None
    with threadpool_limits(1):
        for frame in recording.frames:
            if last is not None:
                smoother.predict(frame.timestamp - last)
            smoother.update(frame.observation)
            last = frame.timestamp
        smoothed = smoother.smooth()
    return outcome(smoothed.positions, recording, smoothed.chi_square / smoothed.degrees_of_freedom)


def run_seed(seed: int, frames: int, right_row: bool, chosen: list[str]) -> dict[str, Outcome]:
    """Batch and filters on the recording of one seed."""
    recording = long_drive(seed, frames=frames)
    found = {BATCH: run_batch(recording, right_row)}
    for label, (name, options) in (WITH_RIGHT_ROW if right_row else FILTERS).items():
        if not chosen or label in chosen:
            run = run_filter(recording, name, options, common_options={"gate": None})
            found[label] = outcome(run.positions, recording)
    return found


def interval(errors: np.ndarray, reference: np.ndarray) -> tuple[float, float, float]:
    """Ratio of the root mean squares of two paired samples (N, 3), and its 95 % bootstrap interval."""
    squares, reference_squares = np.sum(errors**2, axis=1), np.sum(reference**2, axis=1)
    drawn = np.random.default_rng(0).integers(len(squares), size=(RESAMPLES, len(squares)))
    ratios = np.sqrt(squares[drawn].sum(axis=1) / reference_squares[drawn].sum(axis=1))
    low, high = np.quantile(ratios, [0.025, 0.975])
    return float(np.sqrt(squares.sum() / reference_squares.sum())), float(low), float(high)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--frames", type=int, default=800)
    parser.add_argument("--right-row", action="store_true")
    parser.add_argument("--only", default="", help="filters, separated by commas")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    chosen = arguments.only.split(",") if arguments.only else []
    by_seed = Parallel(arguments.jobs)(
        delayed(run_seed)(seed, arguments.frames, arguments.right_row, chosen) for seed in range(arguments.seeds)
    )
    what = "u, v, d and the right row" if arguments.right_row else "u, v, d"
    table = Table(title=f"{arguments.seeds} reference drives of {arguments.frames} frames, from {what}")
    for head in ("", "end position rms m", "ratio to batch [95 %]", "ATE m, median", "chi2/dof"):
        table.add_column(head)
    reference = np.array([found[BATCH].end for found in by_seed])
    for label in by_seed[0]:
        runs = [found[label] for found in by_seed]
        ends = np.array([run.end for run in runs])
        ratio, low, high = interval(ends, reference)
        chi2 = np.array([run.chi2 for run in runs])
        table.add_row(
            label,
            f"{np.sqrt(np.mean(np.sum(ends**2, axis=1))):.4f}",
            "1" if label == BATCH else f"{ratio:.3f} [{low:.3f}, {high:.3f}]",
            f"{np.median([run.ate for run in runs]):.3f}",
            f"{chi2.min():.3f} to {chi2.max():.3f}" if label == BATCH else "",
        )
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
