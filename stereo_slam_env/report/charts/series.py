"""Data of the charts, computed from runs: time axes, errors, averages over runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from stereo_slam_env.evaluation.results import FilterRun

Quantity = Callable[[FilterRun], FloatArray]
"""A per-frame quantity of a run, (K,)."""


def by_filter(runs: Sequence[FilterRun]) -> dict[str, list[FilterRun]]:
    """Group the runs by filter, both in order of appearance."""
    groups: dict[str, list[FilterRun]] = {}
    for run in runs:
        groups.setdefault(run.filter_name, []).append(run)
    return groups


def first_recording(runs: Sequence[FilterRun]) -> list[FilterRun]:
    """Pick the runs of all filters on the first recording."""
    key = (runs[0].recording_name, runs[0].seed)
    return [run for run in runs if (run.recording_name, run.seed) == key]


def elapsed(run: FilterRun) -> FloatArray:
    """Seconds since the first frame; (K,)."""
    return np.asarray(run.timestamps - run.timestamps[0], dtype=np.float64)


def scored(run: FilterRun) -> BoolArray:
    """Frames with a true and an estimated pose; (K,)."""
    poses = (run.positions, run.orientations, run.true_positions, run.true_orientations)
    return np.asarray(np.isfinite(np.hstack(poses)).all(axis=1), dtype=np.bool_)


def reference_name(run: FilterRun) -> str:
    """Name of the true poses of a run."""
    return "truth" if run.reference.is_independent else "reference"


def distance(run: FilterRun) -> FloatArray:
    """Measure the true distance travelled, m; (K,), NaN in frames without truth."""
    travelled = np.full(len(run), np.nan)
    has_truth = np.isfinite(run.true_positions).all(axis=1)
    steps = np.linalg.norm(np.diff(run.true_positions[has_truth], axis=0), axis=1)
    if has_truth.any():
        travelled[has_truth] = np.concatenate([[0.0], np.cumsum(steps)])
    return travelled


def map_axes(track: FloatArray) -> tuple[int, int]:
    """Axes of W to draw across and up for a track (N, 3) seen from above: long drives lie on their side."""
    if not len(track):
        return 0, 2
    extent_x, _, extent_z = np.ptp(track, axis=0)
    return (2, 0) if extent_z > extent_x else (0, 2)


def position_error(run: FilterRun) -> FloatArray:
    """Length of the position error without alignment, m; (K,), NaN where it is unknown."""
    return np.asarray(np.linalg.norm(run.true_positions - run.positions, axis=1), dtype=np.float64)


def belief_error(run: FilterRun) -> tuple[FloatArray, FloatArray]:
    """Error of the `PoseBelief` (K, 6), NaN where unknown, and the standard deviation it claims (K, 6).

    [p_true - p_est in W, m ; Log(R_est^T R_true) in the camera frame, rad].
    """
    error = np.full((len(run), 6), np.nan)
    is_scored = scored(run)
    error[:, :3] = run.true_positions - run.positions
    if is_scored.any():
        r_cw_est = Rotation.from_quat(run.orientations[is_scored]).inv()
        error[is_scored, 3:] = (r_cw_est * Rotation.from_quat(run.true_orientations[is_scored])).as_rotvec()
    variance = np.diagonal(run.pose_covariances, axis1=1, axis2=2)
    with np.errstate(invalid="ignore"):
        return error, np.sqrt(variance)


def heading(orientations: FloatArray) -> FloatArray:
    """Return the yaw of the viewing direction about y, rad, without jumps; (K, 4) -> (K,), NaN if unknown."""
    yaw = np.full(len(orientations), np.nan)
    finite = np.isfinite(orientations).all(axis=1)
    if finite.any():
        forward = Rotation.from_quat(orientations[finite]).apply([0.0, 0.0, 1.0])
        yaw[finite] = np.unwrap(np.arctan2(forward[:, 0], forward[:, 2]))
    return yaw


def stack(runs: Sequence[FilterRun], quantity: Quantity, frames: int | None = None) -> FloatArray:
    """Make an (N, K) table of a per-frame quantity; runs shorter than `frames` end in NaN."""
    table = np.full((len(runs), frames or max(len(run) for run in runs)), np.nan)
    for row, run in zip(table, runs, strict=True):
        row[: len(run)] = quantity(run)
    return table


def column_mean(table: FloatArray) -> FloatArray:
    """Mean over runs of what is known; (N, K) -> (K,), NaN where nothing is."""
    return _over_runs(np.nanmean, table)


def column_median(table: FloatArray) -> FloatArray:
    """Median over runs of what is known; (N, K) -> (K,), NaN where nothing is."""
    return _over_runs(np.nanmedian, table)


def _over_runs(average: Callable[..., FloatArray], table: FloatArray) -> FloatArray:
    result = np.full(table.shape[1], np.nan)
    has_value = np.isfinite(table).any(axis=0)
    result[has_value] = average(np.where(np.isfinite(table), table, np.nan)[:, has_value], axis=0)
    return result


def peak(values: ArrayLike) -> float:
    """Largest finite absolute value, NaN if there is none."""
    finite = np.abs(_finite(values))
    return float(finite.max()) if finite.size else float("nan")


def last_known(values: ArrayLike) -> float:
    """Last finite value, NaN if there is none."""
    finite = _finite(values)
    return float(finite[-1]) if finite.size else float("nan")


def thinned(values: ArrayLike, most: int) -> IntArray:
    """Indices of the points to draw: of each stretch the first, the lowest and the highest, so that no peak is lost."""
    y = np.asarray(values, dtype=np.float64)
    if len(y) <= most:
        return np.arange(len(y))
    keep = {0, len(y) - 1}
    for stretch in np.array_split(np.arange(len(y)), most // 3):
        gaps = ~np.isfinite(y[stretch])
        keep.add(int(stretch[np.argmax(gaps)]))  # a gap, where there is one
        if not gaps.all():
            keep |= {int(stretch[np.nanargmin(y[stretch])]), int(stretch[np.nanargmax(y[stretch])])}
    return np.array(sorted(keep), dtype=np.int64)


def _finite(values: ArrayLike) -> FloatArray:
    numbers = np.asarray(values, dtype=np.float64)
    return numbers[np.isfinite(numbers)]
