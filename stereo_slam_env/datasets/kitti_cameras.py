"""The two stereo pairs of a KITTI car, and which of them is read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

CAMERAS = {"grey": (0, 1), "colour": (2, 3)}
"""Numbers of the left and the right camera."""


def has_cameras(folder_of: Callable[[int], Path], cameras: str) -> bool:
    """Whether the images of both eyes are there; `folder_of` gives the folder of a camera by its number."""
    return all(folder_of(number).is_dir() for number in CAMERAS[cameras])


def chosen_cameras(folder_of: Callable[[int], Path], asked: str | None) -> str:
    """The pair that was asked for; None: grey where present.

    Raises
    ------
    ValueError
        There is no such pair.
    """
    if asked is None:
        return "grey" if has_cameras(folder_of, "grey") else "colour"
    if asked not in CAMERAS:
        raise ValueError(f"cameras must be one of {', '.join(CAMERAS)}, got {asked!r}")
    return asked
