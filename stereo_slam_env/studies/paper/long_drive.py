"""Section 4.4: 800 frames, about 350 m, two wide turns: trajectory, yaw and velocity, drift, scale and consistency."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from stereo_slam_env import BenchmarkResult, FilterChoice, Scenario, Study
from stereo_slam_env.benchmark import Cell, ReferenceSource, StreetSource
from stereo_slam_env.evaluation import FilterRun, ate_unaligned, end_drift_percent, path_length, root_mean_square
from stereo_slam_env.studies.paper.claims import (
    ASSUMED,
    ASSUMED_NAMES,
    COUPLED,
    DIAGONAL,
    DUAL,
    EUCLIDEAN,
    JOINT,
    NOISES,
    RIGHT,
    Claim,
    FloatArray,
    Interval,
    Measured,
    claim,
    mean_interval,
    ratio_interval,
    rms_interval,
)

CHORD = 20
"""Frames; lengths are measured in steps of so many (10 m), because noise makes every small step longer."""
EUCLIDEAN_GUARD = 5.0
"""px; the classic starts no landmark with less disparity, or it diverges on far points."""
DRIVE, STREET = "drive", "street"
"""Drives past points, and one in the simulated street, with walls in the way."""
Case = tuple[str, str, str, str]
"""Place, noise, filter and the R that it assumes."""
Runs = Mapping[Case, Sequence[FilterRun]]
"""By seed."""
Quantity = Callable[[FilterRun], float]


def cases(place: str, noise: str) -> tuple[Case, ...]:
    """Filters and the R that they assume, at that place under that noise."""
    filters = (*((JOINT, R) for R in ASSUMED), (DUAL, COUPLED), (EUCLIDEAN, RIGHT[noise]))
    return tuple((place, noise, name, R) for name, R in filters)


def study(drives: int, frames: int) -> Study:
    """The drives, as the benchmark runs them: a cell for each place, noise and assumed R."""
    assumed: dict[str, dict[str, Any]] = {DIAGONAL: {"diagonal": [1.0, 1.0, 1.0]}, COUPLED: {"independent_pixels": 1.0}}
    options = {EUCLIDEAN: {"min_disparity": EUCLIDEAN_GUARD}}
    cells = []
    for place, noise, R in product((DRIVE, STREET), NOISES, ASSUMED):
        past_points = place == DRIVE
        names = [name for _, _, name, of in cases(place, noise) if of == R]
        scenario = Scenario(
            f"{place}-{noise}-{R}",
            ReferenceSource("long_drive", {"noise": noise})
            if past_points
            else StreetSource({"route": "town", "noise": noise}),
            tuple(FilterChoice(name, name, options.get(name, {})) for name in names),
            seeds=tuple(range(drives)) if past_points else (0,),
            frames=frames,
            noise=assumed[R],
            gate=None,
            metrics=("map",),
        )
        cells.append(Cell(scenario.name, {"place": place, "noise": noise, "R": R}, scenario))
    return Study("paper-4.4", tuple(cells))


def runs_of(result: BenchmarkResult) -> dict[Case, list[FilterRun]]:
    """The runs, by case."""
    found: dict[Case, list[FilterRun]] = {}
    for cell in result.cells:
        place, noise, R = cell.cell.factors.values()
        for run in cell.runs:
            found.setdefault((place, noise, run.filter_name, R), []).append(run)
    return found


# Quantities of one run.


def position_rmse(run: FilterRun) -> float:
    """m, without alignment."""
    return ate_unaligned(run.positions, run.true_positions)


def drift_percent(run: FilterRun) -> float:
    """Error at the end, % of the path."""
    return end_drift_percent(run.positions, run.true_positions)


def yaw_rmse(run: FilterRun) -> float:
    """Root mean square of the heading error, degrees."""
    return float(np.rad2deg(root_mean_square(yaw(run.orientations) - yaw(run.true_orientations))))


def velocity_rmse(run: FilterRun) -> float:
    """Of Vx and Vz together, m/s."""
    return root_mean_square((run.linear_velocities - run.true_linear_velocities)[:, [0, 2]])


def scale_error_percent(run: FilterRun) -> float:
    """By how much the estimated path is longer than the true one, %."""
    return 100.0 * (path_length(run.positions[::CHORD]) / path_length(run.true_positions[::CHORD]) - 1.0)


def pose_nees(run: FilterRun) -> float:
    """Mean over frames, by its 6 degrees of freedom."""
    return float(np.mean(run.pose_nees[1:]) / 6.0)


def landmark_nees(run: FilterRun) -> float:
    """Mean over frames, by its 3 degrees of freedom."""
    return float(np.nanmean(run.landmark_nees) / 3.0)


def nis(run: FilterRun) -> float:
    """Of all innovations, by their degrees of freedom."""
    return float(np.nansum(run.nis) / max(int(run.nis_dof.sum()), 1))


def yaw(orientations: FloatArray) -> FloatArray:
    """Yaw of the viewing direction about y, rad, without jumps; (K, 4) -> (K,)."""
    forward = Rotation.from_quat(orientations).apply([0.0, 0.0, 1.0])
    turned: FloatArray = np.unwrap(np.arctan2(forward[:, 0], forward[:, 2]))
    return turned


def of_runs(runs: Sequence[FilterRun], quantity: Quantity) -> FloatArray:
    """A quantity of each run, (S,); NaN where the filter failed."""
    return np.array([quantity(run) if np.isfinite(run.positions).all() else np.nan for run in runs])


def course(run: FilterRun, *, true: bool = False) -> dict[str, FloatArray]:
    """Curves of figure 6 of a run or of the truth: positions, yaw and velocities."""
    if true:
        poses = run.true_positions, run.true_orientations, run.true_linear_velocities
    else:
        poses = run.positions, run.orientations, run.linear_velocities
    return {"positions": poses[0], "yaw": yaw(poses[1]), "velocities": poses[2]}


def judge(runs: Runs) -> tuple[Claim, ...]:
    """The claims of section 4.4."""

    def measured(noise: str, name: str, R: str, quantity: Quantity) -> FloatArray:
        return of_runs(runs[DRIVE, noise, name, R], quantity)

    def of_ours(quantity: Quantity, interval: Callable[[FloatArray], Interval] = mean_interval) -> Measured:
        return [
            ({"noise": NOISES[noise], "R": ASSUMED_NAMES[R]}, interval(measured(noise, JOINT, R, quantity)))
            for noise in NOISES
            for R in ASSUMED
        ]

    consistent = [
        ({**condition, "by": by}, interval)
        for by, quantity in (("pose error", pose_nees), ("innovations", nis))
        for condition, interval in of_ours(quantity)
    ]
    against_competitor = [
        (
            {"noise": NOISES[noise], "R": ASSUMED_NAMES[R]},
            ratio_interval(measured(noise, JOINT, R, position_rmse), measured(noise, DUAL, COUPLED, position_rmse)),
        )
        for noise in NOISES
        for R in ASSUMED
    ]
    of_xyz = [
        ({"noise": NOISES[noise]}, mean_interval(measured(noise, EUCLIDEAN, RIGHT[noise], pose_nees)))
        for noise in NOISES
    ]
    return (
        claim("trajectory", of_ours(position_rmse)),
        claim("drift", of_ours(drift_percent)),
        claim("yaw", of_ours(yaw_rmse)),
        claim("velocity", of_ours(velocity_rmse)),
        claim("scale", of_ours(scale_error_percent, rms_interval)),
        claim("consistent", consistent),
        claim("landmark-noise", of_ours(landmark_nees)),
        claim("range-helps", against_competitor),
        claim("xyz-inconsistent", of_xyz),
    )
