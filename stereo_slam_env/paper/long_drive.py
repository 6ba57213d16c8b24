"""Section 4.4: 800 frames, about 350 m, two wide turns: trajectory, yaw and velocity, drift, scale and consistency.

Every quantity is one number a drive, and intervals are over the drives. A real recording is one drive: its accuracy is
taken as it is, its NEES for one draw of six numbers, and intervals of the motion over 1 s are over its windows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from filters import StereoNoise, StereoObservation
from stereo_slam_env import Recording
from stereo_slam_env.evaluation import (
    FilterRun,
    ate_rigid,
    ate_unaligned,
    end_drift_percent,
    path_length,
    root_mean_square,
    run_filter,
)
from stereo_slam_env.paper import drives
from stereo_slam_env.paper.paper_claims import (
    ASSUMED_NAMES,
    DUAL,
    EUCLIDEAN,
    FILTER_NAMES,
    FILTERS,
    JOINT,
    MONOCULAR,
    ODOMETRY,
    PAZ,
    PIXELS,
    POINTS,
    REAL,
    SIMULATION,
    XYZ_POINTS,
    Arrays,
    Claim,
    FloatArray,
    Interval,
    Measured,
    finite_mean,
    mean_interval,
    ratio_interval,
    rms_interval,
    share_interval,
    single_interval,
)

CHORD = 20
"""Frames; lengths are measured in steps of so many (10 m), because noise makes every small step longer."""
SECOND = 10
"""Frames of the windows over which the motion is compared, 1 s."""
WITH_BOTH = (JOINT, DUAL, PAZ)
"""Filters that run with both R; the others are given the right one."""
OTHERS = (EUCLIDEAN, XYZ_POINTS, POINTS, MONOCULAR, ODOMETRY)
WINDOWED = (JOINT, PAZ, EUCLIDEAN)
"""Filters whose motion over windows is judged on real drives, in a second run."""
DIVERGED = 10.0
"""%: a drive that ends farther from the truth than this share of its path has diverged."""
BoolArray = NDArray[np.bool_]
Quantity = Callable[[FilterRun], float]


def experiments(
    seeds: Mapping[str, int], frames: int, real: Mapping[str, drives.RealDrive]
) -> dict[str, partial[Arrays]]:
    """The long drives, each with every filter."""
    return dict(drives.experiments(drives.DRIVE, drive, seeds, frames, real, 1))


def drive(key: str, *about: Any) -> Arrays:
    """Quantities of all filters on one drive, by "filter.R.quantity", and courses; see `drives.recordings_of`."""
    setting = drives.setting(key)
    ((seed, recording),) = drives.recordings_of(drives.DRIVE, key, *about)
    arrays: Arrays = {}
    for name, R in cases(setting):
        run = filtered(recording, setting, name, R, seed, windows=setting.place == REAL and name in WINDOWED)
        arrays |= {f"{name}.{R}.{quantity}": values for quantity, values in quantities(run).items()}
        if (name, R) == (JOINT, setting.right) and np.isfinite(run.true_positions).any():
            both = {"said": course(run), "true": course(run, true=True)}
            arrays |= {f"{who}.{series}": values for who, one in both.items() for series, values in one.items()}
    return arrays


def cases(setting: drives.Setting) -> list[tuple[str, str]]:
    """Filters and the R that they assume."""
    return [(name, R) for name in WITH_BOTH for R in setting.levels] + [(name, setting.right) for name in OTHERS]


def filtered(
    recording: Recording, setting: drives.Setting, name: str, R: str, seed: int | None, *, windows: bool = False
) -> FilterRun:
    """A filter of `FILTERS` on a recording; true velocities are those of the true positions where none are known."""
    observed, noise = setting.seen(recording, R)
    if name == MONOCULAR:
        observed = left_alone(observed, noise or recording.noise)
    filter_name, options = FILTERS[name]
    run = run_filter(
        observed,
        filter_name,
        options,
        common_options=setting.options,
        noise=noise,
        use_odometry=False,
        windows=windows,
        seed=seed,
    )
    if setting.place == REAL:
        steps = np.diff(run.true_positions, axis=0) / np.diff(run.timestamps)[:, None]
        run = replace(run, true_linear_velocities=np.vstack([steps[:1], steps]))
    return run


def left_alone(recording: Recording, noise: StereoNoise) -> Recording:
    """The pixels of the left image, without any disparity."""
    observations = (frame.observation for frame in recording.frames)
    return recording.with_observations(
        StereoObservation.of_left(one.ids, one.uvd[:, :2], one.covariances(noise)[:, :2, :2]) for one in observations
    )


# Quantities of one run.


def quantities(run: FilterRun) -> Arrays:
    """All quantities; NaN where the filter failed, or the truth is not known."""
    series = {"nees": run.pose_nees, "motion": motion_errors(run), "windows": run.window_nees_1s}
    judged = _judged(run)
    failed = not np.isfinite(run.positions).all()
    single = {"nis": nis(run), "landmark_nees": landmark_nees(run), "pose_nees": pose_nees(run)}
    names = ("positions", "orientations", "linear_velocities")
    if judged.sum() > CHORD and not failed:
        there = {f"{who}{name}": getattr(run, f"{who}{name}")[judged] for who in ("", "true_") for name in names}
        single |= {name: quantity(replace(run, **there)) for name, quantity in ACCURACY.items()}
    else:
        single |= dict.fromkeys(ACCURACY, np.nan)
    single["diverged"] = 1.0 if failed else np.nan if np.isnan(single["drift"]) else float(single["drift"] > DIVERGED)
    return {name: np.asarray(values) for name, values in (series | single).items()}


def position_rmse(run: FilterRun) -> float:
    """RMS position error without alignment, m."""
    return ate_unaligned(run.positions, run.true_positions)


def aligned_error(run: FilterRun) -> float:
    """RMS position error after the best rigid motion, m: a weak truth begins no better than it goes on."""
    return ate_rigid(run.positions, run.true_positions)


def drift_percent(run: FilterRun) -> float:
    """Error at the end, % of the path."""
    return end_drift_percent(run.positions, run.true_positions)


def yaw_rmse(run: FilterRun) -> float:
    """Root mean square of the heading error, degrees."""
    return float(np.rad2deg(root_mean_square(yaw(run.orientations) - yaw(run.true_orientations))))


def velocity_rmse(run: FilterRun) -> float:
    """Root mean square error of Vx and Vz together, m/s."""
    return root_mean_square((run.linear_velocities - run.true_linear_velocities)[:, [0, 2]])


def scale_error_percent(run: FilterRun) -> float:
    """Excess of the length of the estimated path over that of the true one, %."""
    length = path_length(run.true_positions[::CHORD])
    return 100.0 * (path_length(run.positions[::CHORD]) / length - 1.0) if length else float("nan")


def late_scale_error_percent(run: FilterRun) -> float:
    """Excess of the length over the last quarter of the drive, and a chord at least, %."""
    start = max(min(3 * len(run.positions) // 4, len(run.positions) - CHORD - 1), 0)
    late = replace(run, positions=run.positions[start:], true_positions=run.true_positions[start:])
    return scale_error_percent(late)


ACCURACY: Mapping[str, Quantity] = {
    "position": position_rmse,
    "aligned": aligned_error,
    "drift": drift_percent,
    "yaw": yaw_rmse,
    "velocity": velocity_rmse,
    "scale": scale_error_percent,
    "late_scale": late_scale_error_percent,
}
"""Quantities against the truth, by the name that they are stored under."""


def pose_nees(run: FilterRun) -> float:
    """Mean over frames, by its 6 degrees of freedom."""
    return finite_mean(run.pose_nees[1:][_judged(run)[1:]]) / 6.0


def landmark_nees(run: FilterRun) -> float:
    """Mean over frames, by its 3 degrees of freedom."""
    return finite_mean(run.landmark_nees) / 3.0


def nis(run: FilterRun) -> float:
    """All innovations, by their degrees of freedom."""
    return float(np.nansum(run.nis) / max(int(run.nis_dof.sum()), 1))


def motion_errors(run: FilterRun) -> FloatArray:
    """Errors of the translation over windows of 1 s that do not overlap, in the frame of their start, (W,) m."""
    judged = _judged(run)
    true_positions = np.where(judged[:, None], run.true_positions, np.nan)

    def motions(positions: FloatArray, orientations: FloatArray) -> FloatArray:
        steps = np.diff(positions[::SECOND], axis=0)
        usable = np.isfinite(orientations[::SECOND][: len(steps)]).all(axis=1)
        moved = np.full_like(steps, np.nan)
        if usable.any():
            starts = np.array(orientations[::SECOND][: len(steps)][usable])
            moved[usable] = Rotation.from_quat(starts).apply(np.array(steps[usable]), inverse=True)
        return moved

    error = motions(run.positions, run.orientations) - motions(true_positions, run.true_orientations)
    return np.asarray(np.linalg.norm(error, axis=1))


def yaw(orientations: FloatArray) -> FloatArray:
    """Yaw of the viewing direction about y, rad, without jumps; (K, 4) -> (K,)."""
    forward = Rotation.from_quat(np.array(orientations)).apply([0.0, 0.0, 1.0])
    turned: FloatArray = np.unwrap(np.arctan2(forward[:, 0], forward[:, 2]))
    return turned


def course(run: FilterRun, *, true: bool = False) -> dict[str, FloatArray]:
    """Curves of figure 6 of a run or of the truth where it is known: positions, yaw and velocities."""
    known_truth = np.isfinite(run.true_positions).all(axis=1)
    names = ("positions", "orientations", "linear_velocities")
    places, turned, velocities = (getattr(run, f"true_{name}" if true else name)[known_truth] for name in names)
    return {"positions": places, "yaw": yaw(turned), "velocities": velocities}


def _judged(run: FilterRun) -> BoolArray:
    """Frames whose truth is known, independent of the images, and has settled; (K,)."""
    judged_frames: BoolArray = np.isfinite(run.true_positions).all(axis=1) & run.truth_from.has_settled(run.timestamps)
    return judged_frames & run.truth_from.counts_as_truth


# Claims.


@dataclass(frozen=True, eq=False)
class DriveResults:
    """Drives of one setting: every filter on each of them."""

    setting: drives.Setting
    by_drive: list[Arrays]

    def of(self, name: str, R: str, quantity: str) -> FloatArray:
        """A quantity of each drive, (S,); of one real drive with windows, of each window."""
        values = [np.atleast_1d(arrays[f"{name}.{R}.{quantity}"]) for arrays in self.by_drive]
        return np.concatenate(values)

    @property
    def is_one(self) -> bool:
        """Whether this is a single real recording."""
        return self.setting.place == REAL

    def interval(self, name: str, R: str, quantity: str, of: Callable[[FloatArray], Interval]) -> Interval:
        """A quantity with its interval over the drives; of one recording the value alone, as it is."""
        values = self.of(name, R, quantity)
        return Interval(*[abs(float(values[0]))] * 3) if self.is_one else of(values)

    def consistency(self, name: str, R: str) -> Interval:
        """Pose NEES / 6 with its interval."""
        values = self.of(name, R, "pose_nees")
        return single_interval(float(values[0])) if self.is_one else mean_interval(values)

    def ratio(self, ours: tuple[str, str], theirs: tuple[str, str]) -> Interval:
        """Position error of one filter and R over that of another: over drives, or over the windows of a recording."""
        quantity = "motion" if self.is_one else "position"
        return ratio_interval(self.of(*ours, quantity), self.of(*theirs, quantity))


def settings(results: Mapping[str, Arrays]) -> list[DriveResults]:
    """The drives that there are results of, simulated ones first."""
    by_key = drives.settings_of(results, drives.DRIVE)
    return [DriveResults(drives.setting(key), by_drive) for key, by_drive in by_key.items()]


def example_course(results: Mapping[str, Arrays]) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Estimated and true course of the first drive under independent pixels, by the paper's filter with the right R."""
    arrays = results[f"{drives.DRIVE}.{PIXELS}.0000"]
    estimated, true = (
        {name.removeprefix(f"{who}."): values for name, values in arrays.items() if name.startswith(f"{who}.")}
        for who in ("said", "true")
    )
    return estimated, true


