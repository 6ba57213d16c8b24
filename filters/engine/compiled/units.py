"""Units of compilation: kernels that others call by their address, and the types of what kernels work on.

Numba puts a function that another one calls into that one's code and optimises it again there, level by level. Units
are compiled once, kept on disk each by itself, and called like BLAS. They give nothing back but what they write.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import cfunc, njit, types
from numba.extending import intrinsic

from filters.engine.compiled.blas import ENTRY, PLAIN, ROUTINES, UNIT, at
from filters.engine.compiled.recipe import Recipe
from filters.engine.compiled.storage import empty_frame, empty_storage, scratch

_RECIPE = Recipe(1.0, 1.0, 0.0, 0.0, 1.0)
_STORAGE = empty_storage(_RECIPE, 1, 1)
PLAN = numba.typeof(_RECIPE.plan)
STORAGE = numba.typeof(_STORAGE)
SCRATCH = numba.typeof(scratch(_RECIPE, _STORAGE, 1))
FRAME = numba.typeof(empty_frame(_RECIPE, 1, 1, 1))
VECTOR, MATRIX, INDEX = types.float64[::1], types.float64[:, ::1], types.int64[::1]
GIVEN, GIVEN_COVARIANCE = (
    types.Array(types.float64, 1, "C", readonly=True),
    types.Array(types.float64, 2, "C", readonly=True),
)
"""Odometry of one filter."""
UNITS = ("predict", "fuse", "linearise", "gate", "agree", "propose", "correct", "retract", "enter", "walk")
"""Places of their addresses, after those of BLAS; the last place is that of the doors."""
PREDICT, FUSE, LINEARISE, GATE, AGREE, PROPOSE, CORRECT, RETRACT, ENTER, WALK, DOORS = range(
    len(ROUTINES), len(ROUTINES) + len(UNITS) + 1
)
ADDRESSES = types.UniTuple(types.intp, len(ROUTINES) + len(UNITS) + 1)
TO_LINEARISE, TO_MOVE, TO_START, TO_SELECT, TO_CHANGE, TO_WALK, TO_DRIFT = range(7)
"""What the doors are asked for."""


def unit(*arguments: Any) -> Callable[[Callable[..., None]], Any]:
    """Compile a kernel with these types of arguments as a unit."""
    return _PlainUnit if PLAIN else cfunc(types.void(*arguments), cache=True, **UNIT)


class _PlainUnit:
    """A kernel that is a Python function, and its own address."""

    def __init__(self, function: Callable[..., None]) -> None:
        self.address = function


def _reader(kind: Any) -> Any:
    @intrinsic
    def read(typing_context: Any, address: Any) -> Any:
        """What `packed` wrote there."""

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            pointer = context.get_value_type(kind).as_pointer()
            return builder.load(builder.inttoptr(values[0], pointer))

        return kind(types.intp), generate

    return read


@intrinsic
def _write(typing_context: Any, address: Any, value: Any) -> Any:
    """Write the descriptions of arrays to an address."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        builder.store(values[1], builder.inttoptr(values[0], values[1].type.as_pointer()))
        return context.get_dummy_value()

    return types.void(types.intp, value), generate


def _itself(value: Any) -> Any:
    return value


read_plan, read_storage, read_scratch, read_frame = (
    _itself if PLAIN else _reader(kind) for kind in (PLAN, STORAGE, SCRATCH, FRAME)
)


@njit([types.void(types.int64[::1], kind) for kind in (PLAN, STORAGE, SCRATCH, FRAME)], cache=True, **ENTRY)
def _pack(room: Any, value: Any) -> None:
    _write(at(room), value)


class Packed:
    """A tuple of arrays that kernels read by its address: taking a hundred arrays apart in each call takes longer."""

    def __init__(self, value: Any) -> None:
        self.value = value
        self.address = value
        if PLAIN:
            return
        self._room = np.zeros(20 * len(value) + 8, dtype=np.int64)
        _pack(self._room, value)
        self.address = self._room.ctypes.data
