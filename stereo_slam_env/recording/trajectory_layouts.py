"""Columns of trajectories in text files: what each column is, by its name or by the number of columns.

One table of names and one of numbers of columns. A file whose columns have names is read by them, in any order; one
without is read as the only layout that has so many numbers a row. Where several have, the reader is asked.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from filters.geometry import rotations
from filters.geometry.arrays import BoolArray, FloatArray
from filters.motions.model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.files.readers import parse_table, require_rotations, split_poses
from stereo_slam_env.recording.trajectory import Tangent, Trajectory, transformed

_LOWER = [(i, j) for i in range(POSE_SIZE) for j in range(i + 1)]
_POSE = ["t", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]
_MATRIX = [f"m{i}{j}" for i in range(3) for j in range(4)]
_BLOCKS = [f"{kind}{i}{j}" for kind in ("Pr", "Pt") for i in (1, 2, 3) for j in range(i, 4)]
SQUARE_COLUMNS = [*_POSE, *(f"square{i}{j}" for i, j in _LOWER)]
"""Names of the 29 columns under a header of SQUARE: the lower triangle of the covariance, row by row."""

UNNAMED: Mapping[int, Sequence[str]] = {
    7: _POSE[1:],
    8: _POSE,
    12: _MATRIX,
    13: ["number", *_MATRIX],
    17: ["t", "tx", "ty", "tz", "qw", "qx", "qy", "qz", *(f"other{i}" for i in range(9))],
    20: [*_POSE, *_BLOCKS],
    44: [*_POSE, *(f"covariance{i}" for i in range(36))],
}
"""What the columns are of a file that does not say it, by their number: poses alone, TUM, KITTI, KITTI with the frame
number or the time in front, EuRoC, OpenVINS, ROS poses with their 36 covariances."""

KNOWN = (
    "8 numbers a row (TUM), 12 (KITTI), 13 (frame number and KITTI), 17 (EuRoC), 20 (OpenVINS), 7 (x y z qx qy qz qw), "
    "44 (TUM and the 36 covariances of ROS), 29 under a header of SQUARE, or named columns"
)
"""The layouts, in words."""

_NAMES = {
    "t": r"t|ts|time|timestamp|stamp|sec|seconds|(.*\.)?header\.stamp",
    "number": r"frame|frame_?(id|number|index)",
    **{f"t{a}": rf"(.*position[._]|[tp]_?|pos_?|p_rs_r_)?{a}" for a in "xyz"},
    **{f"q{a}": rf"(.*orientation[._]|q_?|q_rs_|quat_?){a}" for a in "xyzw"},
    **{f"Pt{i}{j}": rf"pt{i}{j}|p{a}{b}" for i, a in enumerate("xyz", 1) for j, b in enumerate("xyz", 1)},
    **{f"Pr{i}{j}": rf"pr{i}{j}|q{a}{b}" for i, a in enumerate("rpy", 1) for j, b in enumerate("rpy", 1)},
    "tracks": r"(n_?|num_?)?(tracks|inliers)",
    **{f"covariance{i}": rf"(?!.*twist).*cov(ariance)?[._\[]?{i}\]?" for i in range(36)},
}
"""Names that columns are known by, as patterns, in small letters and without units."""
_UNITS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
_BY_SIZE = ((1e17, 1e-9, "nanoseconds"), (1e14, 1e-6, "microseconds"), (1e11, 1e-3, "milliseconds"))
"""Times since 1970 from so many on are in that unit: in the next larger one they would be 3000 years away or more."""
_ERRORS: Mapping[str, tuple[Tangent, bool]] = {
    "type1": ("position-rotation", False),
    "type5": ("position-rotation", False),
    "type2": ("position-rotation", True),
    "type6": ("position-rotation", True),
}
"""Types of errors of cnspy whose position is in R(3): the definition, and whether the rotation is about fixed axes."""


@dataclass(frozen=True)
class Columns:
    """The numbers of a text file, by what they are."""

    path: Path
    """The file."""
    values: Mapping[str, FloatArray]
    """(K,) each, by the names of `UNNAMED`."""
    words: Mapping[str, str]
    """Text of the first row, by the name of its column."""
    seconds: float | None
    """Unit of the times, s, where the file says it."""

    def block(self, kind: str, rows: int, columns: int) -> FloatArray:
        """(K, rows, columns) of the values whose names are the kind and a position."""
        grid = [self.values[f"{kind}{i}{j}"] for i in range(rows) for j in range(columns)]
        return np.stack(grid, axis=1).reshape(-1, rows, columns)


def split_columns(path: Path, text: str, names: Sequence[str] | None = None) -> Columns:
    """The columns of a text read from `path`, by the names that it gives them, or by their number.

    `names` are those that a header outside of the table says.

    Raises
    ------
    ValueError
        No layout has such columns, or a row is damaged: one line that names the file.
    """
    lines = text.splitlines()
    first = next((i for i, line in enumerate(lines) if line.strip() and line.lstrip()[0] not in "#%"), None)
    if first is None:
        raise ValueError(f"{path} has no rows: a trajectory has {KNOWN}")
    delimiter = next((mark for mark in (",", ";") if mark in lines[first]), None)
    cells = _cells(lines[first], delimiter)
    titles, above = cells, first + 1
    if any(map(_is_number, cells)):
        titles, above = (_cells(lines[first - 1].lstrip("#% "), delimiter) if first else []), first
    elif len(lines) > above:
        cells = _cells(lines[above], delimiter)
    named = [_name_and_unit(title) for title in titles]
    known = _known([name for name, _ in named])
    if not set(_POSE[1:]) <= set(known) or len(named) != len(cells):
        named = []
        if not any(map(_is_number, cells)):
            raise ValueError(f"{path} is no trajectory: its first row is {lines[first][:60]!r}, not {KNOWN}")
        usual = names or UNNAMED.get(len(cells))
        if usual is None:
            raise ValueError(f"{path} has {len(cells)} columns{_asked(len(cells))}")
        if len(usual) != len(cells):
            raise ValueError(f"{path} has {len(cells)} columns where its header has {len(usual)}")
        known = {name: i for i, name in enumerate(usual)}
    only = list(known.values())
    table = parse_table(path, "\n".join(lines[above:]), len(only), delimiter=delimiter, only=only)
    words = {name: cell for (name, _), cell in zip(named, cells, strict=False) if not _is_number(cell)}
    unit = named[known["t"]][1] if named and "t" in known else ""
    return Columns(path, dict(zip(known, table.T, strict=True)), words, _UNITS.get(unit))


def trajectory_of(columns: Columns, about: Mapping[str, Any]) -> Trajectory:
    """The trajectory that the columns hold; `about` is what is known beside them, as of `Trajectory`.

    Raises
    ------
    ValueError
        The numbers are no trajectory: one line that names the file.
    """
    values, path, notes = columns.values, columns.path, []
    if "m00" in values:
        matrices = columns.block("m", 3, 4)
        require_rotations(path, matrices)
        positions, orientations = split_poses(matrices)
    else:
        positions = np.stack([values[f"t{a}"] for a in "xyz"], axis=1)
        orientations = np.stack([values[f"q{a}"] for a in "xyzw"], axis=1)
    times, numbers = values.get("t"), values.get("number")
    if numbers is not None and (numbers != np.round(numbers)).any():
        times, numbers = numbers, None  # 13 columns with the time in front
    if times is not None:
        scale, note = _seconds(columns.seconds, times)
        times = times * scale
        notes += note
    covariances, how = _covariances(columns)
    notes += how.pop("notes", [])
    kept = np.ones(len(positions), dtype=bool)
    for along, what in ((times, "time"), (numbers, "frame number")):
        if along is not None:
            kept = _first_of_each(along)
            if repeated := int(np.count_nonzero(~kept)):
                notes.append(f"{repeated} of {len(kept)} rows repeat the {what} of the row before: the first counts")
            break
    parts = {
        "timestamps": times,
        "covariances": covariances,
        "tracks": values.get("tracks"),
        "frame_numbers": None if times is not None or numbers is None else numbers.astype(np.int64),
    }
    parts = {name: None if part is None else part[kept] for name, part in parts.items()}
    try:
        return Trajectory(positions[kept], orientations[kept], **{**parts, **how, **about, "notes": tuple(notes)})
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def about_fixed_axes(orientations: FloatArray, covariances: FloatArray) -> FloatArray:
    """Covariances (K, 6, 6) whose rotation is about the axes of the world, as ROS has it, for that in the body."""
    J = np.tile(np.eye(POSE_SIZE), (len(orientations), 1, 1))
    J[:, ROTATION, ROTATION] = rotations.matrix(orientations).swapaxes(-1, -2)
    return transformed(J, covariances)


def claim_of_ros(orientations: FloatArray, covariances: FloatArray) -> dict[str, Any]:
    """What 36 covariances of ROS (K, 6, 6) claim: `covariances`, `plane` and `notes` of the trajectory.

    All zero, or negative in front, they are not known. Those of a robot in the plane are zero, or too large to say
    anything, for z, roll and pitch: what is claimed is x, y and yaw, and the others are given the size of these.
    """
    if not covariances.any():
        return {"notes": ["its covariances are all zero, which says that they are not known"]}
    if (covariances[:, 0, 0] < 0).all():
        return {"notes": ["its covariances are marked as not known (-1)"]}
    variances = np.abs(np.diagonal(covariances, axis1=1, axis2=2))
    unknown = (variances == 0.0).all(axis=0) | (variances >= _SAYS_NOTHING).all(axis=0)
    axes = [axis for axis, is_unknown in zip(_AXES, unknown.tolist(), strict=True) if is_unknown]
    if not axes:
        return {"covariances": about_fixed_axes(orientations, covariances)}
    words = f"its covariances are zero, or too large to say anything, for {', '.join(axes)}"
    if tuple(axes) != _AXES[2:5]:
        return {"notes": [f"{words}, so there is none of a pose: not judged"]}
    filled = np.zeros_like(covariances)
    filled[:, _IN_PLANE[:, None], _IN_PLANE] = covariances[:, _IN_PLANE[:, None], _IN_PLANE]
    filled[:, 2, 2] = 0.5 * (variances[:, 0] + variances[:, 1])
    filled[:, 3, 3] = filled[:, 4, 4] = variances[:, 5]
    return {
        "covariances": about_fixed_axes(orientations, filled),
        "plane": np.eye(3),
        "notes": [f"{words}: it is judged in the plane, by x, y and yaw"],
    }


def _covariances(columns: Columns) -> tuple[FloatArray | None, dict[str, Any]]:
    """Covariances (K, 6, 6) of the columns, and what they are of; position part first."""
    values = columns.values
    count = len(next(iter(values.values())))
    found = np.zeros((count, POSE_SIZE, POSE_SIZE))
    if "square00" in values:
        for i, j in _LOWER:
            found[:, i, j] = found[:, j, i] = values[f"square{i}{j}"]
        return found, {}
    if "qx" not in values:
        return None, {}
    orientations = np.stack([values[f"q{a}"] for a in "xyzw"], axis=1)
    if all(f"covariance{i}" in values for i in range(36)):
        found = np.stack([values[f"covariance{i}"] for i in range(36)], axis=1).reshape(-1, POSE_SIZE, POSE_SIZE)
        claim = claim_of_ros(orientations, found)
        if "covariances" in claim:
            claim["notes"] = [
                "its covariances are read as those of ROS poses: the rotation about the axes of the world",
                *claim.get("notes", []),
            ]
        return claim.pop("covariances", None), claim
    if not all(name in values for name in _BLOCKS):
        return None, {}
    for part, kind in ((POSITION, "Pt"), (ROTATION, "Pr")):
        for i in (1, 2, 3):
            for j in range(i, 4):
                block = found[:, part, part]
                block[:, i - 1, j - 1] = block[:, j - 1, i - 1] = values[f"{kind}{i}{j}"]
    error = columns.words.get("est_err_type", "type5")
    if error not in _ERRORS or columns.words.get("err_representation", "theta_so3") not in _REPRESENTATIONS:
        said = f"{error}, {columns.words.get('err_representation')}"
        raise ValueError(
            f"{columns.path} has covariances of errors ({said}) that are not read: "
            f"give one of {', '.join(_ERRORS)} with one of {', '.join(_REPRESENTATIONS)}"
        )
    tangent, fixed_axes = _ERRORS[error]
    return about_fixed_axes(orientations, found) if fixed_axes else found, {"tangent": tangent}


_AXES = ("x", "y", "z", "roll", "pitch", "yaw")
_IN_PLANE = np.array([0, 1, 5])
_SAYS_NOTHING = np.array([1e3, 1e3, 1e3, 10.0, 10.0, 10.0])
"""m^2 and rad^2: variances that are never smaller are written by those who do not estimate an axis."""
_REPRESENTATIONS = ("theta_R", "theta_q", "theta_so3", "R_small_theta", "q_small_theta", "so3_theta", "none")


def _seconds(stated: float | None, times: FloatArray) -> tuple[float, list[str]]:
    """Unit of times, s: as stated, or by their size."""
    if stated is not None:
        return stated, []
    middle = float(np.median(np.abs(times)))
    for least, unit, name in _BY_SIZE:
        if middle >= least:
            return unit, [f"its times, of the size of {middle:.0e}, are read as {name}"]
    return 1.0, []


def _first_of_each(values: FloatArray) -> BoolArray:
    """Which of (K,) values are not those of the row before."""
    return np.concatenate([[True], np.diff(values) != 0])


def _asked(count: int) -> str:
    if count == len(SQUARE_COLUMNS):
        return (
            " and no header: is the covariance of the right or the left perturbation, and which part comes first? "
            "Write '#%FORMAT SQUARE/0.3', '#%REPRESENTATION gaussian_se3', '#%TANGENT_CONVENTION right_perturbation' "
            "(or left_perturbation) and '#%TANGENT_ORDER translation_rotation' (or rotation_translation) above it"
        )
    return f": a trajectory has {KNOWN}"


def _known(names: Sequence[str]) -> dict[str, int]:
    """Which column has what, by the names of the columns; the last one where two have the same."""
    return {key: i for key, how in _NAMES.items() for i, name in enumerate(names) if re.fullmatch(how, name)}


def _cells(line: str, delimiter: str | None) -> list[str]:
    return [cell.strip() for cell in line.rstrip().rstrip(delimiter).split(delimiter)]


def _name_and_unit(title: str) -> tuple[str, str]:
    """A column's name in small letters, and its unit in brackets, where it has one."""
    unit = re.search(r"[\[(]\s*([^\[\]()\d]*?)\s*[\])]\s*$", title)
    name = re.sub(r"\s*[\[(][^\[\]()\d]*[\])]\s*$", "", title.strip().lstrip("#%"))
    return name.strip().lower(), unit[1].lower() if unit else ""


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
