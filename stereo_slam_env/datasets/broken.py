"""What to do about a broken pair: stop, or leave it out and count it."""

from __future__ import annotations

import logging
from collections import Counter
from typing import Literal

OnBroken = Literal["raise", "skip"]

log = logging.getLogger(__name__)


class BrokenPair(ValueError):
    """A pair cannot be used.

    Parameters
    ----------
    reason : str
        A few words to count by, the same for all pairs with that fault.
    message : str
        One line that names the file and the remedy.
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class Faults:
    """Raises what is wrong with a pair, or counts it.

    Parameters
    ----------
    on_broken : {"raise", "skip"}
        Which of the two.
    counts : Counter, optional
        Faults met before, reason -> number of pairs.

    Raises
    ------
    ValueError
        `on_broken` is something else.
    """

    def __init__(self, on_broken: OnBroken, counts: Counter[str] | None = None) -> None:
        if on_broken not in ("raise", "skip"):
            raise ValueError(f"on_broken must be 'raise' or 'skip', got {on_broken!r}")
        self.on_broken = on_broken
        self.counts: Counter[str] = Counter(counts or {})

    def meet(self, fault: BrokenPair) -> None:
        """Raise `fault`, or log and count it."""
        if self.on_broken == "raise":
            raise fault
        self.counts[fault.reason] += 1
        log.warning("pair skipped: %s", fault)

    def copy(self) -> Faults:
        """The same faults met so far, counted further on their own."""
        return Faults(self.on_broken, self.counts)
