"""Are the filters consistent where theory says they must be? Monte Carlo on the reference problem.

    python benchmarks/reference_consistency.py turn --seeds 50      # 12 frames into a right turn, 20 s
    python benchmarks/reference_consistency.py long --seeds 50      # 800 frames, 350 m, 10 min on two cores

Prints, for independent pixel noise and for the paper's noise (u, v, d independent), what each filter's errors are and
what it claims they are. ANEES/6 has a two-sided 95 % band for the number of seeds; so has the sum of NIS over the seeds
in each frame, and "in band" is the share of frames inside. Landmark NEES is correlated between landmarks and in time:
its mean comes with its standard error over the seeds. No gate, so nothing is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from filters import StereoNoise
from harness import arguments, by_seed, mean_and_error, show
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive, short_turn
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun

PAPER_R = StereoNoise.diagonal(1.0, 1.0, 1.0)
FULL_R = StereoNoise.independent_pixels(1.0)


@dataclass(frozen=True)
class Case:
    """A filter and the R it assumes."""

    label: str
    filter_name: str
    noise: StereoNoise
    options: dict[str, Any]


CASES = (
    Case("joint, R = I (paper)", "inverse-depth", PAPER_R, {}),
    Case("joint, full R", "inverse-depth", FULL_R, {}),
    Case("dual, full R", "dual-bearing", FULL_R, {}),
    Case("XYZ, full R, d >= 4 px", "euclidean", FULL_R, {"min_disparity": 4.0}),
    Case("XYZ, sigma points, full R, d >= 1 px", "euclidean", FULL_R, {"min_disparity": 1.0, "update": "unscented"}),
)
PROBLEMS = {"turn": short_turn, "long": long_drive}


def run_seed(seed: int, problem: str, noise: str, landmarks: int) -> list[FilterRun]:
    """All cases on the recording of one seed."""
    recording = PROBLEMS[problem](seed, noise, landmarks=landmarks)
    return [
        run_filter(recording, case.filter_name, {**case.options, "gate": None}, noise=case.noise, seed=seed)
        for case in CASES
    ]


def depth_error(runs: list[FilterRun], label: str) -> str:
    """Sigma / RMSE of the traced landmark at the end, and its depth NEES."""
    traces = [trace for run in runs for trace in run.traces if trace.label == label]
    last = [(t.sigma[11], t.depth[11] - t.true_depth[11]) for t in traces if len(t.frames) > 11]
    if not last:
        return "–"
    sigma, error = np.array(last).T
    return f"{np.median(sigma):.3f} / {np.sqrt(np.mean(error**2)):.3f}, {np.mean((error / sigma) ** 2):.2f}"


def nis_figure(runs: list[FilterRun]) -> str:
    """NIS by its degrees of freedom, and the share of frames in which the sum over the seeds is inside its band."""
    nis, dof = (np.sum([getattr(run, name) for run in runs], axis=0)[1:] for name in ("nis", "nis_dof"))
    low, high = chi2.ppf([0.025, 0.975], dof[dof > 0, None]).T
    inside = np.mean((nis[dof > 0] >= low) & (nis[dof > 0] <= high))
    return f"{nis.sum() / dof.sum():.3f}, {100 * inside:.0f} %"


def landmark_figure(runs: list[FilterRun]) -> str:
    """Mean landmark NEES by 3 and its standard error."""
    by_run = np.array([np.nanmean(run.landmark_nees) for run in runs]) / 3
    return mean_and_error(by_run)


def row(runs: list[FilterRun], band: tuple[float, float]) -> list[str]:
    """The figures of one case over all seeds."""
    nees = np.array([run.pose_nees for run in runs])[:, 1:]
    by_frame = nees.mean(axis=0)
    inside = np.mean((by_frame >= band[0]) & (by_frame <= band[1]))
    ends = np.array([run.pose_errors[-1] for run in runs])
    lengths = [np.linalg.norm(np.diff(run.true_positions, axis=0), axis=1).sum() for run in runs]
    drift = 100.0 * np.linalg.norm(ends[:, :3], axis=1) / lengths
    yaw = 1e3 * np.sqrt(np.mean(ends[:, 4] ** 2))
    claimed = 1e3 * np.mean([np.sqrt(run.pose_covariances[-1, 4, 4]) for run in runs])
    return [
        f"{nees.mean() / 6:.3f}",
        f"{100 * inside:.0f} %",
        nis_figure(runs),
        landmark_figure(runs),
        f"{drift.mean():.3f}",
        f"{yaw:.2f} / {claimed:.2f}",
        depth_error(runs, "near"),
        depth_error(runs, "far"),
        f"{np.median(np.concatenate([run.milliseconds for run in runs])):.1f}",
    ]


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, "problem", problem=tuple(PROBLEMS), seeds=50, jobs=2, landmarks=90)
    band = mean_band(6, given.seeds)
    heads = ("filter", "ANEES/6", "in band", "NIS/dof, in band", "landmark NEES/3", "drift %")
    more = ("end yaw rms / claimed mrad", "near: σ / RMSE m, NEES", "far: σ / RMSE m, NEES", "ms")
    for noise in ("pixels", "uvd"):
        runs = by_seed(run_seed, given.seeds, given.jobs, given.problem, noise, given.landmarks)
        rows = [(case.label, *row([of[number] for of in runs], band)) for number, case in enumerate(CASES)]
        title = f"{given.problem}, {noise} noise, {given.seeds} seeds"
        show(f"{title}; ANEES/6 band [{band[0] / 6:.2f}, {band[1] / 6:.2f}]", (*heads, *more), rows)


if __name__ == "__main__":
    main()
