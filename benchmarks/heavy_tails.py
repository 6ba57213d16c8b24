"""What heavy-tailed noise and wrong associations do to a filter, and what defends it.

    python benchmarks/heavy_tails.py                      # 200 seeds, 30 min on two idle cores
    python benchmarks/heavy_tails.py --seeds 20 --only gate consensus

The first 100 frames (50 m) of the reference drive. Every pixel coordinate has the error measured on rendered images by
corner detection and matching: 60 % of sigma 0.07 px, 36 % of 0.45 px, 4 % uniform over +-20 px, so that every eighth
measurement has a coordinate that tells nothing; and in every frame 10 % of the measurements swap their identities.
A filter assumes Gaussian pixels of `--sigma-px`. A run has diverged if it fails or ends farther from the truth than
10 % of the way.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from filters import StereoNoise, StereoObservation
from harness import arguments, by_seed, show
from stereo_slam_env.benchmark.recordings.reference_problem import long_drive
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.sensing.corruptions import matching_errors

WRONG = 0.10
ASSUMED_SIGMA = 0.35  # px; the two Gaussians of the mixture together have 0.28
FILTER = "shared-anchor"
# The setting to take is "consensus"; the others say what each part is for.
DEFENCES: dict[str, dict[str, Any]] = {
    "none": {"gate": None},
    "gate": {"gate": 0.99},
    "re-weighting": {"gate": None, "tail_dof": 4.0},
    "gate + re-weighting": {"gate": 0.99, "tail_dof": 4.0},
    "consensus": {"gate": 0.99, "consensus": True},
    "consensus + re-weighting": {"gate": 0.99, "consensus": True, "tail_dof": 4.0},
}


def corrupted(exact: StereoObservation, rng: np.random.Generator) -> StereoObservation:
    """Errors on every pixel coordinate; a tenth of the measurements exchange their identities in a ring."""
    u_left, v_left, u_right, v_right = matching_errors(rng, (4, len(exact)))
    uvd = exact.uvd + np.stack([u_left, v_left, u_left - u_right], axis=1)
    rows = exact.uvd[:, 1] + v_right
    wrong = rng.choice(len(exact), round(WRONG * len(exact)), replace=False)
    ids = exact.ids.copy()
    ids[wrong] = ids[np.roll(wrong, 1)]
    order = np.argsort(ids)
    return StereoObservation(ids[order], uvd[order], rows[order])


def recording(seed: int, frames: int) -> Recording:
    """The reference drive with bad measurements."""
    exact = long_drive(seed, sigma=1e-9, frames=frames)
    rng = np.random.default_rng([seed, 1])
    taken = tuple(dataclasses.replace(f, observation=corrupted(f.observation, rng)) for f in exact.frames)
    return dataclasses.replace(exact, name="heavy-tails", frames=taken)


def run_seed(seed: int, frames: int, sigma_px: float, labels: list[str]) -> list[FilterRun]:
    """All defences on the recording of one seed."""
    made, noise = recording(seed, frames), StereoNoise.independent_pixels(sigma_px)
    return [run_filter(made, FILTER, DEFENCES[label], label=label, noise=noise, seed=seed) for label in labels]


def row(runs: list[FilterRun]) -> list[str]:
    """The figures of one defence over all seeds."""
    (summary,) = summarise_all(runs, figures_of(runs, divergence_percent=10.0))
    ends = [np.linalg.norm(run.pose_errors[-1, :3]) for run in runs if run.failure is None]
    by_run = np.array([run.pose_nees[1:].mean() / 6 for run in runs if run.failure is None])
    return [
        f"{summary.diverged} of {len(runs)}",
        f"{summary.pose_anees / 6:.3f}",
        f"{np.median(by_run):.3f} / {by_run.max():.1f}",
        f"{100 * np.sqrt(np.mean(np.square(ends))):.1f} / {100 * np.max(ends):.1f}",
        f"{summary.nis:.3f}",
        f"{summary.gated_percent:.1f}",
        f"{summary.ms_per_frame:.1f}",
    ]


def main() -> None:
    """Run and print."""
    given = arguments(__doc__, seeds=200, frames=100, sigma_px=ASSUMED_SIGMA, only=list(DEFENCES), jobs=2)
    runs = by_seed(run_seed, given.seeds, given.jobs, given.frames, given.sigma_px, given.only)
    low, high = mean_band(6, given.seeds)
    title = f"{FILTER}, {given.seeds} seeds, {given.frames} frames, assumed {given.sigma_px:g} px"
    heads = ("defence", "diverged", "ANEES/6", "by run: median / worst", "end error cm: rms / worst", "NIS/dof")
    rows = [(label, *row([of[number] for of in runs])) for number, label in enumerate(given.only)]
    show(f"{title}; ANEES/6 band of one frame [{low / 6:.2f}, {high / 6:.2f}]", (*heads, "gated %", "ms"), rows)


if __name__ == "__main__":
    main()
