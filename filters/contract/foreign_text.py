"""Texts of strangers, made fit for a line of a terminal, a page or a table: control characters are written out.

Names, messages and fields of files may hold what a terminal obeys, and an exception of somebody's code may raise even
when it is asked for its message. Whatever is shown or stored of them goes through here.
"""

from __future__ import annotations

import re
from html import escape
from typing import Any

MOST_CHARACTERS = 2000
"""Longer lines are cut."""
_MOST_READ = 100_000
_NAME: Any = vars(type)["__name__"]
_CONTROLS = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def plain(text: str) -> str:
    """The text with every character that does not print written out in ASCII; line ends stay."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def without_controls(document: str) -> str:
    """A page with a replacement character for what controls a terminal or turns the direction of a text around."""
    return _CONTROLS.sub("\N{REPLACEMENT CHARACTER}", document)


def markdown(text: str) -> str:
    """The text for a line or a cell of a table in Markdown: no markup in it is one."""
    return re.sub(r"([\\|\[\]`])", r"\\\1", escape(" ".join(plain(text).split()), quote=False))


def first_line(error: BaseException, *, empty: str | None = None) -> str:
    """First line of an exception's message, plain; of an empty one `empty`, or its type."""
    try:
        text = str.__getitem__(str(error), slice(_MOST_READ))  # its own __str__ may return a text of a class of its own
    except BaseException:  # ... or raise anything
        text = "its message cannot be read"
    lines = text.strip().splitlines()
    if not lines:
        return type_name(error) if empty is None else empty
    return plain(lines[0][:MOST_CHARACTERS])


def type_name(error: BaseException) -> str:
    """Name of an exception's type, plain."""
    name: str = _NAME.__get__(type(error))  # a metaclass may give `__name__` a meaning of its own
    return plain(name[:MOST_CHARACTERS])


def error_line(error: BaseException) -> str:
    """Type and message of an exception in a line."""
    return f"{type_name(error)}: {first_line(error, empty='no message')}"
