"""Dual numbers in machine code: numbers with their exact derivatives by n variables (`filters.geometry.derivatives`).

What a part computes of them is compiled with the part; the derivatives cost what those derived by hand do. Written for
Numba by its interface for extensions alone.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, make_attribute_wrapper, models, overload, register_model

from filters.geometry import derivatives
from filters.geometry.derivatives import Dual
from filters.kernels.blas import PLAIN


class DualType(types.Type):
    """Number with n derivatives."""

    def __init__(self, n: int) -> None:
        self.n = n
        super().__init__(f"Dual{n}")


@register_model(DualType)
class _Model(models.StructModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, [("value", types.float64), ("slope", types.UniTuple(types.float64, kind.n))])


make_attribute_wrapper(DualType, "value", "value")
make_attribute_wrapper(DualType, "slope", "slope")


def _made(context: Any, builder: Any, kind: Any, value: Any, slope: Any) -> Any:
    result = cgutils.create_struct_proxy(kind)(context, builder)
    result.value, result.slope = value, context.make_tuple(builder, types.UniTuple(types.float64, kind.n), slope)
    return result._getvalue()


@intrinsic
def dual(typing_context: Any, value: Any, slope: Any) -> Any:
    """Dual number of a float and a tuple of floats."""
    kind = DualType(len(slope))

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return _made(context, builder, kind, values[0], cgutils.unpack_tuple(builder, values[1]))

    return kind(types.float64, slope), generate


@intrinsic
def scaled(typing_context: Any, a: Any, slope: Any) -> Any:
    """Tuple a * slope; a loop over it would be unrolled by LLVM, which takes longer."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        parts = [builder.fmul(values[0], part) for part in cgutils.unpack_tuple(builder, values[1])]
        return context.make_tuple(builder, signature.return_type, parts)

    return slope(types.float64, slope), generate


@intrinsic
def combined(typing_context: Any, a: Any, slope: Any, b: Any, other: Any) -> Any:
    """Tuple a * slope + b * other."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pairs = zip(*(cgutils.unpack_tuple(builder, values[k]) for k in (1, 3)), strict=True)
        fused = {"flags": ("contract",)}
        parts = [
            builder.fadd(builder.fmul(values[0], p, **fused), builder.fmul(values[2], q, **fused), **fused)
            for p, q in pairs
        ]
        return context.make_tuple(builder, signature.return_type, parts)

    return slope(types.float64, slope, types.float64, other), generate


@intrinsic(prefer_literal=True)
def _variables(typing_context: Any, row: Any, count: Any, first: Any, slopes: Any) -> Any:
    """The first `count` numbers of a row as variables first, first + 1, ... of `slopes`."""
    n, kind = count.literal_value, DualType(slopes.literal_value)
    returned = types.UniTuple(kind, n)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data, result = context.make_array(signature.args[0])(context, builder, values[0]).data, []
        for k in range(n):
            at = [builder.icmp_signed("==", values[2], values[2].type(j - k)) for j in range(kind.n)]
            unit = [builder.select(one, *(context.get_constant(types.float64, x) for x in (1.0, 0.0))) for one in at]
            result.append(_made(context, builder, kind, builder.load(cgutils.gep(builder, data, k)), unit))
        return context.make_tuple(builder, returned, result)

    return returned(row, count, first, slopes), generate


@intrinsic(prefer_literal=True)
def _numbers(typing_context: Any, row: Any, count: Any) -> Any:
    """The first `count` numbers of a row as a tuple."""
    returned = types.UniTuple(types.float64, count.literal_value)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, values[0]).data
        result = [builder.load(cgutils.gep(builder, data, k)) for k in range(returned.count)]
        return context.make_tuple(builder, returned, result)

    return returned(row, count), generate


@intrinsic
def _added(typing_context: Any, numbers: Any, changes: Any) -> Any:
    """Sum of a tuple of floats and one of dual numbers."""
    kind = changes.dtype

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        sums = []
        for number, change in zip(*(cgutils.unpack_tuple(builder, value) for value in values), strict=True):
            parts = cgutils.create_struct_proxy(kind)(context, builder, change)
            slope = cgutils.unpack_tuple(builder, parts.slope)
            sums.append(_made(context, builder, kind, builder.fadd(number, parts.value), slope))
        return context.make_tuple(builder, changes, sums)

    return changes(numbers, changes), generate


@intrinsic
def _write(typing_context: Any, values: Any, J: Any, results: Any) -> Any:
    """Write a tuple of dual and of plain numbers into values (m,) and J (m, n); rows of plain ones stay as they are."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        target = context.make_array(signature.args[0])(context, builder, given[0]).data
        matrix = context.make_array(signature.args[1])(context, builder, given[1])
        below = cgutils.unpack_tuple(builder, matrix.strides)[0]
        for a, kind in enumerate(signature.args[2].types):
            result = builder.extract_value(given[2], a)
            if not isinstance(kind, DualType):
                builder.store(context.cast(builder, result, kind, types.float64), cgutils.gep(builder, target, a))
                continue
            at = builder.add(builder.ptrtoint(matrix.data, below.type), builder.mul(below, below.type(a)))
            row, parts = builder.inttoptr(at, target.type), cgutils.create_struct_proxy(kind)(context, builder, result)
            builder.store(parts.value, cgutils.gep(builder, target, a))
            for j in range(kind.n):
                builder.store(builder.extract_value(parts.slope, j), cgutils.gep(builder, row, j))
        return context.get_dummy_value()

    return types.void(values, J, results), generate


