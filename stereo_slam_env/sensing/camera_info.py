"""Calibration by `sensor_msgs/CameraInfo` of both cameras: all of its fields, and all messages of a topic.

As REP 104 has it, K, D, R, P and the size are those of the whole sensor; the images are its region of interest (`roi`),
binned. Where P alone is filled, it says all: the images are rectified.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray
from stereo_slam_env.sensing.calibration_entries import Size, lens_of
from stereo_slam_env.sensing.lenses import Lens, Rectification, stated_rectification
from stereo_slam_env.sensing.projections import rectified_rig, require_principal_point
from stereo_slam_env.sensing.rig_files import Calibration

_FEW = 0.1
"""Share of messages at the start that may be left over from before: drivers and latched topics bring such."""
_MIDDLE = 0.2
"""How far a principal point is from the middle of a whole image at most, as a share of its width."""


@dataclass(frozen=True)
class CameraInfo:
    """Content of a message, without its header."""

    K: tuple[float, ...]
    """9, px; all 0 where it is not known."""
    D: tuple[float, ...]
    """Coefficients of the lens."""
    R: tuple[float, ...]
    """9: from the camera as it is mounted to the rectified one."""
    P: tuple[float, ...]
    """12: K [I | t] of the rectified camera, px and px m."""
    model: str
    """Name of the lens model."""
    size: Size
    """Width and height of the whole sensor, px."""
    binning: Size
    """Pixels that were joined, along a row and a column."""
    roi: tuple[int, int, int, int]
    """Offsets along a row and a column, width and height, px of the whole sensor; all 0: the whole of it."""

    @classmethod
    def of_message(cls, message: Any) -> CameraInfo:
        """The content of a message of ROS 1, whose names are in capitals, or of ROS 2."""
        K, D, R, P = (
            tuple(float(x) for x in getattr(message, name if hasattr(message, name) else name.lower()))
            for name in "KDRP"
        )
        roi = message.roi
        return cls(
            *(K, D, R, P),
            model=str(message.distortion_model),
            size=(int(message.width), int(message.height)),
            binning=(max(int(message.binning_x), 1), max(int(message.binning_y), 1)),
            roi=(int(roi.x_offset), int(roi.y_offset), int(roi.width), int(roi.height)),
        )

    @property
    def shift(self) -> float:
        """Fourth number of P, -fx b of a right camera, px m."""
        return self.P[3]

    @property
    def has_lens(self) -> bool:
        """Whether it says anything of the raw images."""
        return any(self.K)

    @property
    def size_of_images(self) -> Size:
        """Width and height of the region of interest, binned, px."""
        x, y, *region = self.roi
        width, height = region if all(region) else (self.size[0] - x, self.size[1] - y)
        return width // self.binning[0], height // self.binning[1]

    def __str__(self) -> str:
        return f"{self.size[0]}x{self.size[1]}, K fx {self.K[0]:.6g}, P fx {self.P[0]:.6g}, P[3] {self.P[3]:.6g}"


def agreed(messages: Iterable[CameraInfo], where: str) -> tuple[CameraInfo, tuple[str, ...]]:
    """The content that the messages of a topic agree on, and a note where a few at its start were others.

    Empty messages say nothing, and are left out.

    Raises
    ------
    ValueError
        The calibration changes: one line that begins with `where` and counts.
    """
    received = list(messages)
    every = [one for one in received if any(one.K) or any(one.P)] or received
    notes: tuple[str, ...] = ()
    if empty := len(received) - len(every):
        notes = (f"{where}: {empty} of {len(received)} messages are empty: left out",)
    counts = Counter(map(repr, every))  # NaN differs from itself
    ((most, count),) = counts.most_common(1)
    usual = next(one for one in every if repr(one) == most)
    if (odd := len(every) - count) == 0:
        return usual, notes
    other = next(one for one in every if repr(one) != most)
    message = f"{where} says {usual} in {count} of {len(every)} messages and {other} in others"
    if odd > _FEW * len(every) or any(repr(one) != most for one in every[odd:]):
        raise ValueError(
            f"{message}: the calibration changes, so cut the bag where it does, or give the right one as rig"
        )
    return usual, (*notes, f"{message}: the first {odd} are taken for those of a calibration before")


def calibration_of_infos(messages: tuple[Any, Any], where: str, *, rectified: bool) -> Calibration:
    """Calibration by the messages of the left and the right camera, of images that are rectified or raw.

    Raises
    ------
    ValueError
        They are no rig, or contradict themselves: one line that begins with `where`.
    """
    left, right = map(CameraInfo.of_message, messages)
    sizes = left.size_of_images, right.size_of_images
    calibration, _ = calibration_of_images((left, right), sizes, where, mapped=(not rectified, not rectified))
    return calibration.camera if rectified and isinstance(calibration, Rectification) else calibration


def calibration_of_images(
    infos: tuple[CameraInfo, CameraInfo], sizes: tuple[Size, Size], where: str, *, mapped: tuple[bool, bool]
) -> tuple[Calibration, tuple[str, ...]]:
    """Calibration by the infos of the left and the right camera, of images with these sizes, and notes on it.

    Parameters
    ----------
    infos : (CameraInfo, CameraInfo)
        Left and right.
    sizes : (Size, Size)
        Of the images, px.
    where : str
        For messages.
    mapped : (bool, bool)
        Whether the images are said to be raw, see `Rectification`.

    Raises
    ------
    ValueError
        They are no rig, or contradict themselves or the images: one line that begins with `where`.
    """
    notes: list[str] = []
    both = []
    for info, size in zip(infos, sizes, strict=True):
        fitted, note = _of_images(info, size, where)
        notes += [one for one in note if one not in notes]
        both.append(fitted)
        if any(fitted.P) and not any(info.roi[:2]):
            require_principal_point(where, np.reshape(fitted.P, (3, 4)), size)
    P = tuple(_projection(one, where) for one in both)
    if not all(one.has_lens for one in both):
        return rectified_rig(where, P[0], P[1], sizes[0]), (*notes, f"{where}: K is not filled in, P alone is used")
    left, right = (_lens(one, where) for one in both)
    turns = tuple(np.reshape(one.R, (3, 3)) for one in both)
    if not any(mapped) and not all(_is_turn(R) for R in turns):
        return rectified_rig(where, P[0], P[1], sizes[0]), tuple(notes)
    stated = stated_rectification((left, right), (turns[0], turns[1]), (P[0], P[1]), where)
    return replace(stated, mapped=mapped), tuple(notes)


def _of_images(info: CameraInfo, size: Size, where: str) -> tuple[CameraInfo, tuple[str, ...]]:
    """The info of an image of its region of interest, binned, from that of the whole sensor."""
    if info.size == (0, 0):
        info = replace(info, size=size, binning=(1, 1), roi=(0, 0, 0, 0))
    (x, y, *_), bins, expected = info.roi, info.binning, info.size_of_images
    if size == info.size and expected != size:
        what = f"its images have its whole size, {size[0]}x{size[1]}"
        return _plain(info), (f"{where}: roi and binning contradict the images: {what}, K and P are taken as theirs",)
    if expected != size:
        how = "" if bins == (1, 1) and not any(info.roi) else f" (roi {info.roi}, binning {bins[0]}x{bins[1]})"
        message = f"images of {size[0]}x{size[1]} where CameraInfo says {expected[0]}x{expected[1]}{how}"
        raise ValueError(f"{where}: {message}: calibrate for these images")
    if bins == (1, 1) and (x, y) == (0, 0):
        return info, ()
    K_whole = info.K if info.has_lens else (*info.P[0:3], *info.P[4:7], *info.P[8:11])
    middle = np.array([K_whole[2], K_whole[5]])
    of_sensor, of_images = (np.abs(middle / of - 0.5) for of in (info.size, size))
    if of_sensor.max() > _MIDDLE and of_images.max() < 0.5 * _MIDDLE:
        message = f"binning is {bins[0]}x{bins[1]}, but K has its principal point in the middle of the binned images"
        if (x, y) != (0, 0):
            message = f"the region is {info.roi}, but K has its principal point in the middle of its images"
        return replace(_plain(info), size=size), (
            f"{where}: {message}: K and P are taken as those of these (REP 104: of the whole sensor)",
        )
    scale = np.array([[1.0 / bins[0], 0.0, 0.0], [0.0, 1.0 / bins[1], 0.0], [0.0, 0.0, 1.0]])
    # Integer (u, v) is the centre of a pixel, also of a joined one.
    scale[0, 2], scale[1, 2] = (0.5 - x) / bins[0] - 0.5, (0.5 - y) / bins[1] - 0.5
    K, P = scale @ np.reshape(info.K, (3, 3)), scale @ np.reshape(info.P, (3, 4))
    fitted = replace(_plain(info), K=tuple(K.ravel()) if info.has_lens else info.K, P=tuple(P.ravel()), size=size)
    words = f"region {info.roi}" if any(info.roi) else ""
    words += (", " if words and bins != (1, 1) else "") + (f"binning {bins[0]}x{bins[1]}" if bins != (1, 1) else "")
    return fitted, (f"{where}: K and P are those of the whole sensor; of the images ({words}) fx is {P[0, 0]:.6g} px",)


def _plain(info: CameraInfo) -> CameraInfo:
    return replace(info, binning=(1, 1), roi=(0, 0, 0, 0))


def _projection(info: CameraInfo, where: str) -> FloatArray:
    P = np.reshape(info.P, (3, 4))
    if not np.isfinite(P).all():
        raise ValueError(f"{where}: 'projection_matrix' has NaN or infinity: take the calibration again")
    if not P.any():
        raise ValueError(
            f"{where}: P is all zero, the cameras are not calibrated as a pair: give their calibration as rig"
        )
    return P


def _lens(info: CameraInfo, where: str) -> Lens:
    if not np.isfinite(info.K).all():
        raise ValueError(f"{where}: 'camera_matrix' has NaN or infinity: take the calibration again")
    return lens_of(Path(where), np.array(info.K), info.size, np.array(info.D), info.model)


def _is_turn(R: FloatArray) -> bool:
    return bool((np.abs(R @ R.T - np.eye(3)) <= 1e-3).all() and np.linalg.det(R) > 0)
