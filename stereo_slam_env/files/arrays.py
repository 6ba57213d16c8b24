"""Arrays out of npz files that may come from anybody: nothing is executed, and nothing grows beyond what is declared.

`np.load` believes the header of an array and allocates what it says, and a compressed archive of a kilobyte can hold
a megabyte of zeros. Here sizes are compared first: that of the archive, of its parts, and of the arrays in them.
"""

from __future__ import annotations

import io
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

MOST_BYTES = 256_000_000
"""An archive may always unpack to so many bytes ..."""

MOST_GROWTH = 20
"""... or to so many times its own size."""
_PIECE, _MOST_HEADER = 1 << 20, 1 << 17

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what NumPy writes; others can ask for memory of their own
_DAMAGE = (
    *(OSError, EOFError, ValueError, TypeError, KeyError, IndexError, OverflowError, RuntimeError, SyntaxError),
    *(tokenize.TokenError, struct.error, zlib.error, zipfile.BadZipFile),
)
"""What `zipfile`, `zlib` and the header's parser raise where a file is not what it says."""


class DamagedArchive(ValueError):
    """The file is no npz archive of plain arrays, or unpacks to too much; the message does not name the file."""


def read_arrays(source: str | Path | IO[bytes], names: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """Read arrays as `np.load` does, without pickles and with a limit to what they take.

    Parameters
    ----------
    source : str, Path or binary stream
        The npz archive.
    names : collection of str, optional
        Arrays to read, those of them that there are; None reads all.

    Returns
    -------
    dict
        Name -> array.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    DamagedArchive
        Anything else that is wrong with it.
    """
    try:
        with zipfile.ZipFile(source) as archive:
            parts = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            _refuse_bomb(archive)
            wanted = parts if names is None else [name for name in parts if name in names]
            return {name: _array(archive, parts[name]) for name in wanted}
    except (FileNotFoundError, DamagedArchive):
        raise
    except _DAMAGE as error:
        raise DamagedArchive((str(error).strip() or type(error).__name__).splitlines()[0]) from error


def _refuse_bomb(archive: zipfile.ZipFile) -> None:
    assert archive.fp is not None
    limit = max(MOST_BYTES, MOST_GROWTH * archive.fp.seek(0, os.SEEK_END))
    total = sum(info.file_size for info in archive.infolist())
    if total > limit:
        raise DamagedArchive(f"it would unpack to {total} bytes, more than {limit} are refused")


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    if info.compress_type not in _METHODS:
        raise DamagedArchive(f"array {info.filename} is compressed in a way that NumPy does not write")
    content = _content(archive, info)
    stream = io.BytesIO(content[:_MOST_HEADER])
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, columns_first, dtype = read_header(stream)
    if dtype.hasobject:
        raise DamagedArchive(f"array {info.filename} holds pickled objects, which are not read")
    # A header that promises more than the part holds is refused here, before anything is allocated.
    return np.ndarray(shape, dtype, content, stream.tell(), order="F" if columns_first else "C")


def _content(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> bytearray:
    """What the part holds, never more than it declares; writable, so that the array needs no copy."""
    content = bytearray(info.file_size)
    at = 0
    with archive.open(info) as part:
        while piece := part.read(_PIECE):
            content[at : at + len(piece)] = piece
            at += len(piece)
    if at < info.file_size:
        raise EOFError(f"{info.filename} is cut off")
    return content
