"""Columns and times of trajectories in text files: what each column is, by its name or by the number of columns.

One table of names and one of numbers of columns. A file whose columns have names is read by them, in any order; one
without is read as the only layout that has so many numbers a row. Where several have, the reader is asked.

Times have their unit by size where none is stated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE, POSITION, ROTATION
from stereo_slam_env.files.readers import parse_table, split_poses
from stereo_slam_env.recording.state_beliefs import STATE_COLUMNS, STATE_NAMES, states_of
from stereo_slam_env.recording.trajectory import Tangent, Trajectory
from stereo_slam_env.recording.trajectory_transforms import about_fixed_axes, assembled

UNITS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
"""Units of time by their names, s."""
BY_SIZE = ((1e17, 1e-9, "nanoseconds"), (1e14, 1e-6, "microseconds"), (1e11, 1e-3, "milliseconds"))
"""Times since 1970 from so many on are in that unit: in the next larger one they would be 3000 years away or more."""
SLOWEST, FASTEST = 0.1, 1000.0
"""Hz, of anything that moves with a camera: others are a mistaken unit."""
_NEIGHBOURS = 11
"""Messages whose median stamp says where that of the middle one should be ..."""
_ASTRAY_S, _ASTRAY_STEPS = 1.0, 20.0
"""... and by how much, the larger of the two, it may be away."""


def seconds_of(numbers: FloatArray | IntArray, what: str, unit: str = "") -> tuple[FloatArray, list[str]]:
    """Times (K,) in s of numbers in a stated unit of `UNITS`, or in the one that their size says; and notes.

    Raises
    ------
    ValueError
        Their rate is none of a camera's: one line that opens with `what` and says the likely unit.
    """
    stated = UNITS.get(unit)
    scale, notes = scale_of(numbers) if stated is None else (stated, [])
    times = np.asarray(numbers, dtype=np.float64) * scale
    require_rate(times, what)
    return times, notes


def scale_of(numbers: FloatArray | IntArray) -> tuple[float, list[str]]:
    """Unit of times (K,), s, by their size, and a note where it is another than the second."""
    middle = float(np.median(np.abs(numbers))) if len(numbers) else 0.0
    for least, scale, name in BY_SIZE:
        if middle >= least:
            return scale, [f"its times, of the size of {middle:.0e}, are read as {name}"]
    return 1.0, []


def require_rate(times: FloatArray, what: str) -> None:
    """Raise a `ValueError` where times (K,), s, in the usual case are closer or farther apart than a camera's can be.

    Times that repeat or descend are not looked at: who reads them says what is wrong.
    """
    steps = np.diff(times)
    steps = steps[steps > 0.0]
    if not steps.size:
        return
    step = float(np.median(steps))
    if 0.999 / FASTEST <= step <= 1.001 / SLOWEST:
        return
    likely = [
        f"as {name} they would be at {1.0 / (step * unit):.3g} Hz"
        for unit, name in (
            *((1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")),
            *((1e3, "times of a unit 1000 times as long"), (1e6, "times of a unit a million times as long")),
        )
        if 1.0 <= 1.0 / (step * unit) <= 500.0
    ]
    raise ValueError(
        f"{what}: its times are {step:.3g} s apart, at {1.0 / step:.3g} Hz, where {SLOWEST:g} to {FASTEST:g} Hz are "
        f"read: {likely[0] + ', so ' if likely else ''}write them in seconds"
    )


def message_times(stamps: IntArray, logged: IntArray) -> tuple[IntArray, BoolArray, list[str]]:
    """Times (K,) of messages in the order of their log, which of them are to be read, and notes.

    Parameters
    ----------
    stamps, logged : (K,) ints
        Stamps in the headers and times of the log, ns. Stamps that are all the same, or zero, are no clock, and the log
        takes their place; single ones far from those before and after are left out.
    """
    count = len(stamps)
    is_kept = np.ones(count, dtype=bool)
    if count > 1 and (2 * len(np.unique(stamps)) < count or 2 * np.count_nonzero(stamps == 0) > count):
        why = "zero" if 2 * np.count_nonzero(stamps == 0) > count else "repeated"
        return logged, is_kept, [f"its stamps are {why} in most messages: the times of the log are taken"]
    if count < _NEIGHBOURS:
        return stamps, is_kept, []
    seconds = 1e-9 * (stamps - np.median(stamps).astype(np.int64))
    away = np.abs(seconds - median_filter(seconds, size=_NEIGHBOURS, mode="mirror"))
    in_order = seconds >= np.maximum.accumulate(seconds)
    in_order &= seconds <= np.minimum.accumulate(seconds[::-1])[::-1]
    limit = max(_ASTRAY_S, _ASTRAY_STEPS * float(np.median(np.abs(np.diff(seconds)))))
    is_kept = in_order | (away <= limit)
    is_kept[[0, -1]] &= np.abs(seconds[[0, -1]] - seconds[[1, -2]]) <= limit  # one alone is in any order
    if (stamps == 0).any() and 1e-9 * float(stamps[stamps != 0].min()) > limit:
        is_kept &= stamps != 0  # no times, beside others that are
        away = np.where(stamps == 0, 1e-9 * np.median(stamps), away)
    if is_kept.all():
        return stamps, is_kept, []
    worst = float(away[~is_kept].max())
    return (
        stamps,
        is_kept,
        [
            f"{np.count_nonzero(~is_kept)} of {count} stamps are up to {worst:.3g} s from those before and after: "
            "left out"
        ],
    )


_LOWER = [(i, j) for i in range(POSE_SIZE) for j in range(i + 1)]
_POSE = ["t", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]
_MATRIX = [f"m{i}{j}" for i in range(3) for j in range(4)]
_BLOCKS = [f"{kind}{i}{j}" for kind in ("Pr", "Pt") for i in (1, 2, 3) for j in range(i, 4)]
SQUARE_COLUMNS = [*_POSE, *(f"square{i}{j}" for i, j in _LOWER)]
"""Names of the 29 columns under a header of SQUARE: the lower triangle of the covariance, row by row."""

UNNAMED: Mapping[int, Sequence[str]] = {
    3: _POSE[1:4],
    4: _POSE[:4],
    7: _POSE[1:],
    8: _POSE,
    11: ["t", "tx", "ty", "tz", "qw", "qx", "qy", "qz", *STATE_COLUMNS[:3]],
    12: _MATRIX,
    13: ["number", *_MATRIX],
    17: ["t", "tx", "ty", "tz", "qw", "qx", "qy", "qz", *STATE_COLUMNS],
    20: [*_POSE, *_BLOCKS],
    44: [*_POSE, *(f"covariance{i}" for i in range(36))],
}
"""What the columns are of a file that does not say it, by their number: positions alone, poses alone, TUM, VINS, KITTI,
KITTI with the frame number or the time in front, EuRoC, OpenVINS, ROS poses with their 36 covariances."""
_BOTTOM = ["bottom0", "bottom1", "bottom2", "bottom3"]
_SQUARE_MATRIX = {16: [*_MATRIX, *_BOTTOM], 17: ["number", *_MATRIX, *_BOTTOM]}
"""Likewise, of rows that end in 0 0 0 1: the 4x4 matrices of KITTI-360, with the frame number or without."""

KNOWN = (
    "8 numbers a row (TUM), 12 (KITTI), 13 (frame number and KITTI), 16 or 17 (KITTI-360), 17 (EuRoC), 20 (OpenVINS), "
    "11 (VINS), 7 (x y z qx qy qz qw), 4 (t x y z), 44 (TUM and the 36 covariances of ROS), 29 under a header of "
    "SQUARE, or named columns"
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
    **STATE_NAMES,
    **{f"covariance{i}": rf"(?!.*twist).*cov(ariance)?[._\[]?{i}\]?" for i in range(36)},
}
"""Names that columns are known by, as patterns, in small letters and without units."""
_TURNS = r"^q(uat|_|[wxyz])|rot|orient|roll|pitch|yaw|euler|heading"
"""Names of columns that seem to hold an orientation, as a pattern."""
_MOST_FRAMES = 1e8
"""Larger numbers in front of a pose are times."""
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
    unit: str
    """Unit of the times, as the file says it; empty where it does not."""

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
    recognised = _known([name for name, _ in named])
    if not set(_POSE[1:4]) <= set(recognised) or len(named) != len(cells):
        named = []
        if not any(map(_is_number, cells)):
            raise ValueError(f"{path} is no trajectory: its first row is {lines[first][:60]!r}, not {KNOWN}")
        usual = names or UNNAMED.get(len(cells))
        if names is None and cells[-4:] and _ends_in_0001(cells):
            usual = _SQUARE_MATRIX.get(len(cells), usual)
        if usual is None:
            raise ValueError(f"{path} has {len(cells)} columns{_asked(len(cells))}")
        if len(usual) != len(cells):
            raise ValueError(f"{path} has {len(cells)} columns where its header has {len(usual)}")
        recognised = {name: i for i, name in enumerate(usual)}
    elif not set(_POSE[4:]) <= set(recognised) and (turns := [name for name, _ in named if re.search(_TURNS, name)]):
        raise ValueError(
            f"{path} has orientations that are not read ({', '.join(turns)[:60]}): give unit quaternions qx, qy, qz, qw"
        )
    only = list(recognised.values())
    table = parse_table(path, "\n".join(lines[above:]), len(only), delimiter=delimiter, only=only, finite=False)
    words = {name: cell for (name, _), cell in zip(named, cells, strict=False) if not _is_number(cell)}
    unit = named[recognised["t"]][1] if named and "t" in recognised else ""
    return Columns(path, dict(zip(recognised, table.T, strict=True)), words, unit)


def trajectory_of(columns: Columns, about: Mapping[str, Any]) -> Trajectory:
    """The trajectory that the columns hold; `about` is what is known beside them, as of `Trajectory`.

    Raises
    ------
    ValueError
        The numbers are no trajectory: one line that names the file.
    """
    values, path = columns.values, columns.path
    notes: list[str] = []
    orientations = None
    if "m00" in values:
        matrices = columns.block("m", 3, 4)
        data: BoolArray = np.asarray(np.isfinite(matrices).all(axis=(1, 2)))
        positions, orientations = np.full((len(data), 3), np.nan), np.zeros((len(data), 4))
        positions[data], orientations[data] = split_poses(path, matrices[data])
    else:
        positions = np.stack([values[f"t{a}"] for a in "xyz"], axis=1)
        if "qx" in values:
            orientations = np.stack([values[f"q{a}"] for a in "xyzw"], axis=1)
    times, numbers = values.get("t"), values.get("number")
    if numbers is not None and ((numbers != np.round(numbers)).any() or np.abs(numbers).max() >= _MOST_FRAMES):
        times, numbers = numbers, None  # 13 columns with the time in front
    if times is not None:
        times, notes = seconds_of(times, str(path), columns.unit)
    covariances, how = _covariances(columns, orientations)
    states, about_states = states_of(values)
    notes += [*how.pop("notes", []), *about_states]
    about = {
        **{"timestamps": times, "covariances": covariances, "tracks": values.get("tracks"), "states": states},
        "frame_numbers": None if times is not None or numbers is None else numbers.astype(np.int64),
        **how,
        **about,
    }
    return assembled(str(path), positions, orientations, **about, notes=notes)


def _covariances(columns: Columns, orientations: FloatArray | None) -> tuple[FloatArray | None, dict[str, Any]]:
    """Covariances (K, 6, 6) of the columns, position part first, and what they are of."""
    values = columns.values
    count = len(next(iter(values.values())))
    covariances = np.zeros((count, POSE_SIZE, POSE_SIZE))
    if "square00" in values:
        for i, j in _LOWER:
            covariances[:, i, j] = covariances[:, j, i] = values[f"square{i}{j}"]
        return covariances, {}
    if all(f"covariance{i}" in values for i in range(36)):
        covariances = np.stack([values[f"covariance{i}"] for i in range(36)], axis=1)
        return covariances.reshape(-1, POSE_SIZE, POSE_SIZE), {
            "by_ros": True,
            "notes": ["its covariances are read as those of ROS poses: the rotation about the axes of the world"],
        }
    if orientations is None or not all(name in values for name in _BLOCKS):
        return None, {}
    for part, kind in ((POSITION, "Pt"), (ROTATION, "Pr")):
        for i in (1, 2, 3):
            for j in range(i, 4):
                block = covariances[:, part, part]
                block[:, i - 1, j - 1] = block[:, j - 1, i - 1] = values[f"{kind}{i}{j}"]
    error = columns.words.get("est_err_type", "type5")
    if error not in _ERRORS or columns.words.get("err_representation", "theta_so3") not in _REPRESENTATIONS:
        message = f"{error}, {columns.words.get('err_representation')}"
        raise ValueError(
            f"{columns.path} has covariances of errors ({message}) that are not read: "
            f"give one of {', '.join(_ERRORS)} with one of {', '.join(_REPRESENTATIONS)}"
        )
    tangent, fixed_axes = _ERRORS[error]
    return about_fixed_axes(orientations, covariances) if fixed_axes else covariances, {"tangent": tangent}


_REPRESENTATIONS = ("theta_R", "theta_q", "theta_so3", "R_small_theta", "q_small_theta", "so3_theta", "none")


def _asked(count: int) -> str:
    if count == len(SQUARE_COLUMNS):
        return (
            " and no header: is the covariance of the right or the left perturbation, and which part comes first? "
            "Write '#%FORMAT SQUARE/0.3', '#%REPRESENTATION gaussian_se3', '#%TANGENT_CONVENTION right_perturbation' "
            "(or left_perturbation) and '#%TANGENT_ORDER translation_rotation' (or rotation_translation) above it"
        )
    return f": a trajectory has {KNOWN}"


def _known(names: Sequence[str]) -> dict[str, int]:
    """Meaning of the columns by their names; the last one where two have the same."""
    return {key: i for key, how in _NAMES.items() for i, name in enumerate(names) if re.fullmatch(how, name)}


def _cells(line: str, delimiter: str | None) -> list[str]:
    return [cell.strip() for cell in line.rstrip().rstrip(delimiter).split(delimiter)]


def _ends_in_0001(cells: Sequence[str]) -> bool:
    return all(map(_is_number, cells)) and [float(cell) for cell in cells[-4:]] == [0.0, 0.0, 0.0, 1.0]


def _name_and_unit(title: str) -> tuple[str, str]:
    """A column's name in small letters, and its unit in brackets, where it has one."""
    unit = re.search(r"\s*[\[(]\s*((?!\d)[^\[\]()]*?)\s*[\])]\s*$", title)
    name = title[: unit.start() if unit else None].strip().lstrip("#%")
    return name.strip().lower(), unit[1].lower() if unit else ""


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
