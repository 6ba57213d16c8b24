"""How much packed data can unpack to at most, by the headers of its blocks alone: Zstandard and LZ4.

The size that a frame or a chunk states is not believed: a frame of a few blocks of 4 bytes each can hold gigabytes.
"""

from __future__ import annotations

import struct
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

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
    names = ("compression.zstd", "backports.zstd", "zstandard")
    return import_module(next(name for name in names if find_spec(name.partition(".")[0]) and find_spec(name)))


def unpacked(packing: str, content: bytes) -> bytes:
    """Content of a chunk, whose size was bounded before."""
    if packing == "zstd":
        return bytes(zstandard().decompress(content))
    return bytes(import_module("lz4.frame").decompress(content)) if packing == "lz4" else content


def require_bounded_zstd(path: Path, data: bytes) -> None:
    """Raise a `ValueError` that names the file where a packed message would unpack to too much."""
    try:
        zstd_bound(data)
    except (Unbounded, TypeError) as error:
        raise ValueError(f"{path} has a packed message: {error}") from error
