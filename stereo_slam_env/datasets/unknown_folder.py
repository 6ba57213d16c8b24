"""What is said of a path that is no recording: that it is not there, or which layout it comes nearest to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from stereo_slam_env.files.inside import is_there

Layouts = Mapping[str, tuple[str, ...]]
"""Name of a layout -> the entries that tell a folder of it: `a|b` is either, `*` stands for anything."""


def require_folder(path: Path, others: str = "") -> None:
    """Refuse what is no folder; `others`: what could be given besides one. Raises a `ValueError`."""
    there = is_there(path)
    if not there or not path.is_dir():
        what = "is a file, not a folder" if there else "does not exist"
        raise ValueError(f"{path} {what}: give a folder with a recording{others}")


def no_known_layout(path: Path, folders: Iterable[Path], layouts: Layouts) -> str:
    """One line on a folder that has no known layout, with the nearest one and what is missing from it.

    Parameters
    ----------
    path : Path
        What was given.
    folders : iterable of Path
        Where a recording was looked for: the folder itself, then those in it.
    layouts : mapping of str to tuple of str
        Those that are known.
    """
    for folder in folders:
        lacking = {name: [entry for entry in entries if not _holds(folder, entry)] for name, entries in layouts.items()}
        name = min(layouts, key=lambda name: len(lacking[name]) / len(layouts[name]))
        if len(lacking[name]) == len(layouts[name]):
            continue
        where = "" if folder == path else f", in {folder.relative_to(path)}"
        missing = ", ".join(entry.replace("|", " or ") for entry in lacking[name])
        if not missing:  # a left image of one pair of cameras and a right one of another
            return f"{path} has no known layout: its files{where} are those of {name}, but do not belong together"
        return f"{path} has no known layout: nearest is {name}{where}, which lacks {missing}"
    what = "has no known layout: it holds no file of one" if any(path.iterdir()) else "is empty"
    return f"{path} {what}; known are {', '.join(layouts)} (their files: docs/real_data.md)"


def _holds(folder: Path, entry: str) -> bool:
    for name in entry.split("|"):
        parent = folder.parent if name.startswith("../") else folder
        if any(parent.glob(name.removeprefix("../"))):
            return True
    return False
