"""Readers of texts, numeric tables and npz archives that may come from anybody: nothing is executed, sizes are bounded.

`np.load` believes the header of an array and allocates what it says, and a compressed archive of a kilobyte can hold
a megabyte of zeros. Here sizes are compared first: that of the archive, of its parts, and of the arrays in them.
"""

from __future__ import annotations

import codecs
import io
import json
import os
import re
import struct
import tokenize
import tomllib
import warnings
import zipfile
import zlib
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from filters.contract.validation import first_line, plain
from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.files.opening import NotOpened, open_regular, read_bytes

MOST_TEXT = 100_000_000
"""Larger texts are refused, bytes."""
MOST_ENTRIES = 5_000_000
"""Of a JSON file."""
MOST_BYTES = 256_000_000
"""An archive may always unpack to so many bytes ..."""
MOST_GROWTH = 20
"""... or to so many times its own size."""
_PART = r"(?:[\w-]+|\"[^\"\n]*\"|'[^'\n]*')[ \t]*"
_DOTTED = re.compile(rf"(?<![\w-]){_PART}(?:\.[ \t]*{_PART}){{30}}")
_PIECE, _MOST_HEADER = 1 << 20, 1 << 17
_MOST_DIRECTORY = 10_000_000
_END_OF_ZIP = 22
"""bytes: of a zip archive's last record."""
_END_OF_LONG_ZIP = 76
"""bytes before that: of the record with 64 bits, and of its place."""
_LEAST_VOLUME = 1e-6
"""Determinant; that of a rotation is 1."""

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # what NumPy writes; others can ask for memory of their own
_DAMAGE = (
    *(OSError, EOFError, ValueError, TypeError, KeyError, IndexError, OverflowError, RuntimeError, SyntaxError),
    *(tokenize.TokenError, struct.error, zlib.error, zipfile.BadZipFile),
)
"""What `zipfile`, `zlib` and the header's parser raise where a file is not what it says."""


Shape = int | str | tuple[int | str, ...]
"""Of an array in an archive, see `read_archive`."""


class DamagedArchive(ValueError):
    """The file is no npz archive of plain arrays, or unpacks to too much; the message does not name the file."""


def read_text(path: Path, *, errors: str = "strict", most_bytes: int = MOST_TEXT, inside: Path | None = None) -> str:
    """Read a text file in UTF-8, or in UTF-16 behind its mark, with the line ends of any file.

    `errors` as `str.decode` has it, the others as of `open_regular`.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        No regular file, too large, not readable, or no text: one line.
    """
    content = read_bytes(path, most_bytes=most_bytes, inside=inside)
    encoding = "utf-16" if content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8-sig"
    try:
        return io.TextIOWrapper(io.BytesIO(content), encoding=encoding, errors=errors).read()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text in UTF-8 (byte {error.start}): save it as such") from error


def read_json(path: Path, *, most_bytes: int = MOST_TEXT, inside: Path | None = None) -> Any:
    """Read JSON; `most_bytes` and `inside` as of `open_regular`.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        As `read_text`, or it is no JSON: one line.
    """
    text = read_text(path, most_bytes=most_bytes, inside=inside)
    if sum(map(text.count, "[{,")) > MOST_ENTRIES:  # each takes a hundred bytes and more
        raise ValueError(f"{path} has more than {MOST_ENTRIES} entries, which are refused")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # ValueError: numbers of too many digits, too
        raise ValueError(f"{path} is no JSON ({first_line(error)}): write it again") from error


def parse_toml(text: str) -> dict[str, Any]:
    """Tables of a text in TOML, as `tomllib` has them; a `ValueError` of one line where it is none."""
    if _DOTTED.search(text):  # their parts take the square of their number, of time and memory
        raise ValueError("a key has more than 30 parts")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError(first_line(error)) from error


def read_table(
    path: Path, columns: int, *, delimiter: str | None = None, header_lines: int = 0, finite: bool = True
) -> FloatArray:
    """Read a numeric table from a text file, one row a line: (rows, columns).

    `delimiter` None: white space. With `finite`, NaN and infinity are refused.

    Raises
    ------
    ValueError
        Missing, not a table of that width, empty, or, where `finite`, with NaN or infinity: the message names file and
        row.
    """
    try:
        text = read_text(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path} is missing: copy it from the recording") from error
    return parse_table(path, text, columns, delimiter=delimiter, header_lines=header_lines, finite=finite)


