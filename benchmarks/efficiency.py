"""How much do filters give away? Their errors on the reference drive against the posterior Cramer-Rao bound.

    python benchmarks/efficiency.py                       # 50 seeds of 200 frames, 10 min on two idle cores
    python benchmarks/efficiency.py --seeds 200 --no-batch
    python benchmarks/efficiency.py --noise uvd

Independent pixel noise of 1 px that the filters know; no gate. Efficiency is the root mean square of the bound over
that of the error, with a 95 % bootstrap interval over the seeds (pairs are drawn together): 100 % leaves nothing to
gain. The batch smoother knows later frames when it says where the camera was, so it is compared by the last pose only,
as are all in the last column. The bound is for all that was measured, the row of the right image included;
"(u, v, d) only" is for those who do not use it, shared-anchor, euclidean and the smoother here. "as driven" is the
bound for those who know that this car accelerates less than the motion model assumes: what lies between it and the
first is what a better motion model could gain. Needs the extra `gtsam`, or `--no-batch`.
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

from filters import ConstantVelocity
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.evaluation.cramer_rao import Bound, cramer_rao_bound
from stereo_slam_env.evaluation.figures import trial_figures
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.intervals import rms_ratio_interval
from stereo_slam_env.evaluation.trial import Trial
from stereo_slam_env.recording.recording import Recording

FILTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "shared-anchor": ("shared-anchor", {}),
    "stacked": ("shared-anchor", {"measurement": "stacked"}),
    "dual-bearing": ("dual-bearing", {"landmark": "shared-anchor"}),
    "euclidean": ("euclidean", {"min_disparity": 5.0}),
}
BOUND, UVD_ONLY, AS_DRIVEN, BATCH = "bound", "bound, (u, v, d) only", "bound, as driven", "batch smoother"


@dataclass(frozen=True)
class Outcome:
    """Root mean squares over a run, m and deg, its last position error, m, and its pose NEES; NaN where not known."""

    position: float
    rotation: float
    end: float
    anees: float = float("nan")


def of_bound(bound: Bound) -> Outcome:
    """What an efficient estimator has."""
    squares = np.diagonal(bound.pose, axis1=1, axis2=2)
    position, rotation = squares[:, :3].sum(axis=1), squares[:, 3:].sum(axis=1)
    return Outcome(
        float(np.sqrt(position[1:].mean())),
        float(np.rad2deg(np.sqrt(rotation[1:].mean()))),
        float(np.sqrt(position[-1])),
    )


def as_driven(recording: Recording) -> ConstantVelocity:
    """The motion model with the root mean square accelerations of the drive itself."""
    moves = [frame.truth_velocity for frame in recording.frames]
    dt = recording.frames[1].timestamp - recording.frames[0].timestamp
    linear, angular = (
        np.diff([getattr(move, which) for move in moves], axis=0) / dt for which in ("linear", "angular")
    )
    return ConstantVelocity(float(np.sqrt(np.mean(linear**2))), float(np.sqrt(np.mean(angular**2))))


def run_batch(recording: Recording) -> Outcome:
    """The last pose, given all frames."""
    from stereo_slam_env.baselines.batch import BatchSmoother

    start = recording.start
    smoother = BatchSmoother(recording.camera, recording.noise, gate=None, right_row=False)
    smoother.reset(start)
    with threadpool_limits(1):
        for k, frame in enumerate(recording.frames):
            if k:
                smoother.predict(frame.timestamp - recording.frames[k - 1].timestamp)
            smoother.update(frame.observation)
        last = smoother.smooth().positions[-1]
    truth = recording.frames[-1].truth
    assert truth is not None
    return Outcome(float("nan"), float("nan"), float(np.linalg.norm(last - truth.position)))


def run_seed(seed: int, frames: int, noise: str, batch: bool) -> dict[str, Outcome]:
    """Both bounds, the filters and the smoother on one drive."""
    recording = long_drive(seed, noise=noise, frames=frames)
    found = {}
    for label, motion, right_row in (
        (BOUND, ConstantVelocity(), True),
        (UVD_ONLY, ConstantVelocity(), False),
        (AS_DRIVEN, as_driven(recording), True),
    ):
        bound = cramer_rao_bound(recording, motion, right_row=right_row)
        assert bound is not None
        found[label] = of_bound(bound)
    for label, (name, options) in FILTERS.items():
        run = run_filter(recording, name, options, common_options={"gate": None})
        row: dict[str, Any] = trial_figures(Trial(run, divergence_percent=10.0))
        found[label] = Outcome(row["position_rmse_m"], row["rotation_rmse_deg"], row["end_error_m"], row["pose_anees"])
    if batch:
        found[BATCH] = run_batch(recording)
    return found


def efficiency(bound: np.ndarray, error: np.ndarray) -> str:
    """Ratio of the root mean squares of two paired samples (N,) in percent, and its 95 % bootstrap interval."""
    if not np.isfinite(error).all():
        return ""
    low, high = rms_ratio_interval(bound, error)
    return f"{100.0 * np.sqrt(np.sum(bound**2) / np.sum(error**2)):.0f} [{100.0 * low:.0f}, {100.0 * high:.0f}]"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--noise", choices=("pixels", "uvd"), default="pixels")
    parser.add_argument("--no-batch", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    by_seed = Parallel(arguments.jobs)(
        delayed(run_seed)(seed, arguments.frames, arguments.noise, not arguments.no_batch)
        for seed in range(arguments.seeds)
    )
    table = Table(title=f"{arguments.seeds} reference drives of {arguments.frames} frames, noise: {arguments.noise}")
    columns = ("", "position m", "efficiency %", "rotation deg", "efficiency %", "pose ANEES", "end m", "efficiency %")
    for head in columns:
        table.add_column(head)

    def of(label: str, which: str) -> np.ndarray:
        return np.array([getattr(found[label], which) for found in by_seed])

    for label in by_seed[0]:
        row = [label]
        for which in ("position", "rotation", "end"):
            errors = of(label, which)
            rms = np.sqrt(np.mean(errors**2))
            row += [f"{rms:.4f}" if np.isfinite(rms) else "", efficiency(of(BOUND, which), errors)]
        anees = of(label, "anees").mean()
        row.insert(5, f"{anees:.2f}" if np.isfinite(anees) else "")
        table.add_row(*row)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
