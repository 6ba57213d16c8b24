"""Options that a reader does not know are refused, with a hint."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any


def keyword_options(function: Callable[..., Any]) -> list[str]:
    """Names of the keyword-only parameters of a function."""
    parameters = inspect.signature(function).parameters
    return [name for name, parameter in parameters.items() if parameter.kind is inspect.Parameter.KEYWORD_ONLY]


def require_known(subject: str, given: Iterable[str], known: Sequence[str]) -> None:
    """Raise a `ValueError` for the first of the `given` names that is not `known`.

    Parameters
    ----------
    subject : str
        How the message begins: "the reader has no option".
    given : iterable of str
        Names somebody wrote.
    known : sequence of str
        Names there are.
    """
    for name in given:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f", did you mean {near[0]}?" if near else ""
            raise ValueError(f"{subject} {name!r}{hint} Known: {', '.join(known)}")
