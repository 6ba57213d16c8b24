"""Registry of the layouts of recordings: ours, and those of third parties.

A third party adds a layout with an entry point in the group `stereo_slam.recordings`, whose object (a module will do)
has `NAME`, `FILES` and one of two readers::

    [project.entry-points."stereo_slam.recordings"]
    my-robot = "my_package.my_robot"

`FILES` holds one or more sets of entries, any of which tells a folder of this layout; `*` stands for anything, `../`
for the folder around. A recording that may be one file has its endings in `SUFFIXES`. Of tracks, `read(path,
**options)` gives the `Recording`; of images, `open_sequence(path, choice, **options)` an `ImageSequence`, which then
goes through the front end. Options are keyword-only parameters.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Protocol

from filters.contract.validation import first_line, plain, type_name

ENTRY_POINT_GROUP = "stereo_slam.recordings"
NOT_AVAILABLE = "not available"
"""Begins the line of a layout that is there and cannot be used."""
_OURS = (
    *("kitti07_tracks", "kitti00_stereo_tracks", "starry_night", "mono_tracks"),
    *("kitti06_stereo51", "kitti_odometry", "kitti_raw", "karlsruhe", "euroc", "tartanair", "vslam_lab"),
    *("stereo_folder", "ros_bag"),
)

_log = logging.getLogger(__name__)


class FolderLayout(Protocol):
    """A layout of recordings; besides, `read` or `open_sequence`, and perhaps `SUFFIXES`."""

    NAME: str
    FILES: Sequence[Sequence[str]]


def track_layouts() -> tuple[Any, ...]:
    """The layouts of tracks."""
    return tuple(layout for layout in _usable() if hasattr(layout, "read"))


def image_layouts() -> tuple[Any, ...]:
    """The layouts of stereo images."""
    return tuple(layout for layout in _usable() if hasattr(layout, "open_sequence"))


def available_recordings() -> dict[str, str]:
    """Names of all layouts and one line on each; one that cannot be loaded says so instead."""
    lines = {}
    for point in _points():
        layout = _loaded(point)
        lines[point.name] = _line(layout) if not isinstance(layout, str) else f"{NOT_AVAILABLE}: {layout}"
    return lines


def file_layout(path: Path) -> Any | None:
    """The layout whose recordings may be a single file of this ending; None: of no layout."""
    return next((one for one in _usable() if path.suffix in getattr(one, "SUFFIXES", ())), None)


def _points() -> list[EntryPoint]:
    ours = [EntryPoint(name, f"stereo_slam_env.datasets.{name}", ENTRY_POINT_GROUP) for name in _OURS]
    return [*ours, *(point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in _OURS)]


def _usable() -> list[Any]:
    layouts = []
    for point in _points():
        layout = _loaded(point)
        if isinstance(layout, str):
            _log.warning("the layout %s is %s: %s", plain(point.name), NOT_AVAILABLE, layout)
        else:
            layouts.append(layout)
    return layouts


@lru_cache(maxsize=256)
def _loaded(point: EntryPoint) -> Any:
    """The layout, or why there is none: a stranger's module must not take a reading down."""
    try:
        layout = point.load()
        if not isinstance(layout.NAME, str) or not all(isinstance(entry, str) for one in layout.FILES for entry in one):
            return "NAME must be text and FILES sets of names"
    except Exception as error:
        return f"{type_name(error)}: {first_line(error)}"
    readers = [name for name in ("read", "open_sequence") if callable(getattr(layout, name, None))]
    return layout if len(readers) == 1 else "it must have either read or open_sequence"


def _line(layout: Any) -> str:
    text = (getattr(layout, "__doc__", None) or "no description").strip().splitlines()
    return plain(text[0]) if text else "no description"
