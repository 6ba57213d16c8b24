"""Units of compilation: kernels that others call by their address, and the types of what kernels work on.

Numba puts a function that another one calls into that one's code and optimises it again there, level by level. Units
are compiled once, kept on disk each by itself, and called like BLAS. They give nothing back but what they write.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import cfunc, types
from numba.core import cgutils
from numba.core.errors import NumbaError
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model

from filters.kernels.blas import PLAIN, ROUTINES, UNIT
from filters.kernels.disk_cache import KEPT, include, sources_digest
from filters.kernels.recipe import Recipe
from filters.kernels.scratch import scratch
from filters.kernels.storage import empty_frame, empty_storage


class TupleReference(types.Type):
    """The address of a named tuple of arrays, as `Packed` has written it: one number, whatever the tuple holds."""

    def __init__(self, value: Any) -> None:
        self.kind = numba.typeof(value)
        super().__init__(f"TupleReference({type(value).__name__})")


register_model(TupleReference)(models.OpaqueModel)


@infer_getattr
class _Fields(AttributeTemplate):
    key = TupleReference

    def generic_resolve(self, reference: Any, name: str) -> Any:
        kind = reference.kind
        return kind[kind.fields.index(name)] if name in kind.fields else None


@lower_getattr_generic(TupleReference)
def _field(context: Any, builder: Any, reference: Any, address: Any, name: str) -> Any:
    """Load one field. What describes the arrays does not change during a call, so that loops need not load it again."""
    index = reference.kind.fields.index(name)
    kind, first = reference.kind[index], sum(map(_words, reference.kind.types[:index]))
    word = ir.IntType(64)
    words = builder.bitcast(address, word.as_pointer())

    def load(place: int, target: Any) -> Any:
        pointer = cgutils.gep_inbounds(builder, words, first + place)
        value = builder.load(builder.bitcast(pointer, target.as_pointer()))
        value.set_metadata("invariant.load", builder.module.add_metadata([]))
        return value

    if not isinstance(kind, types.Array):
        return context.data_model_manager[kind].from_data(builder, load(0, context.get_data_type(kind)))
    array = context.make_array(kind)(context, builder)
    context.populate_array(
        array,
        data=load(0, context.get_data_type(kind.dtype).as_pointer()),
        shape=[load(1 + i, word) for i in range(kind.ndim)],
        strides=[load(1 + kind.ndim + i, word) for i in range(kind.ndim)],
        itemsize=context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind.dtype))),
        meminfo=None,
    )
    return array._getvalue()


def _words(kind: Any) -> int:
    """Words of a field: a number, or an array's address, shape and strides."""
    return 1 + 2 * kind.ndim if isinstance(kind, types.Array) else 1


_RECIPE = Recipe()
_STORAGE = empty_storage(_RECIPE, 1, 1)
PLAN, STORAGE = TupleReference(_RECIPE.plan), TupleReference(_STORAGE)
SCRATCH, FRAME = TupleReference(scratch(_RECIPE, _STORAGE, 1)), TupleReference(empty_frame(_RECIPE, 1, 1, 1))
VECTOR, MATRIX, INDEX = types.float64[::1], types.float64[:, ::1], types.int64[::1]
MATRICES, FLAGS = types.float64[:, :, ::1], types.boolean[::1]
UNITS = ("predict", "fuse", "linearise", "gate", "agree", "iterate", "correct", "retract", "start", "enter", "walk")
OF_PARTS = ("point", "start", "turn", "rotation", "become", "predict", "backproject", "step", "measure")
"""Places of their addresses, after those of BLAS; the last place is that of the doors."""
PREDICT, FUSE, LINEARISE, GATE, AGREE, ITERATE, CORRECT, RETRACT, BEGIN, ENTER, WALK = range(
    len(ROUTINES), len(ROUTINES) + len(UNITS)
)
POINTS, START, TURN, EFFECT, BECOME, SENSE, BACKPROJECT, STEP, MEASURE, DOORS = range(
    WALK + 1, WALK + len(OF_PARTS) + 2
)
ADDRESSES = types.UniTuple(types.intp, DOORS + 1)
TO_LINEARISE, TO_MOVE, TO_START, TO_SELECT, TO_CHANGE, TO_WALK, TO_DRIFT = range(7)
"""What the doors are asked for."""
SIGNATURES: dict[str, tuple[Any, ...]] = {
    "LandmarkKernels.point": (VECTOR, MATRIX, MATRIX, MATRICES),
    "LandmarkKernels.start": (VECTOR, MATRIX, MATRIX, MATRICES, FLAGS),
    "LandmarkKernels.turn": (VECTOR, MATRIX, VECTOR, MATRIX, MATRIX, MATRICES, MATRICES),
    "LandmarkKernels.rotation": (VECTOR, MATRIX, MATRICES),
    "LandmarkKernels.become": (VECTOR, MATRIX, MATRIX, MATRIX, FLAGS),
    "MeasurementKernels.predict": (VECTOR, VECTOR, MATRIX, VECTOR, MATRIX, MATRICES, MATRICES, FLAGS),
    "MeasurementKernels.backproject": (VECTOR, VECTOR, MATRIX, VECTOR, MATRIX, MATRICES, MATRICES),
    "MotionKernels.step": (VECTOR, VECTOR, types.float64, MATRIX, VECTOR, MATRIX, MATRIX),
    "MotionKernels.measure": (VECTOR, VECTOR, types.float64, MATRIX, VECTOR, MATRIX, MATRIX),
}
"""Arguments of the kernels of parts."""


