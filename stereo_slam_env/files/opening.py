"""The one way to open a file that somebody else made: a regular one, of a bounded size, where it is said to be.

A pipe has no end, a device neither, a sparse file is larger than the disk, and a link may lead anywhere. None of these
is read, waited for, or opened for longer than it takes to see what it is.
"""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path
from typing import BinaryIO

from stereo_slam_env.files.paths import require_inside

MOST_FILE = 2_000_000_000
"""Larger files are refused before they are read, bytes, unless a reader says otherwise."""

_PIECE = 1 << 20
_FLAGS = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class NotOpened(ValueError):
    """The file is not to be opened: `too_large`, or none at all."""

    def __init__(self, message: str, *, too_large: bool = False) -> None:
        super().__init__(message)
        self.too_large = too_large


def open_regular(path: str | Path, *, most_bytes: int = MOST_FILE, inside: Path | None = None) -> BinaryIO:
    """Open a file for reading, which nothing but a regular file survives.

    Parameters
    ----------
    path : str or Path
        The file, or a link to it.
    most_bytes : int
        Larger files are refused.
    inside : Path, optional
        A folder that the file must be in, links followed; the folder itself may be a link.

    Returns
    -------
    binary file
        At its beginning.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    NotOpened
        It is a folder, a pipe, a socket or a device, or too large, or cannot be read: a `ValueError` of one line.
    ValueError
        It is a link out of `inside`.
    """
    path = Path(path)
    if inside is not None:
        require_inside(path, inside)
    try:
        # Even to open a device can do something, so it is looked at before; what is opened may be another file by then.
        _require_regular(path, path.stat(), most_bytes)
        descriptor = os.open(path, _FLAGS)
    except (FileNotFoundError, NotOpened):
        raise
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        raise NotOpened(f"{path} cannot be read ({reason}): check the file") from error
    try:
        _require_regular(path, os.fstat(descriptor), most_bytes)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def require_regular(path: Path, *, inside: Path | None = None) -> None:
    """Refuse what `open_regular` refuses, of any size, before a library opens the file itself."""
    open_regular(path, most_bytes=sys.maxsize, inside=inside).close()


def read_bytes(path: str | Path, *, most_bytes: int = MOST_FILE, inside: Path | None = None) -> bytes:
    """Content of a file; arguments and errors as of `open_regular`."""
    pieces, size = [], 0
    with open_regular(path, most_bytes=most_bytes, inside=inside) as stream:
        try:
            while piece := stream.read(_PIECE):  # asked for all that is allowed, Python would make room for that much
                pieces.append(piece)
                size += len(piece)
                if size > most_bytes:  # it grows
                    raise NotOpened(f"{path} has more than {most_bytes} bytes, which are refused", too_large=True)
        except OSError as error:
            raise NotOpened(f"{path} cannot be read ({error.strerror}): check the file") from error
    return b"".join(pieces)


def _require_regular(path: Path, found: os.stat_result, most_bytes: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else")
        raise NotOpened(f"{path} is no regular file but {kind}: put a file there")
    if found.st_size > most_bytes:
        raise NotOpened(f"{path} has {found.st_size} bytes: more than {most_bytes} are refused", too_large=True)
