"""Files of trajectories: texts in the layouts of `trajectory_layouts`, bags, and the header of SQUARE 0.3.

SQUARE has `#%KEY value` lines, then the row of TUM and the lower triangle of the 6x6 covariance, row by row, 21
numbers; or the row of TUM alone ("deterministic").

SQUARE (Rønning, `smfeval` 0.4, 2026) knows the logarithms of SE(3) on either side. Errors whose position part is a
displacement are its right perturbation to first order; a further key, TANGENT_CHART, which other readers skip, says
which they are, so that a NEES comes out to the last digit. DRIFT_WHITE and DRIFT_LASTING, 6 variances each, say what
the errors of two poses of an odometry have in common, see `drift`.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import astuple, replace
from functools import partial
from pathlib import Path
from typing import IO, Any, get_args

import numpy as np

from filters.geometry import rotations
from filters.motions.motion_model import POSE_SIZE
from stereo_slam_env.files.folders import write_atomically
from stereo_slam_env.files.readers import read_text
from stereo_slam_env.recording.openvins_states import is_total_state, read_total_state
from stereo_slam_env.recording.recording import DriftParts, drift_of
from stereo_slam_env.recording.trajectory import Gauge, Tangent, Trajectory, tangent_jacobian, transformed
from stereo_slam_env.recording.trajectory_bags import bag_and_topic, read_bag
from stereo_slam_env.recording.trajectory_layouts import KNOWN, SQUARE_COLUMNS, UNNAMED, split_columns, trajectory_of

FORMAT = "SQUARE/0.3"
_LOWER = np.tril_indices(POSE_SIZE)
_CHARTS: Mapping[str, Tangent] = {
    "position_rotation_vector": "position-rotation",
    "position_quaternion": "position-quaternion",
}
_NAMES = {tangent: chart for chart, tangent in _CHARTS.items()}
_SIDES: Mapping[str, Tangent] = {"right_perturbation": "right", "left_perturbation": "left"}
_ORDERS = {"translation_rotation": np.arange(POSE_SIZE), "rotation_translation": np.array([3, 4, 5, 0, 1, 2])}
_NO_BODY = "body"
"""What stands in a header where the body is not said."""
_DRIFT = ("DRIFT_WHITE", "DRIFT_LASTING")
_GAUGES: Mapping[str, Gauge] = {gauge: gauge for gauge in get_args(Gauge)}


def load_trajectory(path: str | Path) -> Trajectory:
    """Read a trajectory of any layout or bag; which, its header, its names of columns or their number say.

    Parameters
    ----------
    path : str or Path
        The file; of a bag (`.bag`, `.db3`, `.mcap`, a folder with `metadata.yaml`) also `FILE:/topic`.

    Returns
    -------
    Trajectory
        Named after the file, or as its header says; `notes` says what was left out.

    Raises
    ------
    ValueError
        The file is missing, of another format, or damaged: one line that names it.
    ImportError
        A bag, and `rosbags` is missing.
    """
    if (bag := bag_and_topic(path)) is not None:
        return read_bag(*bag)
    path = Path(path)
    try:
        text = read_text(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path} does not exist: give a trajectory ({KNOWN}) or a bag") from error
    if is_total_state(text):
        return read_total_state(path, text)
    header = _header(path, text)
    if not header:
        return trajectory_of(split_columns(path, text), {"name": path.stem, "gauge": None})
    about = _about(path, header)
    names, order, drift = about.pop("names"), about.pop("order"), about.pop("drift")
    trajectory = trajectory_of(split_columns(path, text, names), about)
    if trajectory.covariances is not None:
        trajectory = replace(trajectory, covariances=trajectory.covariances[:, order[:, None], order])
        if drift is not None:
            trajectory = replace(trajectory, drift=drift_of(trajectory.positions, trajectory.orientations, drift))
    return trajectory if trajectory.tangent in _SIDES.values() else _turned(trajectory, into_body=False)


def save_trajectory(path: str | Path, trajectory: Trajectory) -> None:
    """Write a trajectory; the file appears complete or not at all.

    Parameters
    ----------
    path : str or Path
        By its ending: ".tum", ".kitti", which has no times and no covariances, or ".square", with all there is.
    trajectory : Trajectory
        With times, but for KITTI.

    Raises
    ------
    ValueError
        The ending is another one, or there are no times.
    """
    path = Path(path)
    if path.suffix not in _WRITERS:
        raise ValueError(f"path of a trajectory must end in {', '.join(_WRITERS)}, got {path}")
    if trajectory.timestamps is None and path.suffix != ".kitti":
        raise ValueError(f"trajectory {trajectory.name} has no timestamps: write it as .kitti")
    write_atomically(path, partial(_WRITERS[path.suffix], trajectory))


def _write_tum(trajectory: Trajectory, stream: IO[bytes]) -> None:
    assert trajectory.timestamps is not None
    rows = np.column_stack([trajectory.timestamps, trajectory.positions, trajectory.orientations])
    np.savetxt(stream, rows, fmt="%.9f")


def _write_kitti(trajectory: Trajectory, stream: IO[bytes]) -> None:
    R = rotations.matrix(trajectory.orientations)
    T_wb = np.concatenate([R, trajectory.positions[:, :, None]], axis=2)
    np.savetxt(stream, T_wb.reshape(len(R), -1), fmt="%.9f")


def _write_square(trajectory: Trajectory, stream: IO[bytes]) -> None:
    header = {
        "FORMAT": FORMAT,
        "REPRESENTATION": "deterministic",
        "POSE_FRAME": "world",
        "BODY_FRAME": trajectory.body or _NO_BODY,
        "GAUGE": trajectory.gauge or "fixed",
        "TIMESTAMP_UNIT": "seconds",
        "ALGORITHM": " ".join(trajectory.name.split()) or "unknown",
        "ALGORITHM_VERSION": "unknown",
    }
    assert trajectory.timestamps is not None
    columns = [trajectory.timestamps, trajectory.positions, trajectory.orientations]
    if trajectory.covariances is not None:
        header |= {
            "REPRESENTATION": "gaussian_se3",
            "TANGENT_CONVENTION": "left_perturbation" if trajectory.tangent == "left" else "right_perturbation",
            "TANGENT_ORDER": "translation_rotation",
            "ROTATION_PARAM": "axis_angle",
        }
        header |= {"TANGENT_CHART": chart} if (chart := _NAMES.get(trajectory.tangent)) else {}
        if trajectory.tangent == "right" and trajectory.drift is not None and trajectory.drift.parts is not None:
            for key, numbers in zip(_DRIFT, astuple(trajectory.drift.parts), strict=True):
                header[key] = " ".join(f"{number:.17g}" for number in numbers)
        in_file = trajectory if trajectory.tangent in _SIDES.values() else _turned(trajectory, into_body=True)
        assert in_file.covariances is not None
        columns.append(in_file.covariances[:, _LOWER[0], _LOWER[1]])
    stream.write("".join(f"#%{key} {value}\n" for key, value in header.items()).encode())
    table = np.column_stack(columns)
    np.savetxt(stream, table, fmt=["%.9f", *["%.17g"] * (table.shape[1] - 1)])


_WRITERS = {".tum": _write_tum, ".kitti": _write_kitti, ".square": _write_square}


def _turned(trajectory: Trajectory, *, into_body: bool) -> Trajectory:
    """Turn the displacement of the position from W into the body frame, as files have it, or back."""
    if trajectory.covariances is None:
        return trajectory
    J = tangent_jacobian("right", trajectory.positions, trajectory.orientations)
    return replace(trajectory, covariances=transformed(J if into_body else J.swapaxes(-1, -2), trajectory.covariances))


def _header(path: Path, text: str) -> dict[str, str]:
    """The `#%KEY value` lines before the first row."""
    header: dict[str, str] = {}
    for line in io.StringIO(text):
        if line.strip() and not line.startswith("#"):
            break
        if line.startswith("#%"):
            key, _, value = line[2:].strip().partition(" ")
            if key.upper() in header:
                raise ValueError(f"{path} has two header lines {key.upper()}: remove one")
            header[key.upper()] = value.strip()
    return header


def _about(path: Path, header: Mapping[str, str]) -> dict[str, Any]:
    """Header beyond the numbers, with the names of the columns."""

    def one_of(key: str, known: Mapping[str, Any], usual: str) -> Any:
        value = header.get(key, usual)
        if value not in known:
            raise ValueError(f"{path}: {key} must be one of {', '.join(known)}, got {value!r}")
        return known[value]

    if not header.get("FORMAT", "").startswith("SQUARE/"):
        raise ValueError(f"{path} has a header without FORMAT SQUARE/...: write it as {FORMAT}")
    one_of("TIMESTAMP_UNIT", {"seconds": None}, "seconds")
    one_of("ROTATION_PARAM", {"axis_angle": None}, "axis_angle")
    side = one_of("TANGENT_CONVENTION", _SIDES, "right_perturbation")
    return {
        "names": one_of("REPRESENTATION", {"gaussian_se3": SQUARE_COLUMNS, "deterministic": UNNAMED[8]}, ""),
        "tangent": one_of("TANGENT_CHART", _CHARTS, "") if "TANGENT_CHART" in header else side,
        "order": one_of("TANGENT_ORDER", _ORDERS, "translation_rotation"),
        "gauge": one_of("GAUGE", _GAUGES, "fixed"),
        "name": header.get("ALGORITHM") or path.stem,
        "body": None if header.get("BODY_FRAME") == _NO_BODY else header.get("BODY_FRAME"),
        "drift": _drift_parts(path, header),
    }


def _drift_parts(path: Path, header: Mapping[str, str]) -> DriftParts | None:
    if not any(key in header for key in _DRIFT):
        return None
    parts = []
    for key in _DRIFT:
        try:
            numbers = [float(number) for number in header.get(key, "").split()]
        except ValueError:
            numbers = []
        if len(numbers) != POSE_SIZE or not all(0.0 <= number < np.inf for number in numbers):
            raise ValueError(f"{path}: {key} must be 6 variances, got {header.get(key, 'none')[:60]!r}")
        parts.append(tuple(numbers))
    if header.get("TANGENT_CONVENTION") == "left_perturbation" or "TANGENT_CHART" in header:
        raise ValueError(f"{path}: {_DRIFT[0]} is of a right_perturbation without TANGENT_CHART: write it so")
    return DriftParts(*parts)
