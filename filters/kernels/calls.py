"""Calls between compiled functions by name and address, and the records of arrays that they work on.

Numba puts a function that another one calls into that one's code and optimises it again there, level by level. Units
are compiled once, kept on disk each by itself, and called by their address, like LAPACK. They give nothing back but
what they write. `SIGNATURES` says what each is given; caller and unit are both held against it when they are compiled.

A record, such as the state of the filters, is passed by its address, too: one number, whatever it holds.
"""

from __future__ import annotations

import ctypes
import math
import re
import threading
from collections import namedtuple
from collections.abc import Callable, Mapping
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import cfunc, types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model

from filters.kernels.blas import CHOLESKY, PLAIN
from filters.kernels.compilation import KEPT, include, stamped
from filters.kernels.recipe import Recipe
from filters.kernels.records import empty_frame, empty_storage, scratch


class Address(types.Type):
    """Address of compiled code whose arguments are those of `SIGNATURES`."""

    def __init__(self, callee: str) -> None:
        self.callee = callee
        super().__init__(f"Address({callee})")


class Reference(types.Type):
    """Address of a record, as `Packed` has written it; its fields are those of `_RECORDS`."""

    def __init__(self, record: str) -> None:
        self.record = record
        super().__init__(f"Reference({record})")


@register_model(Address)
class _AddressModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.IntType(64))


register_model(Reference)(models.OpaqueModel)


@infer_getattr
class _Fields(AttributeTemplate):
    key = Reference

    def generic_resolve(self, reference: Any, name: str) -> Any:
        return _RECORDS[reference.record].get(name)


@lower_getattr_generic(Reference)
def _field(context: Any, builder: Any, reference: Any, address: Any, name: str) -> Any:
    """Load one field. What describes the arrays does not change during a call, so that loops need not load it again."""
    fields = _RECORDS[reference.record]
    kind, first = fields[name], sum(_words(fields[before]) for before in list(fields)[: list(fields).index(name)])
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


CALLS, PLAN, STORAGE, SCRATCH, FRAME = map(Reference, ("calls", "plan", "storage", "scratch", "frame"))
VECTOR, MATRIX, INDEX = types.float64[::1], types.float64[:, ::1], types.int64[::1]
MATRICES, FLAGS = types.float64[:, :, ::1], types.boolean[::1]
INT = types.int64
SIGNATURES: Mapping[str, tuple[Any, ...]] = {
    "cholesky": (),  # LAPACK's, which takes pointers
    # steps of a frame
    "predict": (CALLS, PLAN, MATRIX, INT, VECTOR, VECTOR, FRAME, INT, SCRATCH),
    "fuse_odometry": (CALLS, PLAN, MATRIX, INT, VECTOR, FRAME, INT, SCRATCH),
    "linearise": (CALLS, PLAN, INT, INT, STORAGE, INT, VECTOR, MATRIX, SCRATCH, INT),
    "distances": (PLAN, MATRIX, SCRATCH, INDEX, INT, INT),
    "agree": (PLAN, MATRIX, INT, SCRATCH, INDEX, INT, INT, types.float64, MATRIX, INT),
    "iterate": (CALLS, PLAN, INT, INT, STORAGE, INT, SCRATCH, INT, INT),
    "correct": (CALLS, PLAN, MATRIX, INT, SCRATCH, INDEX, INT, INT),
    "retract": (CALLS, PLAN, STORAGE, INT, SCRATCH),
    "initialise": (CALLS, PLAN, STORAGE, INT, SCRATCH, FRAME, INT, INT),
    "augment": (PLAN, STORAGE, INT, SCRATCH, FRAME, INT, INT),
    # what only some options need
    "settle": (PLAN, MATRIX, INT, VECTOR, VECTOR, SCRATCH),
    "drift": (CALLS, PLAN, INT, INT, INT, STORAGE, INT, SCRATCH, INT),
    "fade": (PLAN, STORAGE, INT, SCRATCH, types.float64),
    "drop_unseen": (PLAN, STORAGE, INT, SCRATCH, FRAME, INT, INT),
    "become_points": (CALLS, PLAN, STORAGE, INT, SCRATCH),
    "turn_own": (CALLS, PLAN, STORAGE, INT, SCRATCH),
    "turn_with_world": (PLAN, STORAGE, INT, SCRATCH),
    "scale_blocks": (PLAN, MATRIX, INT, SCRATCH),
    "shear": (MATRIX, INT, SCRATCH),
    "walk_gauge": (CALLS, PLAN, STORAGE, INT, SCRATCH, VECTOR),
    # parts of the filter, see `Functions`
    "point": (VECTOR, MATRIX, MATRIX, MATRICES),
    "start": (VECTOR, MATRIX, MATRIX, MATRICES, FLAGS),
    "turn": (VECTOR, MATRIX, VECTOR, MATRIX, MATRIX, MATRICES, MATRICES),
    "rotation": (VECTOR, MATRIX, MATRICES),
    "shift": (VECTOR, MATRIX, MATRICES),
    "become": (VECTOR, MATRIX, MATRIX, MATRIX, FLAGS),
    "project": (VECTOR, VECTOR, MATRIX, VECTOR, MATRIX, MATRICES, MATRICES, FLAGS),
    "backproject": (VECTOR, VECTOR, MATRIX, VECTOR, MATRIX, MATRICES, MATRICES),
    "step": (VECTOR, VECTOR, types.float64, MATRIX, VECTOR, MATRIX, MATRIX),
    "measure": (VECTOR, VECTOR, types.float64, MATRIX, VECTOR, MATRIX, MATRIX),
}
"""Types of the arguments of all that is called by address."""
_Calls = namedtuple("_Calls", list(SIGNATURES))  # type: ignore[misc]
Calls = Any
"""Record of the addresses of all of them in this process; zero where a filter has no use for it."""
_RECIPE = Recipe()
_STORAGE = empty_storage(_RECIPE, 1, 1)


