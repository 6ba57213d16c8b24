"""Small files that would fill memory or time, in every form that is read."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_ZEROS = 1_500_000_000
"""bytes that the packed ones hold."""


def bombs(name: str, content: bytes) -> Iterator[tuple[str, bytes]]:
    """Bombs in place of a file, by its form: a name and the content of each."""
    ending = Path(name).suffix.lower()
    made = _TEXTS if ending not in _OF else {}
    yield from {**made, **_OF.get(ending, {})}.items()
    if content.startswith(b"PK"):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            yield from _archives(archive.namelist())
    if content.startswith(b"\x89PNG"):
        yield from _pictures()


def _archives(names: list[str]) -> Iterator[tuple[str, bytes]]:
    """Archives of arrays: packed zeros, headers that promise much, parts of one content, many parts."""
    zeros = _packed_zeros()
    shapes = {"promises": (10**12,), "overflows": (2**62, 4), "many dimensions": (1,) * 5000, "negative": (-1,)}
    for title, shape in shapes.items():
        yield title, _archive({name: _header(shape) + bytes(8) for name in names})
    yield "packed", _raw_archive(dict.fromkeys(names, zeros))
    yield "pickles", _archive({name: _header((1,), "|O") + b"cos\nsystem\n(S'true'\ntR." for name in names})
    yield "many parts", _archive({f"{k}.npy": b"" for k in range(70_000)} | dict.fromkeys(names, b""))


def _header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\2\0" + struct.pack("<I", len(text)) + text


def _archive(parts: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return stream.getvalue()


@cache
def _packed_zeros() -> bytes:
    """An array of zeros, packed: a megabyte and a half holds a thousand times as much."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    begin = _header((_ZEROS // 8,))
    piece = bytes(1 << 24)
    parts = [packer.compress(begin)]
    parts += [packer.compress(piece) for _ in range(_ZEROS // len(piece))]
    return b"".join([*parts, packer.flush()])


def _raw_archive(parts: dict[str, bytes]) -> bytes:
    """An archive of parts that are packed already, which do not say how large they are."""
    stream, places = io.BytesIO(), []
    for name, part in parts.items():
        places.append((name, stream.tell(), len(part)))
        stream.write(struct.pack("<4sHHHHHIIIHH", b"PK\3\4", 20, 0, 8, 0, 0, 0, len(part), 1000, len(name), 0))
        stream.write(name.encode() + part)
    begin = stream.tell()
    for name, at, size in places:
        head = (b"PK\1\2", 20, 20, 0, 8, 0, 0, 0, size, 1000, len(name), 0, 0, 0, 0, 0, at)
        stream.write(struct.pack("<4sHHHHHHIIIHHHHHII", *head) + name.encode())
    end = (b"PK\5\6", 0, 0, len(places), len(places), stream.tell() - begin, begin, 0)
    stream.write(struct.pack("<4sHHHHIIH", *end))
    return stream.getvalue()


_PNG = b"\x89PNG\r\n\x1a\n"


@cache
def _pictures() -> tuple[tuple[str, bytes], ...]:
    """Pictures of many pixels, and with packed zeros in a text."""
    zeros, end = zlib.compress(bytes(100_000_000), 9), _part(b"IEND", b"")
    made = []
    for width, height in ((30_000, 30_000), (2**31 - 1, 1), (1, 2**31 - 1), (0, 0)):
        head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
        made.append((f"{width}x{height}", _PNG + _part(b"IHDR", head) + _part(b"IDAT", zeros) + end))
    head = _part(b"IHDR", struct.pack(">IIBBBBB", 32, 24, 8, 0, 0, 0, 0))
    texts = _part(b"zTXt", b"a\0\0" + zeros) + _part(b"iCCP", b"a\0\0" + zeros)
    made.append(("texts", _PNG + head + texts + _part(b"IDAT", zlib.compress(bytes(33 * 24))) + end))
    made.append(("too much data", _PNG + head + _part(b"IDAT", zeros) + end))
    return tuple(made)


def _part(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


_ANCHORS = b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(9 * [f'*{chr(97 + k)}'])}]\n".encode() for k in range(8)
)
_MERGES = b"m0: &m0 {a: 1}\n" + b"".join(f"m{k + 1}: &m{k + 1} {{<<: [*m{k}, *m{k}]}}\n".encode() for k in range(30))
_ENTITIES = b'<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa">' + b"".join(
    f'<!ENTITY {chr(98 + k)} "{10 * f"&{chr(97 + k)};"}">'.encode() for k in range(9)
) + b'<!ENTITY z SYSTEM "/dev/zero">]><robot>&j;&z;</robot>'  # fmt: skip
_TEXTS = {
    "one long line": b"1 " * 3_000_000,
    "one long number": b"9" * 3_000_000,
    "many lines": b"1\n" * 3_000_000,
    "no text": bytes(3_000_000),
    "quotes": b'"' * 1_000_001,
    "huge numbers": b"1e999999999 " * 12 + b"\n",
}
_YAML = {
    "anchors": _ANCHORS,
    "merges": _MERGES,
    "colons": b"a: 1" + b":59" * 90_000 + b"\n",
    "colons of a float": b"a: 1" + b":59" * 90_000 + b".5\n",
    "deep": b"a: " + b"[" * 100_000,
    "deep blocks": b"".join(b" " * k + b"a:\n" for k in range(700)),
    "tags": b"a: !!python/object/apply:os.system ['true']\n",
}
_OF: dict[str, dict[str, bytes]] = {
    ".yaml": _YAML,
    ".yml": _YAML,
    ".json": {
        "deep": b"[" * 200_000,
        "deep maps": b'{"a":' * 200_000,
        "many": b"[" + b"[]," * 6_000_000 + b"[]]",
        "digits": b"9" * 200_000,
        "no number": b'{"format": NaN, "t": [1e999, 1], "R": [[]]}',
        "other kinds": b'{"study": 1, "scenario": [], "settings": "a", "cells": {"a": 1}, "versions": 3, "files": {}}',
        "a list": b"[1]",
        "empty": b"{}",
    },
    ".toml": {
        "dots": b"a" + b".a" * 100_000 + b" = 1\n",
        "deep": b"a = " + b"[" * 200_000,
        "digits": b"a = " + b"9" * 200_000,
    },
    ".urdf": {"entities": _ENTITIES, "deep": b"<a>" * 200_000, "one tag": b"<robot " + b"a='1' " * 200_000 + b"/>"},
    ".obj": {
        "numbers": b"v 1 2 3\nf 1 2 " + b"9" * 4000 + b"\n",
        "negative": b"v 0 0 0\nf -9 -9 -9\n",
        "one face": b"v 0 0 0\nf" + b" 1" * 500_000,
    },
    ".mcap": {
        "chunk": b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, 2**60) + b"\x89MCAP0\r\n",
        "header": b"\x89MCAP0\r\n" + struct.pack("<BQ", 1, 2**62) + bytes(50),
        "no footer": b"\x89MCAP0\r\n" + bytes(1_000_000),
    },
    ".db3": {
        "no pages": b"SQLite format 3\0" + bytes(84),
        "pages": b"SQLite format 3\0" + b"\x10\0\1\1\0@  " + b"\xff" * 4096,
    },
    ".npz": {"empty": b"", "end": b"PK\5\6" + b"\xff" * 18},
}
