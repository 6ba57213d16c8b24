"""A folder that one process writes results into: a second one is refused, and a dead one leaves nothing behind."""

from __future__ import annotations

import errno
import logging
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stereo_slam_env.files.atomic import remove_unfinished

if sys.platform != "win32":
    import fcntl

CLAIM = ".in-use"
_TAKEN = (errno.EACCES, errno.EAGAIN)
_NO_LOCKS_HERE = (errno.ENOLCK, errno.ENOTSUP, errno.EINVAL, errno.ENOSYS)

_log = logging.getLogger(__name__)


@contextmanager
def claimed_folder(folder: Path) -> Iterator[None]:
    """Be the only process that writes into a folder, which is made; what a killed one left half written goes.

    The claim is a POSIX record lock on a file in it: the system drops it when the process ends, however it ends, and
    processes forked from it do not hold it. Threads of one process are not told apart. Where the file system knows no
    locks, there is no protection, and the log says so.

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
    claim = _claim(folder)
    try:
        yield
    finally:
        if claim is not None:
            (folder / CLAIM).unlink(missing_ok=True)
            os.close(claim)


def is_occupied(folder: Path) -> bool:
    """Whether there is anything in an existing folder but a claim."""
    return any(entry.name != CLAIM for entry in folder.iterdir())


def _claim(folder: Path) -> int | None:
    """Descriptor of the locked file; None where there are no locks."""
    while True:
        claim = _opened(folder)
        try:
            if sys.platform == "win32":
                raise OSError(errno.ENOSYS, "no POSIX locks")
            fcntl.lockf(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_still_there(claim, folder / CLAIM):
                remove_unfinished(folder)
                os.truncate(claim, 0)
                os.write(claim, f"process {os.getpid()} of {socket.gethostname()}".encode())
                return claim
            os.close(claim)
        except OSError as error:
            owner = os.read(claim, 200).decode(errors="replace")
            os.close(claim)
            if error.errno in _TAKEN:
                raise ValueError(
                    f"output {folder} is in use by {owner or 'another process'}: wait until it ends, or choose another "
                    f"directory"
                ) from error
            if error.errno not in _NO_LOCKS_HERE:
                raise
            _log.warning("output %s: its file system knows no locks, so a second run in it is not noticed", folder)
            return None


def _opened(folder: Path) -> int:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(folder / CLAIM, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(f"output {folder} cannot be written ({error.strerror}): choose another directory") from error


def _is_still_there(claim: int, path: Path) -> bool:
    """Whether the locked file is the one of that name, and not one that its last owner has just removed."""
    try:
        return os.path.samestat(os.fstat(claim), path.stat())
    except FileNotFoundError:
        return False
