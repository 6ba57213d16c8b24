"""How much do filters give away? Their errors on the reference drive against the Cramer-Rao bound and full smoothing.

    python benchmarks/efficiency.py                       # 50 seeds of 200 frames, 20 min on two idle cores
    python benchmarks/efficiency.py --noise uvd --seeds 200 --only shared-anchor stacked dual-bearing euclidean
    python benchmarks/efficiency.py --seeds 20 --frames 800 --only shared-anchor "batch smoother"     # 20 min

Independent pixel noise of 1 px that the filters know; no gate. Efficiency is the root mean square of the bound over
that of the error, with a 95 % bootstrap interval over the seeds (pairs are drawn together): 100 % leaves nothing to
gain. The batch smoother knows later frames when it says where the camera was, so it is compared by the last pose only,
as are all under "end"; "by batch" is the ratio of the errors there. The bound is for all
that was measured, the row of the right image included; "(u, v, d) only" is for those who do not use it, shared-anchor,
euclidean and the smoother here ("with the right row": the one who does). "as driven" is the bound for those who know
that this car accelerates less than the motion model assumes: what lies between it and the first is what a better
motion model could gain. ATE is rigid. chi2/dof says whether a solution of the smoother is the right minimum: far from
1 it is not. The smoother needs the extra `gtsam`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters import ConstantVelocity
from filters.catalogue.registry import usual_options
from harness import arguments, by_seed, show
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.evaluation.bands import rms_ratio_interval
from stereo_slam_env.evaluation.cramer_rao import Bound, cramer_rao_bound
from stereo_slam_env.evaluation.figures import trial_figures
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.trajectory_metrics import ate_rigid
from stereo_slam_env.evaluation.trial import Trial
from stereo_slam_env.recording.recording import Recording

BOUND, UVD_ONLY, AS_DRIVEN = "bound", "bound, (u, v, d) only", "bound, as driven"
BATCHES = BATCH, BATCH_STACKED = "batch smoother", "batch smoother, with the right row"
FILTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "shared-anchor": ("shared-anchor", {}),
    "stacked": ("shared-anchor", {"measurement": "stacked"}),
    "dual-bearing": ("dual-bearing", {"landmark": "shared-anchor"}),
    "euclidean": ("euclidean", usual_options("euclidean")),
    "right-invariant": ("right-invariant", {}),
    "unscented": ("unscented", {}),
    "frame-to-frame": ("frame-to-frame", {}),
    "dead-reckoning": ("dead-reckoning", {}),
}


@dataclass(frozen=True)
class Outcome:
    """Of one run; NaN where not known."""

    end: float
    """Last position error, m."""
    position: float = float("nan")
    """Root mean square, m."""
    rotation: float = float("nan")
    """Root mean square, deg."""
    anees: float = float("nan")
    """Of the pose."""
    ate: float = float("nan")
    """Rigid, m."""
    chi2: float = float("nan")
    """By the degrees of freedom."""


def of_bound(bound: Bound) -> Outcome:
    """What an efficient estimator has."""
    squares = np.diagonal(bound.pose, axis1=1, axis2=2)
    position, rotation = squares[:, :3].sum(axis=1), squares[:, 3:].sum(axis=1)
    return Outcome(
        float(np.sqrt(position[-1])),
        float(np.sqrt(position[1:].mean())),
        float(np.rad2deg(np.sqrt(rotation[1:].mean()))),
    )


def as_driven(recording: Recording) -> ConstantVelocity:
    """The motion model with the root mean square accelerations of the drive itself."""
    moves = [frame.truth_velocity for frame in recording.frames]
    dt = recording.frames[1].timestamp - recording.frames[0].timestamp
    linear, angular = (
        np.diff([getattr(move, which) for move in moves], axis=0) / dt for which in ("linear", "angular")
    )
    return ConstantVelocity(float(np.sqrt(np.mean(linear**2))), float(np.sqrt(np.mean(angular**2))))


def run_batch(recording: Recording, right_row: bool) -> Outcome:
    """All frames, solved now and then and at the end."""
    from stereo_slam_env.baselines.smoothers import BatchSmoother

    smoother = BatchSmoother(recording.camera, recording.noise, gate=None, right_row=right_row)
    smoother.reset(recording.start)
    with threadpool_limits(1):
        for k, frame in enumerate(recording.frames):
            if k:
                smoother.predict(frame.timestamp - recording.frames[k - 1].timestamp)
            smoother.update(frame.observation)
        smoothed = smoother.smooth()
    truth = np.array([frame.truth.position for frame in recording.frames if frame.truth is not None])
    end = float(np.linalg.norm(smoothed.positions[-1] - truth[-1]))
    chi2 = smoothed.chi_square / smoothed.degrees_of_freedom
    return Outcome(end, ate=ate_rigid(smoothed.positions, truth), chi2=chi2)


def run_seed(seed: int, frames: int, noise: str, chosen: list[str]) -> dict[str, Outcome]:
    """The bounds, the filters and the smoother on one drive."""
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
    for label in chosen:
        if label in BATCHES:
            found[label] = run_batch(recording, label == BATCH_STACKED)
            continue
        name, options = FILTERS[label]
        run = run_filter(recording, name, options, common_options={"gate": None})
        row: dict[str, Any] = trial_figures(Trial(run, divergence_percent=10.0))
        rms = row["position_rmse_m"], row["rotation_rmse_deg"]
        found[label] = Outcome(row["end_error_m"], *rms, row["pose_anees"], row["ate_rigid_m"])
    return found


def ratio(first: np.ndarray, second: np.ndarray, form: str) -> str:
    """Of the root mean squares of two paired samples (N,), and its 95 % bootstrap interval."""
    if not np.isfinite([first, second]).all():
        return ""
    low, high = rms_ratio_interval(first, second)
    return f"{np.sqrt(np.sum(first**2) / np.sum(second**2)):{form}} [{low:{form}}, {high:{form}}]"


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, seeds=50, frames=200, noise=("pixels", "uvd"), only=[*FILTERS, *BATCHES], jobs=2)
    found = by_seed(run_seed, given.seeds, given.jobs, given.frames, given.noise, given.only)

    def of(label: str, which: str) -> np.ndarray:
        return np.array([getattr(of_seed[label], which) for of_seed in found])

    def number(value: float, form: str) -> str:
        return format(value, form) if np.isfinite(value) else ""

    batch = next((label for label in given.only if label in BATCHES), None)
    rows = []
    for label in found[0]:
        row = [label]
        for which in ("position", "rotation", "end"):
            errors = of(label, which)
            row += [number(np.sqrt(np.mean(errors**2)), ".4f"), ratio(of(BOUND, which), errors, ".0%")]
        row += ["" if batch is None else ratio(of(label, "end"), of(batch, "end"), ".3f")]
        chi2 = of(label, "chi2")
        row += [number(of(label, "anees").mean(), ".2f"), number(np.median(of(label, "ate")), ".3f")]
        rows.append([*row, f"{chi2.min():.3f} to {chi2.max():.3f}" if np.isfinite(chi2).all() else ""])
    heads = ("", "position m", "efficiency", "rotation deg", "efficiency", "end m", "efficiency", "by batch")
    title = f"{given.seeds} reference drives of {given.frames} frames, noise: {given.noise}"
    show(title, (*heads, "pose ANEES", "median ATE m", "chi2/dof"), rows)


if __name__ == "__main__":
    main()
