"""Records of MCAP and of ROS 1 bags: their headers are read, and chunks counted, before a library unpacks them.

Definitions of messages in a bag: code is made of them, so they are counted first.
"""

from __future__ import annotations

import bz2
import re
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from stereo_slam_env.files.opening import (
    MOST_UNPACKED,
    Unbounded,
    lz4_bound,
    require_bounded_zstd,
    unpacked,
    zstd_bound,
)

MOST_AT_ONCE = 1_000_000_000
"""Bytes of chunks whose times overlap: a reader has all of them in memory."""
MOST_SMALL = 5_000_000
"""Bytes of a record that is no message, chunk or attachment."""
MOST_RECORDS_GROWTH = 100
"""All chunks may unpack to so many times the size of the file, or to `MOST_AT_ONCE`."""
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX = 3, 4, 5, 6, 8
_LARGE = (_MESSAGE, _CHUNK, 9)
_FOOTER = 37
_PIECE = 1 << 20
CheckQos = Callable[[Path, object], None]


class BagTooLarge(ValueError):
    """A bag that would take more memory, disk or time than a recording does."""


@dataclass(frozen=True)
class _Chunk:
    """Header of a chunk."""

    packing: str
    packed: int
    unpacked: int
    at: int


def check_mcap(
    path: Path, stream: BinaryIO, *, most_topics: int, check_qos: CheckQos, packed_messages: bool = False
) -> None:
    """Raise a `ValueError` for an MCAP file that would unpack to too much; what is damaged is left to its reader."""
    size = stream.seek(0, 2)
    stream.seek(max(size - _FOOTER, 0))
    footer = stream.read()
    if len(footer) < _FOOTER or footer[:9] != b"\x02\x14\0\0\0\0\0\0\0":
        return  # its reader says so
    (summary,) = struct.unpack_from("<Q", footer, 9)
    chunks: dict[int, _Chunk] = {}
    spans: list[tuple[int, int, int]] = []
    topics = schemas_in_summary = 0
    hit = summary in (0, size - _FOOTER)
    for at, kind, length, begin in _mcap_records(path, stream, 8, size - _FOOTER):
        hit |= at == summary
        if kind == _CHUNK:
            chunks[at] = _mcap_chunk(path, stream, begin, length)
        elif kind == _CHANNEL:
            topics += 1
            _check_channel(path, _content(stream, begin, length), check_qos)
        elif kind == _SCHEMA:
            schemas_in_summary += bool(summary) and at >= summary
        elif kind == _INDEX:
            spans.append(_mcap_index(path, _content(stream, begin, length), chunks))
        elif kind == _MESSAGE and packed_messages:
            require_bounded_zstd(path, _content(stream, begin, length)[22:])
        if topics > 2 * most_topics:
            raise BagTooLarge(f"{path} has more than {most_topics} topics, which is refused")
    if not hit:
        raise ValueError(f"{path} is damaged: its summary begins within a record, copy it again")
    _check_chunks(path, chunks.values(), size, spans)
    looks_inside = summary == 0 or not schemas_in_summary
    for chunk in chunks.values():
        _check_chunk(path, stream, chunk)
        if looks_inside or packed_messages:
            topics += _inside(path, stream, chunk, check_qos, packed_messages)
            if topics > 2 * most_topics:
                raise BagTooLarge(f"{path} has more than {most_topics} topics, which is refused")


