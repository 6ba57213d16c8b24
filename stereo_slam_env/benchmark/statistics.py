"""Paired differences with intervals and tests: what the runs show, and what they do not."""

from __future__ import annotations

from enum import Enum


class Finding(Enum):
    """What a comparison shows about the first of two."""

    BETTER = "better"
    WORSE = "worse"
    NOT_SHOWN = "no difference shown"
