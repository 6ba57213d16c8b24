"""What was measured, in absolute numbers: the tables behind the verdicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.evaluation.consistency import mean_band, share_inside
from stereo_slam_env.studies.paper import convergence, landmark_uncertainty, long_drive, speed
from stereo_slam_env.studies.paper.parts import Arrays
from stereo_slam_env.studies.paper.settings import ASSUMED_NAMES, DUAL, EUCLIDEAN, JOINT, NOISES

Row = Sequence[str | float]
NAMES: Mapping[str, str] = {JOINT: "inverse depth (the paper's)", DUAL: "two bearing updates", EUCLIDEAN: "XYZ"}


def uncertainty_table(samples: int) -> tuple[Sequence[str], list[Row]]:
    """Section 4.1: coverage and distance of both parametrisations."""
    found = landmark_uncertainty.fits(samples)
    heads = ("noise", "R", "depth, m", "in 95 %: inverse depth", "XYZ", "KS: inverse depth", "XYZ")
    rows: list[Row] = []
    for noise, assumed, depth in dict.fromkeys(key[:3] for key in found):
        ours, xyz = (found[noise, assumed, depth, name] for name in (JOINT, EUCLIDEAN))
        numbers = (ours.coverage.value, xyz.coverage.value, ours.distance, xyz.distance)
        rows.append((NOISES[noise], ASSUMED_NAMES[assumed], depth, *numbers))
    return heads, rows


def convergence_table(results: Mapping[str, Arrays]) -> tuple[Sequence[str], list[Row]]:
    """Section 4.3: after the last update."""
    heads = (
        "noise",
        "filter",
        "R",
        "landmark",
        "number",
        "claimed σ, m",
        "RMS error, m",
        "NEES of depth",
        "of 1/depth",
    )
    rows: list[Row] = []
    for noise in NOISES:
        depths = convergence.gathered(results, noise)
        for (name, R), history in depths.filters.items():
            z, sigma = (values[:, -1] for values in depths.depth(history))
            error = z - depths.true[:, -1]
            nees = convergence.nees(depths, history)
            for label in convergence.RANGES:
                at = depths.label == label
                numbers = (
                    _rms(sigma[at]),
                    _rms(error[at]),
                    float(np.nanmean((error[at] / sigma[at]) ** 2)),
                    float(np.nanmean(nees[at])),
                )
                rows.append((NOISES[noise], NAMES[name], ASSUMED_NAMES[R], label, float(at.sum()), *numbers))
    return heads, rows


def drive_table(results: Mapping[str, Arrays]) -> tuple[Sequence[str], list[Row]]:
    """Section 4.4: means over the drives, and the one drive in the simulated street."""
    heads = (
        *("drives", "noise", "filter", "R", "position, m", "drift, %", "yaw, °", "velocity, m/s", "length, %"),
        *("NEES / 6", "band", "in band, %", "landmark NEES / 3", "NIS / dof"),
    )
    before = (
        *(long_drive.position_rmse, long_drive.drift_percent, long_drive.yaw_rmse, long_drive.velocity_rmse),
        *(long_drive.scale_error_percent, long_drive.pose_nees),
    )
    rows: list[Row] = []
    for place, name in (("drive", "past points"), ("street", "in the street")):
        for noise in NOISES:
            drives = long_drive.drives(results, noise, place)
            band = mean_band(6, len(drives))
            for case in long_drive.cases(noise):

                def mean(
                    quantity: long_drive.Quantity, noise: str = noise, case: tuple[str, str] = case, place: str = place
                ) -> float:
                    return float(np.nanmean(long_drive.of_drives(results, noise, case, quantity, place)))

                nees = np.mean([long_drive.one(arrays, ".".join(case))["pose_nees"] for arrays in drives], axis=0)
                row: list[str | float] = [
                    f"{len(drives)} {name}",
                    NOISES[noise],
                    NAMES[case[0]],
                    ASSUMED_NAMES[case[1]],
                ]
                row += [*map(mean, before), f"{band[0] / 6:.2f}–{band[1] / 6:.2f}"]
                row += [100.0 * share_inside(nees[1:], band), *map(mean, (long_drive.landmark_nees, long_drive.nis))]
                rows.append(row)
    return heads, rows


def speed_table(results: Mapping[str, Arrays]) -> tuple[Sequence[str], list[Row]]:
    """Milliseconds of predict + update, medians."""
    measured = speed.milliseconds(results)
    heads = ("state", *(f"{who}, {n}" for n in measured for who in ("ours", "rival")))
    rows: list[Row] = [
        (form, *(float(np.median(times[f"{form}.{name}"])) for times in measured.values() for name in (JOINT, DUAL)))
        for form in speed.FORMS
    ]
    return heads, rows


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))
