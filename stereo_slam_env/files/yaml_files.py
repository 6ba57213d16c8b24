"""The one reader of YAML: what calibrations and bags consist of, and none of what makes small texts large or slow.

Anchors, aliases, merge keys and tags are refused: nested ones say in a line what fills the memory. Numbers with colons
are texts, as YAML 1.2 has them: to the base of 60, a long one takes the square of its length.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any

from filters.contract.validation import first_line, plain

MOST_TEXT = 5_000_000
"""Longer texts are refused, characters."""
MOST_NODES = 200_000
MOST_DEPTH = 50
MOST_DIGITS = 400
"""Of a number."""
_COLONS = re.compile(r"[-+]?[0-9][0-9_]*(?::[0-9.]+)+")
_SHOWN = 200


def parse_yaml(text: str) -> Any:
    """Content of a text in YAML.

    Raises
    ------
    ValueError
        No YAML, more than one document, or with what is not read or is too much: one line, which does not name a file.
    """
    import yaml

    if len(text) > MOST_TEXT:
        raise ValueError(f"it has {len(text)} characters, more than {MOST_TEXT} are refused")
    try:
        _require_plain(text)
        loader = _loader()(text)
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except yaml.YAMLError as error:
        raise ValueError(plain(" ".join(str(error).split()))[:_SHOWN]) from error
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        raise ValueError(first_line(error)) from error


def _require_plain(text: str) -> None:
    """Raise a `ValueError` for anchors, aliases, tags, and too many or too deep entries, before anything is built."""
    import yaml

    depth = nodes = 0
    for event in yaml.parse(text, Loader=_base()):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        nodes += isinstance(event, yaml.NodeEvent)
        if getattr(event, "anchor", None) is not None:
            raise ValueError(f"line {event.start_mark.line + 1} has an anchor or an alias, which are not read")
        if getattr(event, "tag", None) is not None:
            raise ValueError(f"line {event.start_mark.line + 1} has a tag, {plain(event.tag)!r}, which is not read")
        if depth > MOST_DEPTH or nodes > MOST_NODES:
            raise ValueError(f"it has more than {MOST_NODES} entries, or more than {MOST_DEPTH} levels")


def _base() -> Any:
    import yaml

    return getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@cache
def _loader() -> Any:
    """A loader without merge keys and numbers with colons, and of numbers of a bounded length."""
    import yaml

    class Plain(_base()):  # type: ignore[misc]
        def flatten_mapping(self, node: Any) -> None:
            """Refuse merge keys."""
            for key, _ in node.value:
                if key.tag == "tag:yaml.org,2002:merge":
                    raise ValueError(f"line {key.start_mark.line + 1} has a merge key, which is not read")

    def number(loader: Any, node: Any) -> Any:
        if _COLONS.fullmatch(node.value):
            return node.value
        if len(node.value) > MOST_DIGITS:
            raise ValueError(f"line {node.start_mark.line + 1} has a number of {len(node.value)} digits")
        return yaml.SafeLoader.yaml_constructors[node.tag](loader, node)

    for kind in ("int", "float"):
        Plain.add_constructor(f"tag:yaml.org,2002:{kind}", number)
    return Plain
