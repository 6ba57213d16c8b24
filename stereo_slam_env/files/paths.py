"""Checks of paths: nothing is read outside the folder that was given, and what is to be written can be."""

from __future__ import annotations

import errno
import os
from collections.abc import Collection
from pathlib import Path

_LONGEST_NAME = 255
"""bytes; common file systems take no longer one."""


def require_links_inside(folder: Path, *, only: Collection[str] | None = None) -> None:
    """Refuse a folder with links that lead out of it: a `ValueError` names the first one.

    Of what is in the folder itself, `only` these names are looked at, and what is below them.

    What is in a folder can be reached by names without ".." only through links, and every link below it is looked at;
    so whatever a reader then opens by such names is inside. The folder itself may be given as a link.
    """
    root = folder.resolve()
    for here, folders, files in os.walk(root):
        if only is not None and Path(here) == root:
            folders[:], files[:] = ([name for name in names if name in only] for names in (folders, files))
        for name in (*folders, *files):
            path = Path(here, name)
            if path.is_symlink():
                require_inside(path, root)


def require_inside(path: Path, root: Path) -> Path:
    """The path, if what it stands for is inside `root`; a `ValueError` where it leads out, or in a circle."""
    try:
        target = path.resolve()
        _refuse_circle(path)
    except (OSError, RuntimeError) as error:
        raise ValueError(f"{path} is a link that leads nowhere: put the file itself there") from error
    if not target.is_relative_to(root.resolve()):
        raise ValueError(f"{path} is a link out of its folder, to {target}: put the file itself there")
    return path


def _refuse_circle(path: Path) -> None:
    """Raise for a circle of links, which Python 3.13 and newer resolve without an error."""
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise


def is_plain_name(name: str) -> bool:
    """Whether `name`, read from a file, can only be that of something in the folder it is looked for in."""
    plain = Path(name).name == name and name not in ("", "..") and "\0" not in name
    return plain and len(os.fsencode(name)) <= _LONGEST_NAME


def is_there(path: Path) -> bool:
    """Whether something has this path; a path that no file system takes, nothing has."""
    try:
        return path.exists()
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            return False
        raise


def checked_file(what: str, path: str | Path, ending: str) -> Path:
    """The path, if a file of that ending can have it; else a `ValueError` that says `what` cannot be written."""
    path = Path(path)
    if path.suffix.lower() != ending:
        raise ValueError(f"{what} {path} must end in {ending}")
    if path.is_dir():
        raise ValueError(f"{what} {path} cannot be written: it is a folder")
    if not path.parent.is_dir():
        raise ValueError(f"{what} {path} cannot be written: the folder {path.parent} does not exist")
    return path
