"""Bounds of what a scenario may ask for: numbers of time, memory and arithmetic."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

MOST_SEED = 2**63 - 1
"""Seeds are kept in tables of 64 bits."""
MOST_CORRUPTIONS = 100
MOST_FRAMES = 1_000_000
MOST_SECONDS = 1e6
_MOST: Mapping[str, float] = {
    **dict.fromkeys(("landmarks", "max_landmarks", "refill_below"), 10_000),
    **dict.fromkeys(("moving_cars", "pedestrians"), 1_000),
    **dict.fromkeys(("iterations", "supersample"), 1_000),
    **dict.fromkeys(("width", "height"), 20_000),
    **dict.fromkeys(("frames", "first", "last"), MOST_FRAMES),
    **dict.fromkeys(("sigma", "independent_pixels", "diagonal"), 1e6),
}
"""By the last key that leads to a number; squares of the last ones are within what filters take for an R, px^2."""
_MOST_OTHERS = 1e12
_DEEPEST, _LONGEST = 20, 1_000_000


def require_bounded(what: str, value: Any, key: str = "", depth: int = 0) -> None:
    """Raise a `ValueError` that names the place, value and bound of a number in plain data that is too large.

    `key` is the last one that leads to it, `depth` the tables and lists around it.
    """
    if isinstance(value, Mapping | list | tuple):
        if depth > _DEEPEST or len(value) > _LONGEST:
            raise ValueError(f"{what} must have at most {_LONGEST} entries, {_DEEPEST} levels deep, got {len(value)}")
        if isinstance(value, Mapping):
            for name, entry in value.items():
                require_bounded(f"{what}.{name}", entry, str(name), depth + 1)
        else:
            for number, entry in enumerate(value):
                require_bounded(f"{what}[{number}]", entry, key, depth + 1)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        most = MOST_SEED if "seed" in key else _MOST.get(key, _MOST_OTHERS)
        if value < -most or value > most:  # what is no number is none of JSON, either
            told = f"{value:.6g}" if isinstance(value, float) or abs(value) < 10**30 else f"{str(value)[:20]}..."
            raise ValueError(f"{what} must be a number of at most {most:g}, got {told}")
