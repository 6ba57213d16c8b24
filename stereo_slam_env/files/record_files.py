"""Records as npz files: arrays by name, and under `about` a header of plain data in JSON with the number of its format.

Bytes in, bytes out; what is read may come from anybody (`readers.read_arrays`).
"""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereo_slam_env.files.readers import read_arrays

Arrays = dict[str, NDArray[Any]]
HEADER = "about"
DAMAGE = (MemoryError, OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError)
"""Exceptions of a record that is read and is not what it says."""


class NoRecord(ValueError):
    """The file has no header of a record."""


class OtherFormat(ValueError):
    """The record is of another format; the message says which."""


def packed(number: int, about: Mapping[str, Any], arrays: Mapping[str, Any], *, compress: bool = False) -> bytes:
    """Pack a record of format `number`; a `ValueError` or `TypeError` says that `about` does not consist of JSON."""
    header = json.dumps({"format": number, **about}, allow_nan=False)
    stream = io.BytesIO()
    (np.savez_compressed if compress else np.savez)(stream, **{HEADER: np.array(header), **arrays})
    return stream.getvalue()


def unpacked(
    source: str | Path | bytes, number: int, names: Collection[str] | None = None, *, inside: Path | None = None
) -> tuple[dict[str, Any], Arrays]:
    """Header and arrays of a record of format `number`, all or those of `names`.

    Raises
    ------
    NoRecord, OtherFormat
        It has no header, or is of another format.
    FileNotFoundError, NotOpened, DamagedArchive
        As of `read_arrays`.
    """
    arrays = read_arrays(source, None if names is None else {HEADER, *names}, inside=inside)
    try:
        about: dict[str, Any] = json.loads(str(arrays.pop(HEADER)))
        written = about["format"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise NoRecord("it has no header of a record") from error
    if written != number:
        raise OtherFormat(f"format {written}, this version reads {number}")
    return about, arrays