class Unit:
    """A kernel that is compiled when its address is first asked for."""

    def __init__(self, kernel: Callable[..., None], *arguments: Any, **options: Any) -> None:
        self.kernel, self.arguments, self.options = kernel, arguments, options or {**KEPT, **UNIT}
        sources_digest(kernel.__module__)  # as they are imported now

    @cached_property
    def _compiled(self) -> Any:
        return cfunc(types.void(*self.arguments), **self.options)(self.kernel)

    @property
    def address(self) -> Any:
        """Where this process has its machine code; the function itself where kernels are plain Python."""
        address: Any = self.kernel if PLAIN else self._compiled.address
        return address


def unit(*arguments: Any) -> Callable[[Callable[..., None]], Unit]:
    """Make a kernel with these types of arguments a unit."""
    return lambda kernel: Unit(kernel, *arguments)


@cache
def of_part(kernels: Any, name: str) -> Any:
    """Address of a kernel of a part; zero where it has none of that name.

    Raises
    ------
    ValueError
        Numba cannot compile it.
    """
    function, place = getattr(kernels, name), f"{type(kernels).__name__}.{name}"
    if function is None:
        return 0
    function = getattr(function, "py_func", function)
    include(function.__module__)
    there = {**KEPT, "cache": Path(function.__code__.co_filename).exists()}  # else there is no place to keep it
    try:
        whole = Unit(function, *SIGNATURES[place], error_model="numpy", fastmath={"contract"}, **there)
        _LOADED.append(whole)
        return whole.address
    except NumbaError as error:
        reason = " ".join(_COLOUR.sub("", str(error)).split())[:_LONGEST]
        raise ValueError(
            f"{place} {function.__qualname__} must be a function that Numba can compile: {reason}"
        ) from None


_COLOUR, _LONGEST = re.compile(r"\x1b\[\d*m"), 400  # of what Numba says
_LOADED: list[Unit] = []
"""Whose addresses are known: they must stay."""


def _reader(kind: Any) -> Any:
    @intrinsic
    def read(typing_context: Any, address: Any) -> Any:
        """What `packed` wrote there."""

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return builder.inttoptr(values[0], context.get_value_type(kind))

        return kind(types.intp), generate

    return read


def _itself(value: Any) -> Any:
    return value


read_plan, read_storage, read_scratch, read_frame = (
    _itself if PLAIN else _reader(kind) for kind in (PLAN, STORAGE, SCRATCH, FRAME)
)


class Packed:
    """A tuple of arrays and numbers that kernels read by its address."""

    def __init__(self, value: Any) -> None:
        self.value = value
        words: list[int] = []
        for field in value:
            if isinstance(field, np.ndarray):
                words += [field.ctypes.data, *field.shape, *field.strides]
            else:
                words.append(
                    int(np.array(field, np.float64).view(np.int64)) if isinstance(field, float) else int(field)
                )
        self._words = np.array(words)
        self.address: Any = value if PLAIN else self._words.ctypes.data
