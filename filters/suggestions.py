"""The nearest known word, for messages about an unknown one."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(word: object, known: Iterable[object]) -> str:
    """`, did you mean 'x'?` with the nearest of the `known` words, or nothing where none is near.

    Parameters
    ----------
    word : object
        What somebody wrote; of another type than str, it is near to nothing or to what it looks like.
    known : iterable
        What there is.
    """
    near = get_close_matches(str(word), [str(name) for name in known], n=1)
    return f", did you mean {near[0]!r}?" if near else ""
