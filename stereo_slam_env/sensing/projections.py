"""Projection matrices of rectified pairs, by name in files of the KITTI family, and the rig that they mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from filters import StereoCamera
from filters.geometry.arrays import FloatArray
from stereo_slam_env.files.readers import read_text

LONGEST_FOCAL_LENGTH = 1e5
"""Beyond this, px, a lens is a mistake."""
BASELINES = (0.005, 2.0)
"""Beyond these, m, the baseline of real images is a mistake of units."""
_EDGE = 0.05
"""Share of an image beside its edges in which no principal point is."""
_BY_UNIT = (("mm", 1e-3), ("cm", 1e-2), ("inches", 0.0254))
_SAME_K = 1e-6
"""Relative difference of the K of both cameras that is taken for rounding."""


def read_entries(path: Path) -> dict[str, FloatArray]:
    """The lines `NAME: number number ...` of a file that must be there; others are left out."""
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise ValueError(f"{path} is missing: it holds the calibration, copy it from the recording") from None
    entries = {}
    for line in text.splitlines():
        name, colon, rest = line.partition(":")
        if not colon:
            continue
        try:
            numbers = np.array([float(word) for word in rest.split()])
        except ValueError:
            continue
        if numbers.size:
            entries[name.strip()] = numbers
    return entries


def entry(path: Path, entries: Mapping[str, FloatArray], name: str, shape: tuple[int, ...]) -> FloatArray:
    """The entry of that name as an array; a `ValueError` where it is missing, of another size, or not finite."""
    if name not in entries:
        names_found = ", ".join(entries) or "nothing"
        raise ValueError(
            f"{path} lacks the entry '{name}:' (it has {names_found}): take the calibration of this recording"
        )
    numbers, count = entries[name], int(np.prod(shape))
    if numbers.size != count:
        raise ValueError(f"{path}: entry '{name}:' has {numbers.size} numbers where {count} were expected")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{path}: entry '{name}:' has NaN or infinity: take the calibration of this recording")
    return numbers.reshape(shape)


def rectified_rig(path: Path | str, P_left: FloatArray, P_right: FloatArray, size: tuple[int, int]) -> StereoCamera:
    """The rig of two projection matrices P = K [I | t] (3, 4) with one common K, for images of that size, px.

    Both project from one reference camera; a `ValueError` that names `path` where they are of another form.
    """
    K = P_left[:, :3]
    form = np.array([[K[0, 0], 0.0, K[0, 2]], [0.0, K[1, 1], K[1, 2]], [0.0, 0.0, 1.0]])
    scale = np.abs(K).max()
    if not (np.abs(K - form) <= _SAME_K * scale).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise ValueError(f"{path}: the left projection matrix is not [fx 0 cx; 0 fy cy; 0 0 1 | ...]: not rectified")
    if not (np.abs(P_right[:, :3] - K) <= _SAME_K * scale).all():
        raise ValueError(f"{path}: both cameras must have the same focal lengths and principal point: not rectified")
    beside, below, _ = camera_position(P_right) - camera_position(P_left)
    baseline = float(beside)
    if abs(below) > abs(beside):
        raise ValueError(f"{path}: the right camera is {below:+.4g} m below the left one: a vertical pair is not read")
    if not baseline > 0:
        raise ValueError(
            f"{path}: the baseline is {baseline:.6g} m, it must be > 0: are left and right swapped, or is the "
            "transform between them inverted?"
        )
    require_baseline(path, baseline)
    fx, fy, cx, cy = (float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if max(fx, fy) > LONGEST_FOCAL_LENGTH:
        raise ValueError(f"{path}: a focal length of {max(fx, fy):.6g} px is that of no camera: is its lens right?")
    return StereoCamera(fx, fy, cx, cy, baseline, *size)


def require_baseline(path: Path | str, baseline: float) -> None:
    """Raise a `ValueError` that names `path` where a baseline, m, asks for its unit."""
    low, high = BASELINES
    if baseline < low:
        remedy = "metres are expected, and -fx b, in px m, as fourth number of P"
        raise ValueError(f"{path}: the baseline is {baseline:.3g} m: {remedy}")
    if baseline > high:
        fits = [f"{unit} ({baseline * of_unit:.3g} m)" for unit, of_unit in _BY_UNIT if 0.02 < baseline * of_unit < 1.0]
        likely = f", is it in {' or '.join(fits)}?" if fits else ""
        raise ValueError(f"{path}: the baseline is {baseline:.6g} m: metres are expected{likely}")


def require_principal_point(path: Path | str, P: FloatArray, size: tuple[int, int]) -> None:
    """Raise a `ValueError` that names `path` where P (3, 4) is that of images of another size than these, px."""
    share = np.array([P[0, 2] + 0.5, P[1, 2] + 0.5]) / size
    if ((share > _EDGE) & (share < 1.0 - _EDGE)).all():
        return
    message = (
        f"the principal point ({P[0, 2]:.6g}, {P[1, 2]:.6g}) px is not in the middle of images of {size[0]}x{size[1]}"
    )
    raise ValueError(f"{path}: {message}: the calibration is of images of another size, so give that of these")


def projections(path: Path, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Projection matrices (3, 4) of the left and of the right camera by the names of their entries."""
    entries = read_entries(path)
    left, right = (entry(path, entries, name, (3, 4)) for name in names)
    return left, right


def camera_position(P: FloatArray) -> FloatArray:
    """Position of the camera of P = K [I | t] in the frame that P refers to, m: -t."""
    return np.asarray(-np.linalg.solve(P[:, :3], P[:, 3]), dtype=np.float64)
