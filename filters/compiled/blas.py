"""BLAS and LAPACK functions of scipy for Numba code, and the compilation options of all kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import get_cython_function_address, intrinsic

ROUTINES = (
    get_cython_function_address("scipy.linalg.cython_lapack", "dpotrf"),
    get_cython_function_address("scipy.linalg.cython_blas", "dtrsm"),
    get_cython_function_address("scipy.linalg.cython_blas", "dgemv"),
    get_cython_function_address("scipy.linalg.cython_blas", "dsyrk"),
)
"""Where this process has them: arguments of the kernels, so that these can be cached on disk."""
ENTRY: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}
"""IEEE arithmetic with fused multiply-add, without Python's lock."""
UNIT: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "_nrt": False}
"""For units."""
KERNEL: dict[str, Any] = {**ENTRY, "_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""For functions that only kernels call: no counting of references, no way in from Python."""


@intrinsic
def call(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call the Fortran subroutine at `address` with pointers to its arguments."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointers = cgutils.unpack_tuple(builder, values[1])
        routine = ir.FunctionType(ir.VoidType(), [pointer.type for pointer in pointers]).as_pointer()
        builder.call(builder.inttoptr(values[0], routine), pointers)
        return context.get_dummy_value()

    return types.void(address, arguments), generate


@njit(inline="always", **KERNEL)
def at(array: Any) -> int:
    """Address of an array's first number."""
    address: int = np.intp(array.ctypes.data)  # type: ignore[assignment]
    return address


LANES = 8  # columns at a time
WIDE = ir.VectorType(ir.DoubleType(), LANES)


def _panel(rows: int) -> Any:
    """Kernel of so many rows of a small product, as vector instructions: see `multiply_panel`."""

    @intrinsic
    def panel(
        typing_context: Any,
        target: Any,
        below: Any,
        H: Any,
        below_H: Any,
        source: Any,
        below_source: Any,
        depth: Any,
        columns: Any,
    ) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            goal, under, left, under_left, right, under_right, inner, count = values
            integer, real, wide = under.type, ir.DoubleType().as_pointer(), WIDE.as_pointer()
            eight, zero = ir.Constant(integer, 8), ir.Constant(WIDE, [0.0] * LANES)

            def entry(base: Any, row: Any, stride: Any, column: Any, kind: Any) -> Any:
                place = builder.add(builder.mul(row, stride), column)
                return builder.inttoptr(builder.add(base, builder.mul(place, eight)), kind)

            sums = [cgutils.alloca_once_value(builder, zero) for _ in range(rows)]
            blocks = builder.udiv(builder.add(count, ir.Constant(integer, LANES - 1)), ir.Constant(integer, LANES))
            with cgutils.for_range(builder, blocks) as block:
                column = builder.mul(block.index, ir.Constant(integer, LANES))
                for total in sums:
                    builder.store(zero, total)
                with cgutils.for_range(builder, inner) as term:
                    vector = builder.load(entry(right, term.index, under_right, column, wide), align=8)
                    for row, total in enumerate(sums):
                        factor = builder.load(entry(left, ir.Constant(integer, row), under_left, term.index, real))
                        spread = builder.insert_element(ir.Constant(WIDE, ir.Undefined), factor, ir.IntType(32)(0))
                        spread = builder.shuffle_vector(
                            spread,
                            ir.Constant(WIDE, ir.Undefined),
                            ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES),
                        )
                        product = builder.fmul(spread, vector, flags=("contract",))
                        builder.store(builder.fadd(builder.load(total), product, flags=("contract",)), total)
                for row, total in enumerate(sums):
                    place = entry(goal, ir.Constant(integer, row), under, column, wide)
                    builder.store(builder.load(total), place, align=8)
            return context.get_dummy_value()

        return types.void(*[types.intp] * 8), generate

    return panel


_one_row, _two_rows, _three_rows, _four_rows = (_panel(rows) for rows in (1, 2, 3, 4))


@njit(**KERNEL)
def multiply_panel(
    target: Any, first: int, H: Any, rows: int, source: Any, top: int, left: int, depth: int, columns: int
) -> None:
    """target[:rows, first:] = H[:rows, :depth] source[top:, left:] on these columns, rounded up to whole vectors.

    Loops over many sources at once are more than the compiler vectorises by itself. All three are row-major, and have
    room to the right.
    """
    below, below_H, below_source = target.shape[1], H.shape[1], source.shape[1]
    goal, start, origin = at(target) + 8 * first, at(H), at(source) + 8 * (top * below_source + left)
    if rows == 3:
        _three_rows(goal, below, start, below_H, origin, below_source, depth, columns)
    elif rows == 2:
        _two_rows(goal, below, start, below_H, origin, below_source, depth, columns)
    elif rows == 4:
        _four_rows(goal, below, start, below_H, origin, below_source, depth, columns)
    else:
        _one_row(goal, below, start, below_H, origin, below_source, depth, columns)