def parse_table(
    path: Path,
    text: str,
    columns: int,
    *,
    delimiter: str | None = None,
    header_lines: int = 0,
    finite: bool = True,
    only: Sequence[int] | None = None,
) -> FloatArray:
    """The table that a text read from `path` holds, as `read_table` does; `only` these columns of it, where given."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of an empty file: the error below says it
            table = np.loadtxt(
                io.StringIO(text),
                dtype=np.float64,
                comments=("#", "%"),
                delimiter=delimiter,
                skiprows=header_lines,
                usecols=only,
                ndmin=2,
            )
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{path} is not a table of {columns} numbers a row: {first_line(error)}") from error
    if table.size == 0:
        raise ValueError(f"{path} is empty: {columns} numbers a row were expected")
    if table.shape[1] != columns:
        raise ValueError(f"{path} has {table.shape[1]} columns where {columns} were expected")
    bad = np.flatnonzero(~finite_rows(table))
    if finite and bad.size:
        raise ValueError(f"{path} has NaN or infinity in {bad.size} rows, the first is row {bad[0]}: remove them")
    return table


def finite_rows(table: FloatArray) -> BoolArray:
    """Mask (K,) of rows that hold neither NaN nor infinity."""
    return np.asarray(np.isfinite(table).all(axis=1), dtype=np.bool_)


def read_poses(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read KITTI poses, 12 numbers a row: positions (K, 3) r^WC, m, and orientations (K, 4) q^WC, xyzw."""
    return split_poses(path, read_table(path, 12).reshape(-1, 3, 4))


def split_poses(path: Path, matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (K, 3) and unit quaternions xyzw (K, 4) of K matrices whose upper 3x4 part is [R | t].

    A `ValueError` names the file and the first matrix whose upper 3x3 part has no nearest rotation.
    """
    with np.errstate(all="ignore"):
        volume = np.linalg.det(matrices[:, :3, :3])
        bad = np.flatnonzero(~((volume > _LEAST_VOLUME) & np.isfinite(volume)))
    if bad.size:
        raise ValueError(f"{path} holds no rotation in pose {bad[0]}: correct it")
    return matrices[:, :3, 3].copy(), Rotation.from_matrix(matrices[:, :3, :3]).as_quat()


def read_archive(path: Path, shapes: Mapping[str, Shape]) -> dict[str, FloatArray]:
    """Read float64 arrays of known shapes from an npz archive (no pickles).

    `shapes` has the shape of each array, or, of one that is returned flat, its number of entries. A letter stands for a
    length that is the same wherever it stands. A `ValueError` names the file: it is damaged, lacks an array, or one has
    another shape, NaN or infinity.
    """
    try:
        arrays = read_arrays(path, tuple(shapes))
        if sum(array.size for array in arrays.values()) * np.float64().itemsize > MOST_BYTES:
            raise ValueError(f"as float64 its arrays take more than {MOST_BYTES} bytes")
        found = {key: np.asarray(array, dtype=np.float64) for key, array in arrays.items()}
    except (FileNotFoundError, NotOpened):
        raise
    except (ValueError, TypeError, OSError) as error:
        raise ValueError(f"{path} is damaged and cannot be read: copy it again ({first_line(error)})") from error
    if missing := [key for key in shapes if key not in found]:
        raise ValueError(f"{path} lacks the array {', '.join(missing)}")
    lengths: dict[str, int] = {}
    for key, shape in shapes.items():
        flat = not isinstance(shape, tuple)
        array = found[key] = found[key].reshape(-1) if flat else found[key]
        wanted_shape = (shape,) if isinstance(shape, int | str) else shape
        if array.ndim == len(wanted_shape):
            lengths = {n: got for n, got in zip(wanted_shape, array.shape, strict=True) if isinstance(n, str)} | lengths
        expected = tuple(lengths.get(n, n) if isinstance(n, str) else n for n in wanted_shape)
        if array.shape != expected:
            counted = f"{array.size} numbers, expected {expected[0]}"
            raise ValueError(
                f"{path}: array {key} has " + (counted if flat else f"shape {array.shape}, expected {expected}")
            )
        if not np.isfinite(array).all():
            raise ValueError(f"{path}: array {key} has NaN or infinity: mark what was not seen with -1")
    return found


def read_arrays(
    source: str | Path | bytes, names: Collection[str] | None = None, *, inside: Path | None = None
) -> dict[str, NDArray[Any]]:
    """Read arrays, all or those of `names` that there are, as `np.load` does, without pickles and within limits.

    `source` is a file, or its content; `inside` as of `open_regular`.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    NotOpened
        It is not opened; the message names it.
    DamagedArchive
        Anything else that is wrong with it.
    """
    try:
        with _opened(source, inside) as stream:
            _require_short_directory(stream)
            archive = zipfile.ZipFile(stream)  # which needs no closing of its own
            limit = max(MOST_BYTES, MOST_GROWTH * _size(stream))
            parts: dict[str, zipfile.ZipInfo] = {}
            for info in archive.infolist():
                if parts.setdefault(info.filename.removesuffix(".npy"), info) is not info:
                    raise DamagedArchive(f"it holds {plain(info.filename)} twice")
            total = sum(info.file_size for info in archive.infolist())
            if total > limit:
                raise DamagedArchive(f"it would unpack to {total} bytes, more than {limit} are refused")
            return {name: _array(archive, info) for name, info in parts.items() if names is None or name in names}
    except (FileNotFoundError, NotOpened, DamagedArchive):
        raise
    except _DAMAGE as error:
        raise DamagedArchive(first_line(error)) from error


def require_plain_zip(stream: BinaryIO) -> None:
    """Refuse, before a library opens it, what is no zip archive or one with packed parts; ends at the beginning.

    Raises
    ------
    DamagedArchive
        It is no archive, or has parts that are packed, or that are longer than the archive.
    """
    try:
        _require_short_directory(stream, long=True)
        parts = zipfile.ZipFile(stream).infolist()
        packed = any(part.compress_type != zipfile.ZIP_STORED for part in parts)
        if packed or sum(part.file_size for part in parts) > _size(stream):
            raise DamagedArchive("its parts are packed, which this program does not do")
    except DamagedArchive:
        raise
    except _DAMAGE as error:
        raise DamagedArchive(first_line(error)) from error
    stream.seek(0)


def _opened(source: str | Path | bytes, inside: Path | None) -> BinaryIO:
    return io.BytesIO(source) if isinstance(source, bytes) else open_regular(source, inside=inside)


def _require_short_directory(stream: BinaryIO, *, long: bool = False) -> None:
    """Refuse an archive whose table of contents, which `zipfile` reads whole, is longer than that of any recording.

    `long` archives, whose sizes have 64 bits, are what PyTorch writes.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - _END_OF_ZIP - (1 << 16), 0))
    tail = stream.read()
    at = len(tail) - _END_OF_ZIP
    if tail[at : at + 4] != b"PK\5\6" or tail[-2:] != b"\0\0":  # there is a comment after it
        at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) < at + _END_OF_ZIP:
        raise DamagedArchive("it is no zip archive, or cut off")
    (length,) = struct.unpack_from("<L", tail, at + 12)
    is_long = tail[max(at - 20, 0) : at][:4] == b"PK\6\7"
    if is_long and long and at >= _END_OF_LONG_ZIP:
        (length,) = struct.unpack_from("<Q", tail, at - _END_OF_LONG_ZIP + 40)
    if length > _MOST_DIRECTORY or (is_long and not long):
        raise DamagedArchive("its table of contents is longer than that of a recording")


