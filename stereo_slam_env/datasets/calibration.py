"""Calibration files of the KITTI family, and the rig of a rectified pair of projection matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from filters import Pose, StereoCamera, rotations
from filters.validation import FloatArray
from stereo_slam_env.datasets.frames import FramePair
from stereo_slam_env.files.readers import read_text

_SAME_K = 1e-6
"""Relative difference of the K of both cameras that is taken for rounding."""


def read_entries(path: Path) -> dict[str, FloatArray]:
    """The lines `NAME: number number ...` of a file; lines that are not of this form are left out.

    Raises
    ------
    ValueError
        The file is missing or no text.
    """
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise ValueError(f"{path} is missing: it holds the calibration, copy it from the recording") from None
    entries = {}
    for line in text.splitlines():
        name, colon, rest = line.partition(":")
        try:
            numbers = np.array([float(word) for word in rest.split()])
        except ValueError:
            continue
        if colon and numbers.size:
            entries[name.strip()] = numbers
    return entries


def entry(path: Path, entries: Mapping[str, FloatArray], name: str, shape: tuple[int, ...]) -> FloatArray:
    """The entry of that name as an array.

    Raises
    ------
    ValueError
        It is missing, has another size, or is not finite.
    """
    if name not in entries:
        found = ", ".join(entries) or "nothing"
        raise ValueError(f"{path} lacks the entry '{name}:' (it has {found}): take the calibration of this recording")
    numbers, count = entries[name], int(np.prod(shape))
    if numbers.size != count:
        raise ValueError(f"{path}: entry '{name}:' has {numbers.size} numbers where {count} were expected")
    if not np.isfinite(numbers).all():
        raise ValueError(f"{path}: entry '{name}:' has NaN or infinity: take the calibration of this recording")
    return numbers.reshape(shape)


@dataclass(frozen=True, eq=False)
class RectifiedRig:
    """A rectified pair of cameras.

    Attributes
    ----------
    camera : StereoCamera
        The rig.
    left_in_reference : (3,)
        Where the left camera is in the camera that the projection matrices refer to, m; same orientation.
    """

    camera: StereoCamera
    left_in_reference: FloatArray

    def of_left(self, frames: Sequence[FramePair]) -> list[FramePair]:
        """The frames with the pose of the left camera, given with that of the reference camera."""
        return [replace(frame, truth=self._left_pose(frame.truth)) for frame in frames]

    def _left_pose(self, reference: Pose | None) -> Pose | None:
        if reference is None or not self.left_in_reference.any():
            return reference
        R = rotations.matrix(reference.orientation)
        return Pose(reference.position + R @ self.left_in_reference, reference.orientation)


def rectified_rig(path: Path, P_left: FloatArray, P_right: FloatArray, size: tuple[int, int]) -> RectifiedRig:
    """The rig of two projection matrices P = K [I | t] (3, 4) with one common K; the cameras are at -t.

    Parameters
    ----------
    path : Path
        For messages.
    P_left, P_right : (3, 4)
        Projections from one reference camera.
    size : (int, int)
        Width and height, px.

    Raises
    ------
    ValueError
        The matrices are not of that form: not rectified, or the right camera is not to the right.
    """
    K = P_left[:, :3]
    form = np.array([[K[0, 0], 0.0, K[0, 2]], [0.0, K[1, 1], K[1, 2]], [0.0, 0.0, 1.0]])
    scale = np.abs(K).max()
    if not (np.abs(K - form) <= _SAME_K * scale).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise ValueError(f"{path}: the left projection matrix is not [fx 0 cx; 0 fy cy; 0 0 1 | ...]: not rectified")
    if not (np.abs(P_right[:, :3] - K) <= _SAME_K * scale).all():
        raise ValueError(f"{path}: both cameras must have the same focal lengths and principal point: not rectified")
    left, right = camera_position(P_left), camera_position(P_right)
    baseline = float(right[0] - left[0])
    if baseline <= 0:
        raise ValueError(f"{path}: the baseline is {baseline:.6g} m, it must be > 0: are left and right swapped?")
    fx, fy, cx, cy = (float(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return RectifiedRig(StereoCamera(fx, fy, cx, cy, baseline, *size), left)


def camera_position(P: FloatArray) -> FloatArray:
    """Position of the camera of P = K [I | t] in the frame that P refers to, m: -t."""
    return np.asarray(-np.linalg.solve(P[:, :3], P[:, 3]), dtype=np.float64)
