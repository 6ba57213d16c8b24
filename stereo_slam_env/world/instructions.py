"""Machine instructions that Numba has no name for, and the same in Python where nothing is compiled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic
from numpy.typing import NDArray


def _or_plainly(plain: Callable[..., Any]) -> Callable[[Callable[..., Any]], Any]:
    """Decorator of an intrinsic: with `NUMBA_DISABLE_JIT=1` it is a Python function instead."""
    return lambda machine_code: plain if config.DISABLE_JIT else intrinsic(machine_code)


def _fma_plainly(a: float, b: float, c: float) -> float:
    return float(Fraction(a) * Fraction(b) + Fraction(c))


@_or_plainly(_fma_plainly)
def fma(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """a * b + c, rounded once, as BLAS does it: a point just at a limit is on the same side on every machine."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fma(*values)

    return types.float64(types.float64, types.float64, types.float64), generate


def _lowest_bit_plainly(bits: int) -> int:
    return int(bits & -bits).bit_length() - 1


@_or_plainly(_lowest_bit_plainly)
def lowest_bit(typing_context: Any, bits: Any) -> tuple[Any, Any]:
    """Number of the lowest bit that is set."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.cttz(values[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), generate


def _entered_boxes_plainly(
    bounds: NDArray[np.float32], node: int, starts: Sequence[np.float32], inverses: Sequence[np.float32]
) -> int:
    at, inverse = (np.reshape(numbers, (2, 3, 1)) for numbers in (starts, inverses))
    with np.errstate(over="ignore"):  # as the instructions: infinitely far
        low, high = ((bounds[node, first : first + 3] - at) * inverse for first in (0, 3))
    enters, leaves = np.minimum(low, high).max(axis=1, initial=0.0), np.maximum(low, high).min(axis=1, initial=1.0)
    return sum(1 << int(k) for k in np.flatnonzero(enters <= leaves))


@_or_plainly(_entered_boxes_plainly)
def entered_boxes(typing_context: Any, bounds: Any, node: Any, starts: Any, inverses: Any) -> tuple[Any, Any]:
    """Branches of the eight of a node that two rays enter, as 16 bits: one vector operation a line.

    `starts` and `inverses`, of the ways, are (x, y, z) of the first ray and then of the second, in single precision.
    """
    eight, sixteen = ir.VectorType(ir.FloatType(), 8), ir.VectorType(ir.FloatType(), 16)
    index = ir.IntType(32)

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, values[0])
        rows = builder.bitcast(array.data, eight.as_pointer())
        first = builder.mul(values[1], ir.Constant(values[1].type, 6))
        twice = ir.Constant(ir.VectorType(index, 16), [*range(8), *range(8)])

        def side(k: int) -> Any:
            row = builder.load(builder.gep(rows, [builder.add(first, ir.Constant(values[1].type, k))]), align=4)
            return builder.shuffle_vector(row, row, twice)

        def of_both(numbers: Any, k: int) -> Any:
            pair = ir.Constant(sixteen, ir.Undefined)
            for ray in range(2):
                number = builder.extract_value(numbers, 3 * ray + k)
                pair = builder.insert_element(pair, number, ir.Constant(index, 8 * ray))
            spread = ir.Constant(ir.VectorType(index, 16), [0] * 8 + [8] * 8)
            return builder.shuffle_vector(pair, pair, spread)

        def lesser(a: Any, b: Any) -> Any:
            return builder.select(builder.fcmp_ordered("<", a, b), a, b)

        def greater(a: Any, b: Any) -> Any:
            return builder.select(builder.fcmp_ordered(">", a, b), a, b)

        enters, leaves = (ir.Constant(sixteen, [end] * 16) for end in (0.0, 1.0))
        for k in range(3):
            at, inverse = of_both(values[2], k), of_both(values[3], k)
            low = builder.fmul(builder.fsub(side(k), at), inverse)
            high = builder.fmul(builder.fsub(side(3 + k), at), inverse)
            enters, leaves = greater(enters, lesser(low, high)), lesser(leaves, greater(low, high))
        hits = builder.fcmp_ordered("<=", enters, leaves)
        return builder.zext(builder.bitcast(hits, ir.IntType(16)), ir.IntType(64))

    return types.int64(bounds, types.int64, starts, inverses), generate
