"""How much memory a piece of work took."""

from __future__ import annotations

import sys
from importlib import import_module

MEGABYTE = 2.0**20


def peak_memory_mb() -> float:
    """Largest resident memory this process has ever had, MB (2^20 bytes); NaN where the system does not tell.

    The difference of two calls is what the work between them added to the peak: the memory it needed, if the process
    has not had as much before.
    """
    try:
        resource = import_module("resource")
    except ImportError:  # Windows
        return float("nan")
    peak = float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return peak / MEGABYTE if sys.platform == "darwin" else peak * 1024.0 / MEGABYTE
