"""Mutations without guidance: for machines without atheris, and for the tests, because they are deterministic."""

from __future__ import annotations

import random
import re
from collections.abc import Sequence

from fuzz.harness import HEADER

_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?")
_WORDS = (
    *(b"nan", b"inf", b"-1", b"0", b"1e308", b"-1e308", b"1e-320", b"99999999999999999999", b"1e19", b"2147483648"),
    *(b"", b"x", b"true", b"[]", b"{}", b'"a"', b"-", b"\xc3\xa4", b"\xff\xfe", b"\x1b[2J", b"../../x", b"$x^$"),
)


def mutated(seed: bytes, others: Sequence[bytes], rng: random.Random) -> bytes:
    """A seed with one to four changes; `others` are seeds to take pieces from."""
    content = seed[HEADER:]
    for _ in range(rng.randint(1, 4)):
        content = rng.choice(_CHANGES)(content, rng.choice(others)[HEADER:], rng)
    return seed[:HEADER] + content


def _span(content: bytes, rng: random.Random, longest: int = 64) -> tuple[int, int]:
    start = rng.randint(0, len(content))
    return start, min(start + rng.randint(0, longest), len(content))


def _flip(content: bytes, _: bytes, rng: random.Random) -> bytes:
    if not content:
        return content
    at = rng.randrange(len(content))
    return content[:at] + bytes([content[at] ^ (1 << rng.randrange(8))]) + content[at + 1 :]


def _cut(content: bytes, _: bytes, rng: random.Random) -> bytes:
    start, end = _span(content, rng)
    return content[:start] + content[end:]


def _cut_off(content: bytes, _: bytes, rng: random.Random) -> bytes:
    return content[: rng.randint(0, len(content))]


def _repeat(content: bytes, _: bytes, rng: random.Random) -> bytes:
    start, end = _span(content, rng)
    return content[:end] + rng.choice((1, 2, 50)) * content[start:end] + content[end:]


def _splice(content: bytes, other: bytes, rng: random.Random) -> bytes:
    start, end = _span(other, rng)
    at = rng.randint(0, len(content))
    return content[:at] + other[start:end] + content[at:]


def _renumber(content: bytes, _: bytes, rng: random.Random) -> bytes:
    found = list(_NUMBER.finditer(content))
    if not found:
        return content
    match = rng.choice(found)
    return content[: match.start()] + rng.choice(_WORDS) + content[match.end() :]


def _lines(content: bytes, _: bytes, rng: random.Random) -> bytes:
    lines = content.split(b"\n")
    rng.shuffle(lines)
    return b"\n".join(lines[: rng.randint(1, len(lines))])


_CHANGES = (_flip, _cut, _cut_off, _repeat, _splice, _renumber, _renumber, _renumber, _lines)
