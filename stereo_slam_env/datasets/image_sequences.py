"""Readers of stereo image recordings. Each yields an `ImageSequence`, as rendered drives are.

To add a layout: a module with `NAME`, `FILES`, `recognises(path)` and `open_sequence(path, **options)`, listed in
`IMAGE_READERS`. An entry of `FILES` names what tells a folder of this layout; `a|b` is either, `*` stands for anything.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

from filters.known_names import require_known
from stereo_slam_env.datasets import euroc, karlsruhe, kitti06_stereo51, kitti_odometry, kitti_raw
from stereo_slam_env.datasets.broken import BrokenPair
from stereo_slam_env.datasets.known_options import keyword_options
from stereo_slam_env.datasets.sequence import RecordedSequence
from stereo_slam_env.datasets.unknown_folder import no_known_layout, require_folder
from stereo_slam_env.files.inside import require_inside, require_links_inside

IMAGE_READERS: tuple[ModuleType, ...] = (kitti06_stereo51, kitti_odometry, kitti_raw, karlsruhe, euroc)
_DEPTH = 2
"""How many levels below the given folder recordings are looked for."""

__all__ = [
    "IMAGE_READERS",
    "BrokenPair",
    "RecordedSequence",
    "known_image_layouts",
    "open_image_sequence",
    "reader_of",
    "recordings_in",
]


def known_image_layouts() -> dict[str, str]:
    """What `open_image_sequence` takes: name -> the files that tell a folder of this layout."""
    return {reader.NAME: "folder with " + ", ".join(reader.FILES) for reader in IMAGE_READERS}


def reader_of(path: str | Path) -> ModuleType | None:
    """The reader whose layout the folder has, if any."""
    folder = Path(path)
    if not folder.is_dir():
        return None
    return next((reader for reader in IMAGE_READERS if reader.recognises(folder)), None)


def open_image_sequence(path: str | Path, **options: Any) -> RecordedSequence:
    """Open a recording of stereo images; the layout is recognised by the files in the folder.

    Parameters
    ----------
    path : str or Path
        A folder of a known layout, or one that holds exactly one such folder, up to two levels down.
    **options
        Options of the reader, see its `open_sequence`. All readers have `first`, `last` (frame numbers, both included)
        and `on_broken` ("raise", or "skip" to leave broken pairs out and count them in `skipped`).

    Raises
    ------
    ValueError
        No such folder, no known layout, an unknown option, something is missing or damaged, or a link leads out of the
        folder: one line that names it.
    """
    folder = Path(path)
    require_folder(folder)
    inside = recordings_in(folder)
    if len(inside) > 1:
        names = ", ".join(str(found.relative_to(folder)) for found in inside)
        raise ValueError(f"{folder} holds {len(inside)} recordings, give one of them: {names}")
    if not inside:
        layouts = {reader.NAME: reader.FILES for reader in IMAGE_READERS}
        raise ValueError(no_known_layout(folder, folders_in(folder), layouts))
    folder = require_inside(inside[0], folder)
    require_links_inside(folder)
    reader = reader_of(folder)
    assert reader is not None
    require_known(f"the reader {reader.NAME} has no option", options, keyword_options(reader.open_sequence))
    sequence: RecordedSequence = reader.open_sequence(folder, **options)
    return sequence


def recordings_in(path: str | Path) -> list[Path]:
    """The folder itself if it has a known layout, else those up to two levels below it that have one."""
    folder = Path(path)
    if reader_of(folder) is not None:
        return [folder]
    return [found for found in folders_in(folder) if reader_of(found)]


def folders_in(folder: Path) -> list[Path]:
    """The folder and those up to two levels below it, level by level."""
    levels = [[folder]]
    for _ in range(_DEPTH):
        levels.append([child for parent in levels[-1] for child in _children(parent)])
    return [found for level in levels for found in level]


def _children(folder: Path) -> list[Path]:
    try:
        return sorted(child for child in folder.iterdir() if child.is_dir())
    except OSError:  # not ours to read
        return []
