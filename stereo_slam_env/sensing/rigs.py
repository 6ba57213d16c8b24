"""Stereo rigs: some by name, any other by its calibration file or its numbers. All take 10 frames a second."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from filters import StereoCamera
from filters.contract.validation import finite_number, require_known
from stereo_slam_env.sensing.projections import LONGEST_FOCAL_LENGTH
from stereo_slam_env.sensing.rig_files import ENDINGS, Calibration, imu_shift, is_calibration, read_calibration

Rig = str | StereoCamera | Mapping[str, Any]
"""A name of `RIGS`, a calibration file, a camera, or its numbers: see `camera_of`."""

RIGS: dict[str, StereoCamera] = {
    "reference": StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391),
    "vga": StereoCamera(460.0, 460.0, 319.5, 239.5, 0.571, 640, 480),
    "qvga": StereoCamera(230.0, 230.0, 159.5, 119.5, 0.571, 320, 240),
    "kitti": StereoCamera(718.856, 718.856, 607.1928, 185.2157, 386.1448 / 718.856, 1241, 376),
    "euroc": StereoCamera(435.2047, 435.2047, 367.4517, 252.2009, 47.90639 / 435.2047, 752, 480),
    "zed2": StereoCamera(530.0, 530.0, 639.5, 359.5, 0.12, 1280, 720),
    "d455": StereoCamera(643.0, 643.0, 639.5, 359.5, 0.095, 1280, 720),
    "oak-d": StereoCamera(882.0, 882.0, 639.5, 399.5, 0.075, 1280, 800),
}
"""`reference` is like the cars of Karlsruhe and KITTI; `vga` and `qvga` are cheaper to render. `kitti` is the grey pair
of 2011_10_03 (odometry 00 to 02), `euroc` the MAV's pair as rectified for ORB-SLAM. The others are nominal, by the data
sheets: focal length over pixel (ZED 2 in HD720: 2.12 mm, 4 um; D455: 1.93 mm, 3 um) or field of view (OAK-D: 72
degrees), principal point in the middle; that of one device is in its calibration file."""

CAMERA_HEIGHT = 1.65
"""Of both cameras above the ground, m."""
LONGEST_SIDE = 8192
"""Of an image, px: memory is allocated for what a scenario file asks for."""
_BOUNDS = {
    "fx": (1.0, LONGEST_FOCAL_LENGTH, "px"),
    "fy": (1.0, LONGEST_FOCAL_LENGTH, "px"),
    "baseline": (0.001, 10.0, "m"),
}
"""Beyond these a number is a mistake of units."""
_NUMBERS = tuple(field.name for field in fields(StereoCamera))
_PLACES = ("name", "left", "right")
_KINDS = f"one of {', '.join(map(repr, RIGS))} or a calibration file (*{', *'.join(ENDINGS)})"


def camera_of(rig: Rig, default: str = "reference") -> StereoCamera:
    """The stereo camera that a name, a calibration file, a camera or a table of numbers stands for.

    Parameters
    ----------
    rig : str, StereoCamera or mapping
        A name of `RIGS`; a calibration file, or its folder, see `rig_files` (of raw images: the rig once they are
        rectified); a camera; or a table. A table has some of the seven numbers (fx, fy, cx, cy in px, baseline in m,
        width, height in px) and the `name` of the rig or file that the others are taken from:
        ``{"name": "vga", "baseline": 0.2}``; or, instead of the name, the files of both cameras, `left` and `right`.
    default : str
        The rig that numbers are taken from where neither name nor file is given.

    Raises
    ------
    ValueError
        No such rig or file, no such number, a number that no camera has, or a name beside all seven numbers.
    """
    if isinstance(rig, str):
        return RIGS[rig] if rig in RIGS else camera_of({"name": rig})
    entries = asdict(rig) if isinstance(rig, StereoCamera) else rig
    if not isinstance(entries, Mapping):
        raise ValueError(f"rig must be {_KINDS}, a StereoCamera or a table of its numbers, got {rig!r}")
    require_known("rig has no number", entries, (*_PLACES, *_NUMBERS))
    if "name" in entries and len(entries) > len(_NUMBERS):
        raise ValueError(f"rig must not have a name beside all its numbers, got name {entries['name']!r}: leave it out")
    numbers = {key: value for key, value in entries.items() if key not in _PLACES}
    base = _base(entries, default)
    numbers = {**asdict(base if isinstance(base, StereoCamera) else base.camera), **numbers}
    width, height = _whole("rig.width", numbers["width"]), _whole("rig.height", numbers["height"])
    inside = "px, inside the image: give it with the size"
    bounds = {**_BOUNDS, "cx": (0.0, width - 1.0, inside), "cy": (0.0, height - 1.0, inside)}
    checked = {key: _within(f"rig.{key}", numbers[key], *bounds[key]) for key in bounds}
    return StereoCamera(**checked, width=width, height=height)


def calibration_of(rig: Rig, default: str = "reference") -> Calibration:
    """Images of a rig: a rig of rectified ones, or how raw ones are rectified; as of `camera_of`.

    Beside a calibration of raw images only the baseline may be another one.
    """
    camera = camera_of(rig, default)
    base = _base({"name": rig} if isinstance(rig, str) else rig, default) if isinstance(rig, str | Mapping) else camera
    if isinstance(base, StereoCamera):
        return camera
    if replace(base.camera, baseline=camera.baseline) != camera:
        raise ValueError("rig is a calibration of raw images: beside it only the baseline may be given")
    return base if base.camera == camera else replace(base, camera=camera)


def imu_shift_of(rig: Rig) -> float:
    """Seconds to be added to times of the left camera for those of the inertial unit, as a calibration file says."""
    name = rig if isinstance(rig, str) else rig.get("name", rig.get("left")) if isinstance(rig, Mapping) else None
    return imu_shift(name) if isinstance(name, str | Path) and name not in RIGS and is_calibration(str(name)) else 0.0


def _base(table: Mapping[str, Any], default: str) -> Calibration:
    """The rig or calibration that numbers of a table are put in place of."""
    if "left" in table or "right" in table:
        if not {"left", "right"} <= table.keys() or "name" in table:
            raise ValueError("rig must have the files of both cameras, left and right, and no name beside them")
        return read_calibration(_text("rig.left", table["left"]), _text("rig.right", table["right"]), _size(table))
    name = table.get("name", default)
    if isinstance(name, str) and name in RIGS:
        return RIGS[name]
    if isinstance(name, str) and is_calibration(name):
        return read_calibration(name, size=_size(table))
    what = "rig" if isinstance(name, str) and set(table) == {"name"} else "rig.name"
    raise ValueError(f"{what} must be {_KINDS}, got {name!r}")


def plain_rig(rig: Rig, default: str = "reference") -> str | dict[str, Any]:
    """The same rig without files, JSON-able: a name of `RIGS`, or a table of numbers."""
    if isinstance(rig, str) and rig in RIGS:
        return rig
    if isinstance(rig, Mapping) and not _of_files(rig):
        return dict(rig)
    return asdict(camera_of(rig, default))


def _of_files(table: Mapping[str, Any]) -> bool:
    return "left" in table or "right" in table or ("name" in table and table["name"] not in RIGS)


def _size(table: Mapping[str, Any]) -> tuple[int, int] | None:
    if not {"width", "height"} <= table.keys():
        return None
    return _whole("rig.width", table["width"]), _whole("rig.height", table["height"])


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str | Path):
        raise ValueError(f"{name} must be a calibration file, got {value!r}")
    return str(value)


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= LONGEST_SIDE:
        raise ValueError(f"{name} must be a whole number from 1 to {LONGEST_SIDE}, px, got {value!r}")
    return int(value)


def _within(name: str, value: Any, low: float, high: float, unit: str) -> float:
    number = finite_number(name, value)
    if not low <= number <= high:
        raise ValueError(f"{name} must be a number from {low:g} to {high:g} {unit}, got {value!r}")
    return number
