"""Windows of a run: the motion over some seconds, whose error does not hang on one early heading error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from filters.validation import FloatArray

WINDOWS = (1.0, 10.0)
"""Lengths of the windows that are scored, s."""
_SAME_TIME = 1e-6  # s


def window_ends(timestamps: FloatArray | Sequence[float], seconds: float) -> Iterator[tuple[int, int]]:
    """First and last rows of windows that do not overlap: each ends at the first row that is so much later."""
    first = 0
    for row, time in enumerate(timestamps):
        if time - timestamps[first] >= seconds - _SAME_TIME:
            yield first, row
            first = row