def _variables_plainly(row: Any, count: int, first: int, slopes: int) -> tuple[Dual, ...]:
    return derivatives.variables(row[:count], first, slopes)


def _numbers_plainly(row: Any, count: int) -> tuple[float, ...]:
    return tuple(row[:count])


def _write_plainly(values: Any, J: Any, results: Any) -> None:
    for a, result in enumerate(results):
        if isinstance(result, Dual):
            values[a], J[a] = result.value, result.slope
        else:
            values[a] = result


def _added_plainly(numbers: Any, changes: Any) -> tuple[Any, ...]:
    return tuple(a + b for a, b in zip(numbers, changes, strict=True))


variables, numbers, added, write = (
    (_variables_plainly, _numbers_plainly, _added_plainly, _write_plainly)
    if PLAIN
    else (_variables, _numbers, _added, _write)
)


def _bare(*functions: Any) -> None:
    """Take annotations away: Numba wants those of an overload to be the ones of what it overloads."""
    for function in functions:
        if function is not None:
            function.__annotations__ = {}


def _one(functions: tuple[Any, ...], of_dual: Callable[..., Any]) -> None:
    """Give functions of one number what they are of a dual one."""

    def make(x: Any) -> Any:
        return of_dual if isinstance(x, DualType) else None

    _bare(make, of_dual)
    for function in functions:
        overload(function)(make)


def _two(functions: tuple[Any, ...], of_duals: Any, of_first: Any, of_second: Any) -> None:
    """Give functions of two numbers what they are of two dual ones, and where only one of them is dual."""

    def make(a: Any, b: Any) -> Any:
        if isinstance(a, DualType) and isinstance(b, DualType):
            return of_duals
        if isinstance(a, DualType) and isinstance(b, types.Number):
            return of_first
        if isinstance(b, DualType) and isinstance(a, types.Number):
            return of_second
        return None

    _bare(make, of_duals, of_first, of_second)
    for function in functions:
        overload(function)(make)


def _quotient(a: Any, b: Any) -> Any:
    inverse = 1.0 / b.value
    q = a.value * inverse
    return dual(q, combined(inverse, a.slope, -q * inverse, b.slope))


def _quotient_by_number(a: Any, b: Any) -> Any:
    inverse = 1.0 / b
    return dual(a.value * inverse, scaled(inverse, a.slope))


def _quotient_of_number(a: Any, b: Any) -> Any:
    inverse = 1.0 / b.value
    q = a * inverse
    return dual(q, scaled(-q * inverse, b.slope))


def _root(x: Any) -> Any:
    r = np.sqrt(x.value)
    return dual(r, scaled(0.5 / r if r > 0.0 else 0.0, x.slope))  # at zero that of an even function


def _hypot(a: Any, b: Any) -> Any:
    r = np.hypot(a.value, b.value)
    inverse = 1.0 / r if r > 0.0 else 0.0
    return dual(r, combined(a.value * inverse, a.slope, b.value * inverse, b.slope))


def _hypot_with_number(a: Any, b: Any) -> Any:
    r = np.hypot(a.value, b)
    return dual(r, scaled(a.value / r if r > 0.0 else 0.0, a.slope))


def _hypot_of_number(a: Any, b: Any) -> Any:
    r = np.hypot(a, b.value)
    return dual(r, scaled(b.value / r if r > 0.0 else 0.0, b.slope))


def _arctan2(a: Any, b: Any) -> Any:
    square = a.value * a.value + b.value * b.value
    return dual(np.arctan2(a.value, b.value), combined(b.value / square, a.slope, -a.value / square, b.slope))


def _arctan2_with_number(a: Any, b: Any) -> Any:
    return dual(np.arctan2(a.value, b), scaled(b / (a.value * a.value + b * b), a.slope))


def _arctan2_of_number(a: Any, b: Any) -> Any:
    return dual(np.arctan2(a, b.value), scaled(-a / (a * a + b.value * b.value), b.slope))


def _sinc(x: Any) -> Any:
    s = np.sinc(x.value)
    return dual(s, scaled((np.cos(np.pi * x.value) - s) / x.value if x.value != 0.0 else 0.0, x.slope))


def _tan(x: Any) -> Any:
    t = np.tan(x.value)
    return dual(t, scaled(1.0 + t * t, x.slope))