def _fields_of(record: Any) -> dict[str, Any]:
    kind = numba.typeof(record)
    return dict(zip(kind.fields, kind.types, strict=True))


_RECORDS: Mapping[str, Mapping[str, Any]] = {
    "calls": {name: Address(name) for name in SIGNATURES},
    "plan": _fields_of(_RECIPE.plan),
    "storage": _fields_of(_STORAGE),
    "scratch": _fields_of(scratch(_RECIPE, _STORAGE, 1)),
    "frame": _fields_of(empty_frame(_RECIPE, 1, 1, 1)),
}


@intrinsic
def _call(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call a unit, or what a part has compiled."""
    argument_types, signature_types = tuple(arguments), SIGNATURES[address.callee]
    fits = len(argument_types) == len(signature_types) and all(
        have == want or (isinstance(want, types.Number) and isinstance(have, types.Number | types.Boolean))
        for have, want in zip(map(types.unliteral, argument_types), signature_types, strict=True)
    )
    if not fits:
        raise TypingError(f"{address.callee} must be called with {signature_types}, got {argument_types}")

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        raw = cgutils.unpack_tuple(builder, values[1])
        cast = [context.cast(builder, *one) for one in zip(raw, argument_types, signature_types, strict=True)]
        callee = ir.FunctionType(ir.VoidType(), [value.type for value in cast]).as_pointer()
        builder.call(builder.inttoptr(values[0], callee), cast)
        return context.get_dummy_value()

    return types.void(address, arguments), generate


def _call_plainly(function: Any, arguments: Any) -> None:
    function(*arguments)


@intrinsic
def _exists(typing_context: Any, address: Any) -> Any:
    """Whether the recipe has a use for a unit, or the part the function."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.icmp_unsigned("!=", values[0], ir.IntType(64)(0))

    return types.boolean(address), generate


def _exists_plainly(function: Any) -> bool:
    return bool(function != 0)


call, exists = (_call_plainly, _exists_plainly) if PLAIN else (_call, _exists)


class Unit:
    """A kernel that is compiled when its address is first asked for."""

    def __init__(self, name: str, function: Callable[..., None], **options: Any) -> None:
        self.name, self.function = name, function
        self._options = options or {**KEPT, "_nrt": False}
        self._stamped = stamped(function)  # as its sources are imported now

    @cached_property
    def _compiled(self) -> Any:
        options = {"error_model": "numpy", "fastmath": {"contract"}, **self._options}
        return cfunc(types.void(*SIGNATURES[self.name]), **options)(self._stamped)

    @property
    def address(self) -> Any:
        """Address of its machine code in this process; the function itself where kernels are plain Python."""
        address: Any = self.function if PLAIN else self._compiled.address
        return address


def unit(name: str) -> Callable[[Callable[..., None]], Unit]:
    """Make a kernel the unit of this name."""
    return lambda function: Unit(name, function)


@cache
def of_part(kernels: Any, name: str) -> Any:
    """Address of a function of a part; zero where it has none of that name.

    Raises
    ------
    ValueError
        Numba cannot compile it.
    """
    function = getattr(kernels, name)
    if function is None:
        return 0
    if kernels.in_python:
        _LOADED.append(_in_python(name, function))
        return function if PLAIN else ctypes.cast(_LOADED[-1], ctypes.c_void_p).value
    function = getattr(function, "py_func", function)
    include(function.__module__)
    has_file = getattr(function, "has_source", Path(function.__code__.co_filename).exists())  # else nowhere to keep it
    try:
        compiled = Unit(name, function, **{**KEPT, "cache": KEPT["cache"] and has_file})
        _LOADED.append(compiled)
        return compiled.address
    except Exception as error:  # whatever Numba stumbles over: a function of a stranger's then runs in Python
        reason = " ".join(_COLOUR.sub("", str(error)).split())[:_LONGEST]
        raise ValueError(
            f"{name} {function.__qualname__} must be a function that Numba can compile: {reason}"
        ) from None


_COLOUR, _LONGEST = re.compile(r"\x1b\[\d*m"), 400  # of what Numba says
_LOADED: list[Any] = []
"""Code whose address is known: it must stay."""


# --- functions of a part in Python, called from machine code ---

_AHEAD, _DATA = 5, 4  # words of an array before its shape and its strides, and which of them is its address
_thread = threading.local()


def _in_python(name: str, function: Callable[..., None]) -> Any:
    """Function that is called like machine code, with the numbers of its arrays one by one.

    An exception cannot pass through machine code: it is kept for `raise_failure`, and what is written stays zero.
    """
    kinds = SIGNATURES[name]
    words = [_AHEAD + 2 * kind.ndim if isinstance(kind, types.Array) else 1 for kind in kinds]
    firsts = [sum(words[:k]) for k in range(len(kinds))]

    def called(*given: Any) -> None:
        if getattr(_thread, "failure", None) is not None:
            return
        try:
            function(*(_argument(kind, given[first:]) for kind, first in zip(kinds, firsts, strict=True)))
        except BaseException as error:  # whatever it is, it waits until the kernels have ended
            _thread.failure = error

    c_types = (ctypes.c_int64 if isinstance(kind, types.Array) else ctypes.c_double for kind in kinds)
    return ctypes.CFUNCTYPE(None, *(c for c, n in zip(c_types, words, strict=True) for _ in range(n)))(called)


def _argument(kind: Any, words: tuple[Any, ...]) -> Any:
    """Number or array that the first words stand for."""
    if not isinstance(kind, types.Array):
        return words[0]
    shape, dtype = words[_AHEAD : _AHEAD + kind.ndim], np.bool_ if kind.dtype == types.boolean else np.float64
    if 0 in shape:
        return np.zeros(shape, dtype)
    room: Any = (ctypes.c_char * (math.prod(shape) * np.dtype(dtype).itemsize)).from_address(words[_DATA])
    return np.frombuffer(room, dtype).reshape(shape)


def raise_failure() -> None:
    """Raise what a function in Python has raised in a call of this thread."""
    failure, _thread.failure = getattr(_thread, "failure", None), None
    if failure is not None:
        raise failure


def addresses(**known: Any) -> Calls:
    """Addresses by their names, zero for all others."""
    return _Calls(**{"cholesky": CHOLESKY, **dict.fromkeys(list(SIGNATURES)[1:], 0), **known})


def _reader(kind: Any) -> Any:
    @intrinsic
    def read(typing_context: Any, address: Any) -> Any:
        """The record that `Packed` has written there."""

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return builder.inttoptr(values[0], context.get_value_type(kind))

        return kind(types.intp), generate

    return read


def _itself(value: Any) -> Any:
    return value


read_calls, read_plan, read_storage, read_scratch, read_frame = (
    _itself if PLAIN else _reader(kind) for kind in (CALLS, PLAN, STORAGE, SCRATCH, FRAME)
)


class Packed:
    """A tuple of arrays and numbers that kernels read by its address."""

    def __init__(self, value: Any) -> None:
        self.value = value
        words: list[int] = []
        for field in () if PLAIN else value:
            if isinstance(field, np.ndarray):
                words += [field.ctypes.data, *field.shape, *field.strides]
            else:
                words.append(
                    int(np.array(field, np.float64).view(np.int64)) if isinstance(field, float) else int(field)
                )
        self._words = np.array(words)
        self.address: Any = value if PLAIN else self._words.ctypes.data
