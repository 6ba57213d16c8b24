"""Numeric text files and npz archives, read with errors that name the file and the row."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from filters.validation import BoolArray, FloatArray
from stereo_slam_env.files.arrays import MOST_BYTES, read_arrays
from stereo_slam_env.files.text import read_text

_LEAST_VOLUME = 1e-6
"""Determinant; that of a rotation is 1."""


def read_table(
    path: Path, columns: int, *, delimiter: str | None = None, header_lines: int = 0, finite: bool = True
) -> FloatArray:
    """Read a numeric table.

    Parameters
    ----------
    path : Path
        Text file, one row a line.
    columns : int
        Wanted number of columns.
    delimiter : str, optional
        None for white space.
    header_lines : int
        Lines to skip.
    finite : bool
        Whether NaN and infinity are refused.

    Returns
    -------
    (rows, columns) ndarray

    Raises
    ------
    ValueError
        Missing, not a table of that width, empty, or, where `finite`, with NaN or infinity: the message names file
        and row.
    """
    try:
        text = read_text(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path} is missing: copy it from the recording") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of an empty file: the error below says it
            table = np.loadtxt(io.StringIO(text), dtype=np.float64, delimiter=delimiter, skiprows=header_lines, ndmin=2)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path} is not a table of {columns} numbers a row: {first_line(error)}") from error
    if table.size == 0:
        raise ValueError(f"{path} is empty: {columns} numbers a row were expected")
    if table.shape[1] != columns:
        raise ValueError(f"{path} has {table.shape[1]} columns where {columns} were expected")
    if finite:
        require_finite_rows(path, table)
    return table


def read_archive(path: Path, keys: tuple[str, ...]) -> dict[str, FloatArray]:
    """Read float64 arrays from an npz archive (no pickles).

    Raises
    ------
    ValueError
        The archive is damaged or lacks a key; the message names the file.
    """
    try:
        arrays = read_arrays(path, keys)
        missing = [key for key in keys if key not in arrays]
        if missing:
            raise KeyError(", ".join(missing))
        if sum(array.size for array in arrays.values()) * np.float64().itemsize > MOST_BYTES:
            raise ValueError(f"as float64 its arrays take more than {MOST_BYTES} bytes")
        return {key: np.asarray(arrays[key], dtype=np.float64) for key in keys}
    except KeyError as error:
        raise ValueError(f"{path} lacks the array {error.args[0]}") from error
    except (ValueError, TypeError, OSError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise ValueError(f"{path} is damaged and cannot be read: copy it again ({first_line(error)})") from error


def read_poses(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read KITTI poses: 12 numbers a row, the upper 3x4 part of T_world_cam.

    Returns
    -------
    positions : (K, 3) ndarray
        r^WC, m.
    orientations : (K, 4) ndarray
        q^WC, xyzw.
    """
    matrices = read_table(path, 12).reshape(-1, 3, 4)
    require_rotations(path, matrices)
    return split_poses(matrices)


def split_poses(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (K, 3) and unit quaternions xyzw (K, 4) of K matrices whose upper 3x4 part is [R | t]."""
    return matrices[:, :3, 3].copy(), Rotation.from_matrix(matrices[:, :3, :3]).as_quat()


def require_rotations(path: Path, matrices: FloatArray) -> None:
    """Raise a `ValueError` naming the first of (K, 3 or 4, 3 or 4) matrices whose upper 3x3 part is no rotation.

    Files round, and some hold rotations of few digits: what is refused is what has no nearest rotation.
    """
    with np.errstate(all="ignore"):
        volume = np.linalg.det(matrices[:, :3, :3])
        bad = np.flatnonzero(~((volume > _LEAST_VOLUME) & np.isfinite(volume)))
    if bad.size:
        raise ValueError(f"{path} holds no rotation in pose {bad[0]}: correct it")


def require_finite_rows(path: Path, table: FloatArray) -> None:
    """Raise a `ValueError` naming the first row of `table` that holds NaN or infinity."""
    bad = np.flatnonzero(~finite_rows(table))
    if bad.size:
        raise ValueError(f"{path} has NaN or infinity in {bad.size} rows, the first is row {bad[0]}: remove them")


def finite_rows(table: FloatArray) -> BoolArray:
    """Which rows of (K, columns) hold neither NaN nor infinity."""
    return np.asarray(np.isfinite(table).all(axis=1), dtype=np.bool_)


def first_line(error: BaseException) -> str:
    """First line of an exception's message, or its type where the message is empty."""
    text = str(error).strip()
    return text.splitlines()[0] if text else type(error).__name__
