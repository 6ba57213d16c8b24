"""Stereo rigs: three by name, any other by its numbers. All take 10 frames a second."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, Literal

import numpy as np

from filters import StereoCamera
from filters.contract.known_names import require_known
from filters.validation import finite_number

RigName = Literal["reference", "vga", "qvga"]
Rig = RigName | StereoCamera | Mapping[str, Any]
"""A name of `RIGS`, a camera, or its numbers: see `camera_of`."""

RIGS: dict[str, StereoCamera] = {
    "reference": StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391),
    "vga": StereoCamera(460.0, 460.0, 319.5, 239.5, 0.571, 640, 480),
    "qvga": StereoCamera(230.0, 230.0, 159.5, 119.5, 0.571, 320, 240),
}
"""`reference` is like the cars of Karlsruhe and KITTI; the others are cheaper to render."""

CAMERA_HEIGHT = 1.65
"""Of both cameras above the ground, m."""
LONGEST_SIDE = 8192
"""Of an image, px: memory is allocated for what a scenario file asks for."""
_BOUNDS = {"fx": (1.0, 1e5, "px"), "fy": (1.0, 1e5, "px"), "baseline": (0.001, 10.0, "m")}
"""Beyond these a number is a mistake of units."""
_NUMBERS = tuple(field.name for field in fields(StereoCamera))


def camera_of(rig: Rig, default: str = "reference") -> StereoCamera:
    """The stereo camera that a name, a camera or a table of numbers stands for.

    Parameters
    ----------
    rig : str, StereoCamera or mapping
        A name of `RIGS`; a camera; or some of its numbers (fx, fy, cx, cy in px, baseline in m, width, height in px)
        and the `name` of the rig that the others are taken from: ``{"name": "vga", "baseline": 0.2}``.
    default : str
        The rig that numbers are taken from where no `name` is given.

    Raises
    ------
    ValueError
        No such rig, no such number, a number that no camera has, or a name beside all seven numbers.
    """
    if isinstance(rig, str):
        return _named("rig", rig)
    given = asdict(rig) if isinstance(rig, StereoCamera) else rig
    if not isinstance(given, Mapping):
        raise ValueError(f"rig must be a name ({_names()}), a StereoCamera or a table of its numbers, got {rig!r}")
    require_known("rig has no number", given, ("name", *_NUMBERS))
    if len(given) > len(_NUMBERS):
        raise ValueError(f"rig must not have a name beside all its numbers, got name {given['name']!r}: leave it out")
    base = _named("rig.name", given.get("name", default))
    numbers = {**asdict(base), **{key: value for key, value in given.items() if key != "name"}}
    width, height = _whole("rig.width", numbers["width"]), _whole("rig.height", numbers["height"])
    inside = "px, inside the image: give it with the size"
    bounds = {**_BOUNDS, "cx": (0.0, width - 1.0, inside), "cy": (0.0, height - 1.0, inside)}
    checked = {key: _within(f"rig.{key}", numbers[key], *bounds[key]) for key in bounds}
    return StereoCamera(**checked, width=width, height=height)


def _named(what: str, name: Any) -> StereoCamera:
    if not isinstance(name, str) or name not in RIGS:
        raise ValueError(f"{what} must be one of {_names()}, got {name!r}")
    return RIGS[name]


def _names() -> str:
    return ", ".join(map(repr, RIGS))


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= LONGEST_SIDE:
        raise ValueError(f"{name} must be a whole number from 1 to {LONGEST_SIDE}, px, got {value!r}")
    return int(value)


def _within(name: str, value: Any, low: float, high: float, unit: str) -> float:
    number = finite_number(name, value)
    if not low <= number <= high:
        raise ValueError(f"{name} must be a number from {low:g} to {high:g} {unit}, got {value!r}")
    return number
