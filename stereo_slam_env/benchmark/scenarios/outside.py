"""Competitors that are trajectories from outside: what their options must be, and beside whom they stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from filters.contract.validation import require_known

OUTSIDE = "trajectory"
"""Name of a competitor that is a trajectory from outside."""
SEED = "{seed}"
"""In the name of its file: the seed of the recording."""


class Competitor(Protocol):
    """What is looked at of a `FilterChoice`."""

    @property
    def label(self) -> str:
        """In tables."""

    @property
    def name(self) -> str:
        """`OUTSIDE`, or that of a filter."""

    @property
    def options(self) -> Mapping[str, Any]:
        """Its options."""


def require_file(choice: Competitor) -> None:
    """Raise a `ValueError` where a trajectory from outside does not say its file."""
    require_known(f"options of {choice.label} have no key", choice.options, ("file", "body"))
    if not all(isinstance(value, str) for value in (choice.options.get("file"), choice.options.get("body", ""))):
        raise ValueError(f"{choice.label} must say its trajectory, as options = {{file = 'est.tum'}}")


def require_place(filters: Sequence[Competitor], *, with_policies: bool, recordings: int) -> None:
    """Raise a `ValueError` where trajectories from outside stand beside no filter, or serve several recordings."""
    outside = [choice for choice in filters if choice.name == OUTSIDE]
    if outside and (with_policies or len(outside) == len(filters)):
        raise ValueError(
            f"{outside[0].label} is a trajectory: it stands beside at least one filter, and in no policy's loop"
        )
    for choice in outside:
        if recordings > 1 and SEED not in choice.options["file"]:
            raise ValueError(f"{choice.label} has one file for several recordings: write {SEED} in its name")
