"""The one way to open a file that somebody else made: a regular one, of a bounded size, where it is said to be.

A pipe has no end, a device neither, a sparse file is larger than the disk, and a link may lead anywhere. None of these
is read, waited for, or opened for longer than it takes to see what it is.

Checks of paths: nothing is read outside the folder that was given, and what is to be written can be.

How much packed data can unpack to at most, by the headers of its blocks alone: Zstandard and LZ4.

The size that a frame or a chunk states is not believed: a frame of a few blocks of 4 bytes each can hold gigabytes.
"""

from __future__ import annotations

import errno
import os
import stat
import struct
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any, BinaryIO

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


MOST_UNPACKED = 256_000_000
"""Bytes that a chunk, or a packed message, may unpack to."""
_ZSTD, _ZSTD_SKIPPED, _LZ4 = 0xFD2FB528, 0x184D2A5, 0x184D2204
_ZSTD_BLOCK = 1 << 17
_RAW, _REPEATED, _PACKED = range(3)


class Unbounded(ValueError):
    """Packed data that would unpack to too much, or that is none."""


def zstd_bound(data: bytes | memoryview) -> int:
    """Most bytes that frames of Zstandard unpack to; raises `Unbounded` where they are damaged."""
    at, total = 0, 0
    try:
        while at < len(data):
            (magic,) = struct.unpack_from("<I", data, at)
            if magic >> 4 == _ZSTD_SKIPPED:
                at += 8 + struct.unpack_from("<I", data, at + 4)[0]
                continue
            if magic != _ZSTD:
                raise Unbounded("it is not packed by Zstandard")
            flags = data[at + 4]
            single = flags >> 5 & 1
            at += 5 + (not single) + (0, 1, 2, 4)[flags & 3] + (single, 2, 4, 8)[flags >> 6]
            last = False
            while not last:
                header = int.from_bytes(data[at : at + 3], "little")
                last, kind, size = bool(header & 1) or at + 3 > len(data), header >> 1 & 3, header >> 3
                at += 3 + (1 if kind == _REPEATED else size)
                total += _ZSTD_BLOCK if kind == _PACKED else size
                if total > MOST_UNPACKED:
                    raise Unbounded(f"it would unpack to more than {MOST_UNPACKED} bytes, which is refused")
            at += 4 * (flags >> 2 & 1)
        if at > len(data):
            raise Unbounded("it is cut off")
    except (struct.error, IndexError) as error:
        raise Unbounded("it is cut off") from error
    return total


def lz4_bound(data: bytes | memoryview) -> int:
    """Most bytes that a frame of LZ4 unpacks to; raises `Unbounded` where it is damaged."""
    try:
        (magic,) = struct.unpack_from("<I", data)
        if magic != _LZ4:
            raise Unbounded("it is not packed by LZ4")
        flags, largest = data[4], 1 << (8 + 2 * (data[5] >> 4 & 7))
        at, total = 7 + 4 * (flags & 1), 0
        if flags >> 3 & 1:
            (stated,) = struct.unpack_from("<Q", data, 6)
            at += 8
            if stated > MOST_UNPACKED:
                raise Unbounded(f"it would unpack to {stated} bytes, more than {MOST_UNPACKED} are refused")
        while size := struct.unpack_from("<I", data, at)[0]:
            length = size & 0x7FFFFFFF
            at += 4 + length + 4 * (flags >> 4 & 1)
            total += length if size >> 31 else min(largest, 255 * length)
            if total > MOST_UNPACKED:
                raise Unbounded(f"it would unpack to more than {MOST_UNPACKED} bytes, which is refused")
    except (struct.error, IndexError) as error:
        raise Unbounded("it is cut off") from error
    return total


def zstandard() -> Any:
    """The module of Zstandard that comes with Python, or with `rosbags`."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd


def unpacked(packing: str, content: bytes) -> bytes:
    """Content of a chunk, whose size was bounded before."""
    if packing == "zstd":
        return bytes(zstandard().decompress(content))
    if packing == "lz4":
        from lz4 import frame

        return bytes(frame.decompress(content))
    return content


def require_bounded_zstd(path: Path, data: bytes) -> None:
    """Raise a `ValueError` that names the file where a packed message would unpack to too much."""
    try:
        zstd_bound(data)
    except (Unbounded, TypeError) as error:
        raise ValueError(f"{path} has a packed message: {error}") from error