def _mcap_records(path: Path, stream: BinaryIO, begin: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Place, kind, length and place of the content of every record."""
    at = begin
    while at + 9 <= end:
        stream.seek(at)
        kind, length = struct.unpack("<BQ", stream.read(9))
        if at + 9 + length > end:
            raise ValueError(f"{path} is damaged, or cut off: copy it again, or repair it with the tools of ROS")
        if kind not in _LARGE and length > MOST_SMALL:
            raise BagTooLarge(
                f"{path} has a record of {length} bytes that is no message: more than {MOST_SMALL} are refused"
            )
        yield at, kind, length, at + 9
        at += 9 + length


def _content(stream: BinaryIO, begin: int, length: int) -> bytes:
    stream.seek(begin)
    return stream.read(length)


def _damaged(path: Path, error: Exception) -> ValueError:
    return ValueError(f"{path} is damaged ({error}): copy it again, or repair it with the tools of ROS")


def _mcap_chunk(path: Path, stream: BinaryIO, begin: int, length: int) -> _Chunk:
    try:
        head = _content(stream, begin, min(length, 200))
        unpacked, name = struct.unpack_from("<Q", head, 16)[0], struct.unpack_from("<I", head, 28)[0]
        packing = head[32 : 32 + name].decode()
        (packed,) = struct.unpack_from("<Q", head, 32 + name)
        if 40 + name + packed > length:
            raise ValueError("a chunk is longer than its record")
        return _Chunk(packing, packed, unpacked, begin + 40 + name)
    except (struct.error, ValueError) as error:
        raise _damaged(path, error) from error


def _mcap_index(path: Path, record: bytes, chunks: dict[int, _Chunk]) -> tuple[int, int, int]:
    """Times and unpacked size of the chunk that an index is of, which must be one that was counted."""
    try:
        start, end, at, _ = struct.unpack_from("<QQQQ", record)
        (offsets,) = struct.unpack_from("<I", record, 32)
        (name,) = struct.unpack_from("<I", record, 44 + offsets)
        packing = record[48 + offsets : 48 + offsets + name].decode()
        packed, unpacked = struct.unpack_from("<QQ", record, 48 + offsets + name)
        chunk = chunks[at]
        if (packing, packed, unpacked) != (chunk.packing, chunk.packed, chunk.unpacked):
            raise ValueError("an index is not that of its chunk")
        return start, end, unpacked
    except KeyError as error:
        raise _damaged(path, ValueError("an index is of no chunk")) from error
    except (struct.error, ValueError) as error:
        raise _damaged(path, error) from error


def _check_channel(path: Path, record: bytes, check_qos: CheckQos) -> None:
    try:
        at, texts = 4, []
        for _ in range(2):
            at += 4 + struct.unpack_from("<I", record, at)[0]
        at, end = at + 4, at + 4 + struct.unpack_from("<I", record, at)[0]
        while at < end:
            (length,) = struct.unpack_from("<I", record, at)
            texts.append(record[at + 4 : at + 4 + length].decode())
            at += 4 + length
    except (struct.error, ValueError) as error:
        raise _damaged(path, error) from error
    for key, value in zip(texts[::2], texts[1::2], strict=False):
        if key == "offered_qos_profiles":
            check_qos(path, value)


def _check_chunks(path: Path, chunks: Any, size: int, spans: list[tuple[int, int, int]]) -> None:
    """Raise a `ValueError` where chunks are too large, alone, together, or those of one time."""
    sizes = [chunk.unpacked for chunk in chunks]
    limit = max(MOST_AT_ONCE, MOST_RECORDS_GROWTH * size)
    if max(sizes, default=0) > MOST_UNPACKED or sum(sizes) > limit:
        raise BagTooLarge(
            f"{path} would unpack to {sum(sizes)} bytes: more than {limit}, or {MOST_UNPACKED} of a chunk, are refused"
        )
    events = sorted(
        [(start, unpacked) for start, _, unpacked in spans] + [(end + 1, -unpacked) for _, end, unpacked in spans]
    )
    open_now = 0
    for _, change in sorted(events):
        open_now += change
        if open_now > MOST_AT_ONCE:
            raise BagTooLarge(f"{path} has chunks of more than {MOST_AT_ONCE} bytes at one time, which are refused")


def _check_chunk(path: Path, stream: BinaryIO, chunk: _Chunk) -> None:
    """Raise a `ValueError` for a chunk that unpacks to more than it states it may."""
    if chunk.packing not in ("lz4", "zstd", "bz2"):
        return
    content = _content(stream, chunk.at, chunk.packed)
    try:
        if chunk.packing == "bz2":
            _count_bz2(content, chunk.unpacked)
        else:
            {"lz4": lz4_bound, "zstd": zstd_bound}[chunk.packing](content)
    except (Unbounded, OSError, EOFError) as error:
        raise BagTooLarge(f"{path} has a chunk that is not read: {error}") from error


def _count_bz2(content: bytes, stated: int) -> None:
    """Unpack, and forget, up to the stated size: bzip2 does not say it."""
    at = 0
    unpacker, rest = bz2.BZ2Decompressor(), content
    while not unpacker.eof:
        at += len(unpacker.decompress(rest, _PIECE))
        rest = b""
        if at > stated:
            raise Unbounded(f"it would unpack to more than the {stated} bytes that it states")
        if unpacker.needs_input:
            raise Unbounded("it is cut off")


def _inside(path: Path, stream: BinaryIO, chunk: _Chunk, check_qos: CheckQos, packed_messages: bool) -> int:
    """Check the channels of a chunk, and its packed messages; returns how many channels there are."""
    content, at, channels = _content(stream, chunk.at, chunk.packed), 0, 0
    try:
        content = unpacked(chunk.packing, content)
    except Exception:  # of the library that unpacks; the reader of the bag says what is damaged
        return 0
    while at + 9 <= len(content):
        kind, length = struct.unpack_from("<BQ", content, at)
        if kind == _CHANNEL:
            channels += 1
            _check_channel(path, content[at + 9 : at + 9 + length], check_qos)
        elif kind == _MESSAGE and packed_messages:
            require_bounded_zstd(path, content[at + 9 + 22 : at + 9 + length])
        at += 9 + length
    return channels


# ---- ROS 1 -----------------------------------------------------------------------------------------------------------


def check_ros1(path: Path, stream: BinaryIO, *, most_topics: int) -> None:
    """Raise a `ValueError` for a bag of ROS 1 that would unpack to too much; what is damaged is left to its reader."""
    size = stream.seek(0, 2)
    at, topics = 13, 0
    chunks: dict[int, _Chunk] = {}
    spans: list[tuple[int, int, int]] = []
    index, hit = 0, False
    while at + 8 <= size:
        fields, begin, length = _ros1_record(path, stream, at, size)
        kind = fields.get("op", b"\0")[:1]
        hit |= at == index
        if kind == b"\x03":
            index = _number(path, fields, "index_pos", "<Q")
            hit |= index == 0
        elif kind == b"\x05":
            packing = fields.get("compression", b"none").decode(errors="replace")
            chunks[at] = _Chunk(packing, length, _number(path, fields, "size", "<I"), begin)
        elif kind == b"\x06":
            if (chunk := chunks.get(_number(path, fields, "chunk_pos", "<Q"))) is None:
                raise _damaged(path, ValueError("an index is of no chunk"))
            times = [
                struct.unpack("<II", fields.get(name, bytes(8))[:8].ljust(8, b"\0"))
                for name in ("start_time", "end_time")
            ]
            start, end = (1_000_000_000 * seconds + rest for seconds, rest in times)
            spans.append((start, end, chunk.unpacked))
        elif kind == b"\x07":
            topics += 1
            if topics > 2 * most_topics:
                raise BagTooLarge(f"{path} has more than {most_topics} topics, which is refused")
        at = begin + length
    if not hit:
        raise _damaged(path, ValueError("its index begins within a record"))
    _check_chunks(path, chunks.values(), size, spans)
    for chunk in chunks.values():
        _check_chunk(path, stream, chunk)


def _ros1_record(path: Path, stream: BinaryIO, at: int, size: int) -> tuple[dict[str, bytes], int, int]:
    """Fields of the header of a record, and place and length of its content."""
    stream.seek(at)
    (length,) = struct.unpack("<I", stream.read(4))
    if length > MOST_SMALL:
        raise BagTooLarge(f"{path} has a record with a header of {length} bytes, which is refused")
    header, fields, k = stream.read(length), {}, 0
    try:
        while k < length:
            (count,) = struct.unpack_from("<I", header, k)
            name, _, value = header[k + 4 : k + 4 + count].partition(b"=")
            fields[name.decode()] = value
            k += 4 + count
        (content,) = struct.unpack("<I", stream.read(4))
    except (struct.error, ValueError) as error:
        raise _damaged(path, error) from error
    begin = at + 8 + length
    if begin + content > size:
        raise _damaged(path, ValueError("it is cut off"))
    return fields, begin, content


def _number(path: Path, fields: dict[str, bytes], name: str, form: str) -> int:
    try:
        (value,) = struct.unpack(form, fields[name])
        return int(value)
    except (KeyError, struct.error) as error:
        raise _damaged(path, ValueError(f"a record lacks {name}")) from error


MOST_TEXT = 500_000
"""Characters of one definition."""
MOST_FIELDS = 10_000
"""Fields of all types together, an array of a fixed length counted by its entries, unless they are numbers."""
MOST_FIXED = 1_000_000
"""Entries of an array of numbers whose length is fixed."""
_NUMBERS = re.compile(r"(?:bool|byte|char|octet|u?int(?:8|16|32|64)|float(?:32|64))\Z")
_FIELD = re.compile(r"^\s*([\w/]+)(?:<=\d+)?\s*(\[[<=\d\s]*\])?\s+\w+\s*(?!\s*=)", re.MULTILINE)
_LENGTH = re.compile(r"\[\s*(\d+)\s*\]|,\s*(\d+)\s*>")
_SECTIONS = re.compile(r"^=+\s*$", re.MULTILINE)
_NAME = re.compile(r"\A\s*(?:MSG|IDL): *([\w/]+)")


class DefinitionTooLarge(ValueError):
    """A message whose definition would make too much code, or whose reading would have no end."""


def check_definitions(path: Path, definitions: Iterable[tuple[str, str]]) -> None:
    """Raise a `ValueError` for definitions that no message has.

    Parameters
    ----------
    path : Path
        The bag, for the message.
    definitions : iterable of (str, str)
        Name of the type, and its definition, with those that it needs below.
    """
    sections: dict[str, str] = {}
    for name, text in dict.fromkeys(definitions):
        if len(text) > MOST_TEXT:
            raise DefinitionTooLarge(
                f"{path} has a definition of {len(text)} characters: more than {MOST_TEXT} are refused"
            )
        for section in _SECTIONS.split(text):
            match = _NAME.match(section)
            sections.setdefault(section[match.end() :] if match else section, match[1] if match else name)
    fields, empty, arrays = 0, set(), set()
    for section, name in sections.items():
        plain = re.sub(r"#.*", "", section)
        fields_found = _FIELD.findall(plain)
        fields += max(len(fields_found), plain.count("\n"))
        if not fields_found:
            empty.add(name.rpartition("/")[2])
        for kind, brackets in fields_found:
            short = kind.rpartition("/")[2]
            if brackets:
                arrays.add(short)
            length = re.search(r"\[\s*(\d+)", brackets)
            count = int(length[1][:20]) if length else 0
            if count > MOST_FIXED:
                raise DefinitionTooLarge(
                    f"{path} defines an array of {count} entries: more than {MOST_FIXED} are refused"
                )
            fields += 0 if _NUMBERS.match(short) else count
        if "IDL" in section or "module " in section:
            fields += sum(min(int((a or b)[:20]), 10 * MOST_FIELDS) for a, b in _LENGTH.findall(plain))
    if fields > MOST_FIELDS:
        raise DefinitionTooLarge(f"{path} defines messages of {fields} fields: more than {MOST_FIELDS} are refused")
    if endless := empty & arrays:
        raise DefinitionTooLarge(f"{path} defines an array of {min(endless)}, which is empty: it would have no end")
