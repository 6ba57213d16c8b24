"""Refusal of unknown names, with the nearest known one."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from difflib import get_close_matches


def did_you_mean(word: object, known: Iterable[object]) -> str:
    """`, did you mean 'x'?` with the nearest of the `known` words, or nothing where none is near.

    Parameters
    ----------
    word : object
        What somebody wrote.
    known : iterable
        What there is.
    """
    near = get_close_matches(str(word), [str(name) for name in known], n=1)
    return f", did you mean {near[0]!r}?" if near else ""


def require_known(subject: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise a `ValueError` for the first of the `given` names that is not `known`.

    Parameters
    ----------
    subject : str
        How the message begins: "the reader has no option".
    given : iterable of str
        Names somebody wrote.
    known : iterable of str
        Names there are.
    """
    names = list(known)
    for name in given:
        if name not in names:
            raise ValueError(
                f"{subject} {name!r}{did_you_mean(name, names) or '.'} Known: {', '.join(names) or 'none'}"
            )


def one_of(name: str, value: object, allowed: Collection[object]) -> None:
    """Raise a `ValueError` if the argument `name` has a `value` that is not `allowed`."""
    if not any(value == choice and type(value) is type(choice) for choice in allowed):
        raise ValueError(f"{name} must be one of {', '.join(map(repr, allowed))}, got {value!r}")
