"""Files of the whole state that OpenVINS writes with `save_total_state`: `state_estimate.txt` and its deviations.

Source: `ROSVisualizerHelper::sim_save_total_state_to_file` of rpng/open_vins (ov_msckf/src/ros), v2.7. A row of
`state_estimate.txt`, and of `state_groundtruth.txt`: time of the IMU (s, 5 decimals); q_GtoI as JPL has it, xyzw; p of
the IMU in G, m; v in G, m/s; gyro bias, rad/s; accelerometer bias, m/s^2 (6 decimals); then the calibration, of as many
numbers as there are cameras. A row of `state_deviation.txt`: the time, and the standard deviations of rotation,
position, velocity and biases, three each.

A JPL quaternion of R_GtoI has the numbers of the Hamilton quaternion of its inverse, R_wb, which is what we have. The
error is q = [theta / 2; 1] (x) q^, R_GtoI ~ Exp(-theta) R^_GtoI (`JPLQuat.h`): so R_wb ~ R^_wb Exp(theta), and theta is
twice the vector part over the scalar part: "position-quaternion" of `Tangent`. The errors of all others add.

OpenVINS turns its world along gravity and starts at a heading of its own: the gauge of an estimate is "gravity_yaw".
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.files.readers import parse_table, read_text
from stereo_slam_env.recording.state_beliefs import STATE_COLUMNS, states_of
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_layouts import seconds_of
from stereo_slam_env.recording.trajectory_transforms import assembled

_HEADER = re.compile(r"\s*#\s*timestamp\S*\s+q\s+p\s+v\s+bg\s+ba\b")
_STATE, _DEVIATION = 17, 16
"""Numbers of a row before the calibration."""
_ROUNDED = 1e-5
"""Deviations below it, of six decimals, are off by 5 % or more."""


def is_total_state(text: str) -> bool:
    """Whether a text begins as these files do."""
    return _HEADER.match(text) is not None


def read_total_state(path: Path, text: str) -> Trajectory:
    """Read the trajectory of a state file, with the deviations of the file beside it where there is one.

    That is the file whose name has "deviation" for "estimate", or `_std` behind. Its rows belong to those of the same
    time; a pose without deviations claims nothing, and is left out.

    Raises
    ------
    ValueError
        A file is damaged, or the two have no time in common: one line that names it.
    """
    if "deviation" in path.name or path.stem.endswith("_std"):
        raise ValueError(f"{path} has deviations alone: give the file of the estimate, they are read from beside it")
    table = parse_table(path, text, _STATE, only=range(_STATE), finite=False)
    times, notes = seconds_of(table[:, 0], str(path), "s")
    values = dict(zip(STATE_COLUMNS, table[:, 8:].T, strict=True))
    covariances = None
    if (beside := _beside(path)) is not None:
        deviations, more = _at_times(*beside, table[:, 0])
        notes += more
        covariances = deviations[:, [3, 4, 5, 0, 1, 2], None] ** 2 * np.eye(6)
        values |= {f"sigma_{name}": column for name, column in zip(STATE_COLUMNS, deviations[:, 6:].T, strict=True)}
    states, about_states = states_of(values)
    return assembled(
        str(path),
        table[:, 5:8],
        table[:, 1:5],
        timestamps=times,
        covariances=covariances,
        tangent="position-quaternion",
        name=path.stem,
        gauge=None if covariances is None else "gravity_yaw",
        states=states,
        notes=[*notes, *about_states],
    )


def _beside(path: Path) -> tuple[Path, str] | None:
    """The file of the deviations that belongs to a state file, and its text."""
    names = [path.with_name(f"{path.stem}_std{path.suffix}")]
    if "estimate" in path.name:
        names.insert(0, path.with_name(path.name.replace("estimate", "deviation")))
    for other in names:
        try:
            return other, read_text(other)
        except FileNotFoundError:
            continue
    return None


def _at_times(path: Path, text: str, times: FloatArray) -> tuple[FloatArray, list[str]]:
    """Deviations (K, 15) at the times (K,) of the estimate, NaN where there are none, and notes."""
    table = parse_table(path, text, _DEVIATION, only=range(_DEVIATION), finite=False)
    if (bad := np.flatnonzero((table[:, 1:] < 0.0).any(axis=1))).size:
        raise ValueError(f"{path} has a negative deviation in row {bad[0]}: it is no file of deviations")
    _, mine, rows = np.intersect1d(times, table[:, 0], return_indices=True)
    if not mine.size:
        raise ValueError(f"{path} has no time of the estimate beside it: give the deviations of the same run")
    deviations = np.full((len(times), _DEVIATION - 1), np.nan)
    deviations[mine] = table[rows, 1:]
    notes = [
        f"its covariances are diagonal, of the deviations in {path.name}: what is claimed of the whole pose lacks "
        "correlations; position, rotation, velocity and biases are judged one by one, too"
    ]
    if lacking := len(times) - len(mine):
        notes.append(f"{lacking} of {len(times)} rows have no deviations in {path.name}")
    if (np.nanmedian(deviations, axis=0) < _ROUNDED).any():
        notes.append(f"deviations below {_ROUNDED:g} in {path.name} are rounded to six decimals: their NEES is rough")
    return deviations, notes
