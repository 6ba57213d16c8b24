"""Section 4.4: 800 frames, about 350 m, two wide turns: trajectory, yaw and velocity, drift, scale and consistency."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.benchmark.recordings import reference_problem
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.trajectory_metrics import (
    ate_unaligned,
    end_drift_percent,
    path_length,
    root_mean_square,
)
from stereo_slam_env.report.charts.series import heading
from stereo_slam_env.studies.paper import limits, sentences
from stereo_slam_env.studies.paper.claims import Claim, Finding, Interval, Range
from stereo_slam_env.studies.paper.intervals import mean_interval, ratio_interval, rms_interval
from stereo_slam_env.studies.paper.parts import Arrays, Part
from stereo_slam_env.studies.paper.settings import (
    ASSUMED,
    ASSUMED_NAMES,
    COMMON_OPTIONS,
    COUPLED,
    DUAL,
    EUCLIDEAN,
    EUCLIDEAN_GUARD,
    JOINT,
    NOISES,
    RIGHT,
    PaperSettings,
)

CHORD = 20
"""Frames; lengths are measured in steps of so many (10 m), because noise makes every small step longer."""
TRUTH = "truth"
Quantity = Callable[[Mapping[str, FloatArray], Mapping[str, FloatArray]], float]
"""Of what a filter says and what is true on one drive."""


def cases(noise: str) -> tuple[tuple[str, str], ...]:
    """Filters and the R that they assume, under that noise."""
    return (*((JOINT, R) for R in ASSUMED), (DUAL, COUPLED), (EUCLIDEAN, RIGHT[noise]))


def parts(settings: PaperSettings) -> list[Part]:
    """The work of this section: drives past points, and one in the simulated street, with walls in the way."""
    seeds = {"drive": range(settings.drive_seeds), "street": range(1)}
    return [
        Part(
            f"{place}-{noise}-{seed:04d}",
            {"frames": settings.drive_frames, "cases": cases(noise), "options": dict(COMMON_OPTIONS)},
            partial(compute, place, noise, seed, settings.drive_frames),
        )
        for noise in NOISES
        for place in seeds
        for seed in seeds[place]
    ]


def compute(place: str, noise: str, seed: int, frames: int) -> Arrays:
    """All filters on one drive; the place is "drive" or "street"."""
    if place == "drive":
        recording = reference_problem.long_drive(seed, noise, frames=frames)
    else:
        from stereo_slam_env.envs.recorder import record  # PyBullet and Gymnasium, only where they are needed

        recording = record({"route": "town", "noise": noise}, seed, frames)
    arrays: Arrays = {}
    for name, R in cases(noise):
        own = {"min_disparity": EUCLIDEAN_GUARD} if name == EUCLIDEAN else {}
        run = run_filter(recording, name, {**COMMON_OPTIONS, **own}, noise=ASSUMED[R], use_odometry=False, seed=seed)
        arrays |= {f"{name}.{R}.{series}": values for series, values in series_of(run).items()}
        arrays |= {f"{TRUTH}.{series}": values for series, values in true_series_of(run).items()}
    return arrays


def series_of(run: FilterRun) -> Arrays:
    """What is kept of a run."""
    return {
        "positions": run.positions,
        "yaw": heading(run.orientations),
        "velocities": run.linear_velocities,
        "pose_nees": run.pose_nees,
        "landmark_nees": run.landmark_nees,
        "nis": run.nis,
        "nis_dof": run.nis_dof,
    }


def true_series_of(run: FilterRun) -> Arrays:
    """The truth beside it."""
    return {
        "positions": run.true_positions,
        "yaw": heading(run.true_orientations),
        "velocities": run.true_linear_velocities,
    }


def one(arrays: Arrays, case: str) -> dict[str, FloatArray]:
    """The series of one filter ("inverse-depth.full"), or of the truth."""
    prefix = f"{case}."
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}


# Quantities of one drive.


def position_rmse(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """m, without alignment."""
    return ate_unaligned(said["positions"], true["positions"])


def drift_percent(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """Error at the end, % of the way."""
    return end_drift_percent(said["positions"], true["positions"])


def yaw_rmse(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """Degrees."""
    return float(np.rad2deg(root_mean_square(said["yaw"] - true["yaw"])))


def velocity_rmse(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """Of Vx and Vz together, m/s."""
    return root_mean_square((said["velocities"] - true["velocities"])[:, [0, 2]])


def scale_error_percent(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """By how much the estimated way is longer than the true one, %."""
    return 100.0 * (path_length(said["positions"][::CHORD]) / path_length(true["positions"][::CHORD]) - 1.0)


def pose_nees(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """Mean over frames, by its 6 degrees of freedom."""
    return float(np.mean(said["pose_nees"][1:]) / 6.0)


def landmark_nees(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """Mean over frames, by its 3 degrees of freedom."""
    return float(np.nanmean(said["landmark_nees"]) / 3.0)


def nis(said: Mapping[str, FloatArray], true: Mapping[str, FloatArray]) -> float:
    """Of all innovations, by their degrees of freedom."""
    return float(np.nansum(said["nis"]) / max(said["nis_dof"].sum(), 1))


def drives(results: Mapping[str, Arrays], noise: str, place: str = "drive") -> list[Arrays]:
    """The drives of one noise, by seed."""
    return [arrays for name, arrays in sorted(results.items()) if name.startswith(f"{place}-{noise}-")]


def of_drives(
    results: Mapping[str, Arrays], noise: str, case: tuple[str, str], quantity: Quantity, place: str = "drive"
) -> FloatArray:
    """A quantity of each drive, by seed, (S,); NaN where the filter failed."""
    values = [
        quantity(said, one(arrays, TRUTH)) if np.isfinite(said["positions"]).all() else np.nan
        for arrays in drives(results, noise, place)
        for said in [one(arrays, ".".join(case))]
    ]
    return np.array(values)


def claims(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims of section 4.4, judged."""

    def of_ours(
        quantity: Quantity, asked: Range, interval: Callable[[FloatArray], Interval] = mean_interval
    ) -> tuple[Finding, ...]:
        return tuple(
            Finding(
                {"noise": NOISES[noise], "R": ASSUMED_NAMES[R]},
                interval(of_drives(results, noise, (JOINT, R), quantity)),
                asked,
            )
            for noise in NOISES
            for R in ASSUMED
        )

    consistent = tuple(
        Finding({**finding.condition, "by": judge}, finding.measured, finding.asked)
        for judge, quantity in (("pose error", pose_nees), ("innovations", nis))
        for finding in of_ours(quantity, limits.CONSISTENT)
    )
    against_rival = tuple(
        Finding(
            {"noise": NOISES[noise], "R": ASSUMED_NAMES[R]},
            ratio_interval(
                of_drives(results, noise, (JOINT, R), position_rmse),
                of_drives(results, noise, (DUAL, COUPLED), position_rmse),
            ),
            limits.BETTER,
        )
        for noise in NOISES
        for R in ASSUMED
    )
    of_xyz = tuple(
        Finding(
            {"noise": NOISES[noise]},
            mean_interval(of_drives(results, noise, (EUCLIDEAN, RIGHT[noise]), pose_nees)),
            limits.INCONSISTENT,
        )
        for noise in NOISES
    )
    return (
        Claim(sentences.TRAJECTORY, of_ours(position_rmse, limits.POSITION_M)),
        Claim(sentences.DRIFT, of_ours(drift_percent, limits.DRIFT_PERCENT)),
        Claim(sentences.YAW, of_ours(yaw_rmse, limits.YAW_DEG)),
        Claim(sentences.VELOCITY, of_ours(velocity_rmse, limits.VELOCITY_M_S)),
        Claim(sentences.SCALE, of_ours(scale_error_percent, limits.SCALE_PERCENT, rms_interval)),
        Claim(sentences.CONSISTENT, consistent),
        Claim(sentences.LANDMARK_NOISE, of_ours(landmark_nees, limits.CONSISTENT)),
        Claim(sentences.RANGE_HELPS, against_rival),
        Claim(sentences.XYZ_INCONSISTENT, of_xyz),
    )
