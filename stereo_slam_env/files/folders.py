"""Files that appear complete or not at all, and folders that one process at a time writes results into."""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from filelock import FileLock, Timeout

CLAIM = ".lock"
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


def require_writable(path: Path) -> None:
    """Raise an `OSError` where no file can be written at or below a path, which need not exist: before long work.

    Nothing is made and nothing stays behind.
    """
    there = next((one for one in (path, *path.absolute().parents) if one.exists()), path)
    try:
        with tempfile.TemporaryFile(dir=there):
            return
    except OSError as error:
        raise OSError(f"output {path} cannot be written ({error.strerror}): choose another directory") from error


def unfinished_name(path: Path) -> Path:
    """Temporary name of a file that this process is writing."""
    return path.with_name(f".{path.name}.{os.getpid()}{_UNFINISHED}")


def remove_unfinished(folder: Path) -> None:
    """Remove what killed processes were writing; nobody may be writing there now."""
    for path in folder.rglob(f".*{_UNFINISHED}*"):  # SQLite keeps a journal beside its file
        path.unlink(missing_ok=True)


@contextmanager
def claimed_folder(folder: Path) -> Iterator[None]:
    """Be the only process that writes into a folder, which is made; what a killed one left half written goes.

    The claim is a lock that the system drops when the process ends, however it ends; its file stays.

    Parameters
    ----------
    folder : Path
        The folder.

    Raises
    ------
    ValueError
        Another process has the folder.
    OSError
        The folder cannot be written.
    """
    lock = FileLock(folder / CLAIM)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout as error:
        raise ValueError(
            f"output {folder} is in use by another process: wait until it ends, or choose another directory"
        ) from error
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(f"output {folder} cannot be written ({error.strerror}): choose another directory") from error
    try:
        remove_unfinished(folder)
        yield
    finally:
        lock.release()


def is_occupied(folder: Path) -> bool:
    """Whether there is anything in an existing folder but a claim."""
    return any(entry.name != CLAIM for entry in folder.iterdir())
