"""Definitions of messages in a bag: code is made of them, so they are counted first."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

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
        found = _FIELD.findall(plain)
        fields += max(len(found), plain.count("\n"))
        if not found:
            empty.add(name.rpartition("/")[2])
        for kind, brackets in found:
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
