"""Options that a reader does not know are refused, with a hint."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from filters.suggestions import did_you_mean


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
            raise ValueError(f"{subject} {name!r}{did_you_mean(name, known)} Known: {', '.join(known) or 'none'}")