def _size(stream: BinaryIO) -> int:
    """Bytes on disk: those of a sparse file, which is mostly no bytes at all, do not let it unpack to more."""
    size = stream.seek(0, os.SEEK_END)
    if isinstance(stream, io.BytesIO) or not hasattr(os.stat_result, "st_blocks"):
        return size
    return min(size, 512 * os.fstat(stream.fileno()).st_blocks)


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    if info.compress_type not in _METHODS:
        raise DamagedArchive(f"array {info.filename} is compressed in a way that NumPy does not write")
    content = bytearray(info.file_size)  # writable, so that the array needs no copy
    at = 0
    with archive.open(info) as part:
        while piece := part.read(_PIECE):  # never more than the part declares
            content[at : at + len(piece)] = piece
            at += len(piece)
    if at < info.file_size:
        raise EOFError(f"{info.filename} is cut off")
    long = content[6:8] != b"\1\0"  # of version 1.0 the length of the header has two bytes
    end = 12 + int.from_bytes(content[8:12], "little") if long else 10 + int.from_bytes(content[8:10], "little")
    shape, columns_first, dtype, begin = _header(bytes(content[: min(end, _MOST_HEADER)]))
    if dtype.hasobject:
        raise DamagedArchive(f"array {info.filename} holds pickled objects, which are not read")
    # A header that promises more than the part holds is refused here, before anything is allocated.
    return np.ndarray(shape, dtype, content, begin, order="F" if columns_first else "C")


@lru_cache(maxsize=4096)
def _header(start: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Shape, order and type of an array by the header at its start, and where its content begins.

    The same headers come again and again, and NumPy compiles each as Python.
    """
    stream = io.BytesIO(start)
    version = np.lib.format.read_magic(stream)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    return *read_header(stream), stream.tell()
