"""Folders that one process at a time writes results into."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from stereo_slam_env.files.atomic import remove_unfinished

CLAIM = ".lock"


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