def _exp(x: Any) -> Any:
    e = np.exp(x.value)
    return dual(e, scaled(e, x.slope))


_two(
    (operator.add,),
    lambda a, b: dual(a.value + b.value, combined(1.0, a.slope, 1.0, b.slope)),
    lambda a, b: dual(a.value + b, a.slope),
    lambda a, b: dual(a + b.value, b.slope),
)
_two(
    (operator.sub,),
    lambda a, b: dual(a.value - b.value, combined(1.0, a.slope, -1.0, b.slope)),
    lambda a, b: dual(a.value - b, a.slope),
    lambda a, b: dual(a - b.value, scaled(-1.0, b.slope)),
)
_two(
    (operator.mul,),
    lambda a, b: dual(a.value * b.value, combined(b.value, a.slope, a.value, b.slope)),
    lambda a, b: dual(a.value * b, scaled(float(b), a.slope)),
    lambda a, b: dual(a * b.value, scaled(float(a), b.slope)),
)
_two((operator.truediv,), _quotient, _quotient_by_number, _quotient_of_number)
_two((np.hypot, math.hypot), _hypot, _hypot_with_number, _hypot_of_number)
_two((np.arctan2, math.atan2), _arctan2, _arctan2_with_number, _arctan2_of_number)
_two((operator.pow,), None, lambda a, b: dual(a.value**b, scaled(b * a.value ** (b - 1.0), a.slope)), None)
_two((operator.gt,), lambda a, b: a.value > b.value, lambda a, b: a.value > b, lambda a, b: a > b.value)
_two((operator.lt,), lambda a, b: a.value < b.value, lambda a, b: a.value < b, lambda a, b: a < b.value)
_two((operator.ge,), lambda a, b: a.value >= b.value, lambda a, b: a.value >= b, lambda a, b: a >= b.value)
_two((operator.le,), lambda a, b: a.value <= b.value, lambda a, b: a.value <= b, lambda a, b: a <= b.value)
_two(
    (np.copysign, math.copysign),
    *(lambda a, b: np.copysign(a.value, b.value), None),
    lambda a, b: np.copysign(a, b.value),
)
_one((operator.neg, np.negative), lambda x: dual(-x.value, scaled(-1.0, x.slope)))
_one((abs, np.abs), lambda x: dual(abs(x.value), scaled(1.0 if x.value >= 0.0 else -1.0, x.slope)))
_one((np.square,), lambda x: dual(x.value * x.value, scaled(2.0 * x.value, x.slope)))
_one((np.sqrt, math.sqrt), _root)
_one((np.sin, math.sin), lambda x: dual(np.sin(x.value), scaled(np.cos(x.value), x.slope)))
_one((np.cos, math.cos), lambda x: dual(np.cos(x.value), scaled(-np.sin(x.value), x.slope)))
_one((np.tan, math.tan), _tan)
_one((np.arctan, math.atan), lambda x: dual(np.arctan(x.value), scaled(1.0 / (1.0 + x.value * x.value), x.slope)))
_one((np.sinc,), _sinc)
_one((np.exp, math.exp), _exp)
_one((np.log, math.log), lambda x: dual(np.log(x.value), scaled(1.0 / x.value, x.slope)))
_one((np.log1p, math.log1p), lambda x: dual(np.log1p(x.value), scaled(1.0 / (1.0 + x.value), x.slope)))
_one((np.expm1, math.expm1), lambda x: dual(np.expm1(x.value), scaled(np.exp(x.value), x.slope)))
_one((np.sinh, math.sinh), lambda x: dual(np.sinh(x.value), scaled(np.cosh(x.value), x.slope)))
_one((np.cosh, math.cosh), lambda x: dual(np.cosh(x.value), scaled(np.sinh(x.value), x.slope)))
_one((np.tanh, math.tanh), lambda x: dual(np.tanh(x.value), scaled(1.0 - np.tanh(x.value) ** 2, x.slope)))
_one(
    (np.arcsin, math.asin),
    lambda x: dual(np.arcsin(x.value), scaled(1.0 / np.sqrt(1.0 - x.value * x.value), x.slope)),
)
_one(
    (np.arccos, math.acos),
    lambda x: dual(np.arccos(x.value), scaled(-1.0 / np.sqrt(1.0 - x.value * x.value), x.slope)),
)
_two(
    (np.minimum,),
    lambda a, b: a if a.value <= b.value else b,
    lambda a, b: a if a.value <= b else dual(float(b), scaled(0.0, a.slope)),
    lambda a, b: dual(float(a), scaled(0.0, b.slope)) if a <= b.value else b,
)
_two(
    (np.maximum,),
    lambda a, b: a if a.value >= b.value else b,
    lambda a, b: a if a.value >= b else dual(float(b), scaled(0.0, a.slope)),
    lambda a, b: dual(float(a), scaled(0.0, b.slope)) if a >= b.value else b,
)