def judge(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims of section 4.4, and of the sections that need its drives."""

    def of(
        name: str, quantity: str, interval: Callable[[FloatArray], Interval] = mean_interval
    ) -> Callable[[DriveResults], Measured]:
        def measured(one: DriveResults) -> Measured:
            levels = one.setting.levels if name in WITH_BOTH else (one.setting.right,)
            variant = "aligned" if quantity == "position" and one.is_one else quantity
            for R in levels:
                yield {"R": ASSUMED_NAMES[R]}, one.interval(name, R, variant, interval)

        return measured

    def consistent(one: DriveResults, name: str = JOINT) -> Measured:
        for R in one.setting.levels if name in WITH_BOTH else (one.setting.right,):
            about = {"R": ASSUMED_NAMES[R]}
            yield {**about, "by": "pose error"}, one.consistency(name, R)
            if one.is_one and name in WINDOWED:
                yield {**about, "by": "motion over 1 s"}, mean_interval(one.of(name, R, "windows") / 6.0)
            elif name == JOINT:
                yield {**about, "by": "innovations"}, mean_interval(one.of(name, R, "nis"))

    def against(one: DriveResults) -> Measured:
        for words, (ours, theirs) in one.setting.pairs.items():
            for rival in (DUAL, PAZ):
                about = {"R": words, "competitor": FILTER_NAMES[rival]}
                yield about, one.ratio((JOINT, ours), (rival, theirs))

    def ratio_to(rival: str) -> Callable[[DriveResults], Measured]:
        def measured(one: DriveResults) -> Measured:
            yield {}, one.ratio((JOINT, one.setting.right), (rival, one.setting.right))

        return measured

    def lost(one: DriveResults) -> Measured:
        for R in one.setting.levels:
            diverged = one.of(JOINT, R, "diverged")
            diverged = diverged[np.isfinite(diverged)]
            if len(diverged):
                count = int(diverged.sum())
                alone = Interval(*[float(count)] * 3)
                yield {"R": ASSUMED_NAMES[R]}, alone if one.is_one else share_interval(count, len(diverged))

    quantities: dict[str, Callable[[DriveResults], Measured]] = {
        "trajectory": of(JOINT, "position"),
        "drift": of(JOINT, "drift"),
        "yaw": of(JOINT, "yaw"),
        "velocity": of(JOINT, "velocity"),
        "odometry-truth": of(ODOMETRY, "position"),
        "scale": of(JOINT, "scale", rms_interval),
        "monocular-scale": of(MONOCULAR, "late_scale", rms_interval),
        "consistent": consistent,
        "no-divergence": lost,
        "landmark-noise": lambda one: of(JOINT, "landmark_nees")(one) if one.setting.place == SIMULATION else (),
        "paz-consistent": partial(consistent, name=PAZ),
        "xyz-inconsistent": partial(consistent, name=EUCLIDEAN),
        "linear-model": ratio_to(XYZ_POINTS),
        "nonlinearity": ratio_to(POINTS),
        "range-helps": against,
    }
    return drives.judged(quantities, settings(results))
