"""Files that appear complete or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

_UNFINISHED = ".part"


def write_atomically(path: Path, write: Callable[[IO[bytes]], Any]) -> None:
    """Write a file so that a reader, or an interruption, never meets half of it.

    Parameters
    ----------
    path : Path
        The file; its folder is made.
    write : callable
        Called with the open stream.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = unfinished_name(path)
    try:
        with unfinished.open("wb") as stream:
            write(stream)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def unfinished_name(path: Path) -> Path:
    """Temporary name of a file that this process is writing."""
    return path.with_name(f".{path.name}.{os.getpid()}{_UNFINISHED}")


def remove_unfinished(folder: Path) -> None:
    """Remove what killed processes were writing; nobody may be writing there now."""
    for path in folder.rglob(f".*{_UNFINISHED}*"):  # SQLite keeps a journal beside its file
        path.unlink(missing_ok=True)
