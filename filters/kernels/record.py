"""Records of arrays that kernels work on: each array is declared once, in a row of a table."""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray

ALIGNED = "aligned"
"""Numbers whose first one begins a line of the cache: vectors of eight do not lie across two of them."""
REAL, INT, FLAG, BYTE = np.float64, np.int64, np.bool_, np.uint8
Rows = Sequence[tuple[str, Any, str, str]]
"""Name, type, names of the sizes of its axes, and meaning of each array."""


def record_of(module: str, name: str, rows: Rows) -> Any:
    """Type of a record."""
    return namedtuple(name, [row[0] for row in rows], module=module)


def allocated(record: Any, rows: Rows, sizes: Mapping[str, int], **given: Any) -> Any:
    """Record of arrays of these sizes, zero but for the given ones."""
    arrays = {}
    for name, kind, axes, _ in rows:
        shape = tuple(sizes[axis] if axis in sizes else int(axis) for axis in axes.split())
        if name not in given:
            arrays[name] = aligned(*shape) if kind == ALIGNED else np.zeros(shape, dtype=kind)
    return record(**arrays, **given)


def aligned(*shape: int) -> FloatArray:
    """Zeros from the start of a line of the cache on."""
    size = math.prod(shape)
    room = np.zeros(size + 7)
    first = -(room.ctypes.data // 8) % 8
    return room[first : first + size].reshape(shape)
