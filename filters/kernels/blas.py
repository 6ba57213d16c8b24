"""Linear algebra of the kernels: LAPACK's Cholesky factor, small products and rank-k updates as vector instructions.

BLAS spends more on its calls than on the work at these sizes.
With `NUMBA_DISABLE_JIT=1` all kernels run as plain Python, and what is written in machine instructions here by NumPy.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba import config, types
from numba.core import cgutils
from numba.extending import get_cython_function_address, intrinsic

from filters.geometry.machine_code import compile_with
from filters.kernels import compilation

PLAIN = bool(config.DISABLE_JIT)
"""Whether kernels are Python functions: their addresses are the functions themselves."""
CHOLESKY = get_cython_function_address("scipy.linalg.cython_lapack", "dpotrf")
"""Address of LAPACK's Cholesky factorisation in this process: an argument, so that kernels can be kept on disk."""
entry = partial(compilation.entry, fastmath={"contract"})
"""Decorator of functions that Python calls: IEEE arithmetic with fused multiply-add, without Python's lock."""
kernel = partial(compilation.kernel, fastmath={"contract"}, _nrt=False)
"""Decorator of functions that only kernels call; they count no references."""
compile_with(kernel)


@kernel(inline="always")
def at(array: Any) -> int:
    """Address of an array's first number."""
    address: int = np.intp(array.ctypes.data)  # type: ignore[assignment]
    return address


@intrinsic
def call_fortran(typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call the Fortran subroutine at `address` with pointers to its arguments."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointers = cgutils.unpack_tuple(builder, values[1])
        routine = ir.FunctionType(ir.VoidType(), [pointer.type for pointer in pointers]).as_pointer()
        builder.call(builder.inttoptr(values[0], routine), pointers)
        return context.get_dummy_value()

    return types.void(address, arguments), generate


LANES = 8  # columns of a vector
WIDE = not PLAIN and bool(get_host_cpu_features().get("avx512f"))
"""Whether there are 32 registers of eight numbers: units multiply and add eight sums or more at a time then."""
VECTORS = 2 if WIDE else 1
PANEL = 4  # rows of a triangular solution at a time
TALL = 8 if WIDE else 6  # rows of a large square at a time: 16 registers hold twelve sums, two vectors and a factor


def _panel(rows: int, sign: int = 0) -> Any:
    """Kernel of so many rows of a small product, as vector instructions; with a sign: of target += sign H^T source.

    Each number is one sum in the order of its terms, so that the bits do not depend on how many are summed at a time.
    """
    wide = ir.VectorType(ir.DoubleType(), LANES)

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
            integer, real = under.type, ir.DoubleType()
            eight, zero = ir.Constant(integer, 8), ir.Constant(wide, [0.0] * LANES)
            nothing, all_first = ir.Constant(wide, ir.Undefined), ir.VectorType(ir.IntType(32), LANES)
            sums = [cgutils.alloca_once_value(builder, zero) for _ in range(rows * VECTORS)]

            def entry(base: Any, row: Any, stride: Any, column: Any, kind: Any) -> Any:
                place = builder.add(builder.mul(row, stride), column)
                return builder.inttoptr(builder.add(base, builder.mul(place, eight)), kind.as_pointer())

            def tile(first: Any, vectors: int) -> None:
                """All rows of so many vectors of columns."""
                places = [builder.add(first, ir.Constant(integer, LANES * v)) for v in range(vectors)]
                used = [[sums[row * VECTORS + v] for v in range(vectors)] for row in range(rows)]
                for of_row in used:
                    for total in of_row:
                        builder.store(zero, total)
                with cgutils.for_range(builder, inner) as term:
                    loaded = [
                        builder.load(entry(right, term.index, under_right, place, wide), align=8) for place in places
                    ]
                    for row, of_row in enumerate(used):
                        place = ir.Constant(integer, row), term.index
                        one, other = reversed(place) if sign else place
                        factor = builder.load(entry(left, one, under_left, other, real))
                        spread = builder.insert_element(nothing, factor, ir.IntType(32)(0))
                        spread = builder.shuffle_vector(spread, nothing, ir.Constant(all_first, [0] * LANES))
                        for vector, total in zip(loaded, of_row, strict=True):
                            product = builder.fmul(spread, vector, flags=("contract",))
                            builder.store(builder.fadd(builder.load(total), product, flags=("contract",)), total)
                for row, of_row in enumerate(used):
                    for place, total in zip(places, of_row, strict=True):
                        result = entry(goal, ir.Constant(integer, row), under, place, wide)
                        value = builder.load(total)
                        if sign:
                            combine = builder.fadd if sign > 0 else builder.fsub
                            value = combine(builder.load(result, align=8), value)
                        builder.store(value, result, align=8)

            at_once = ir.Constant(integer, LANES * VECTORS)
            tiles = builder.udiv(count, at_once)
            with cgutils.for_range(builder, tiles) as block:
                tile(builder.mul(block.index, at_once), VECTORS)
            done = builder.mul(tiles, at_once)  # nothing is read or written beyond whole vectors
            rest = builder.add(builder.sub(count, done), ir.Constant(integer, LANES - 1))
            with cgutils.for_range(builder, builder.udiv(rest, ir.Constant(integer, LANES))) as block:
                tile(builder.add(done, builder.mul(block.index, ir.Constant(integer, LANES))), 1)
            return context.get_dummy_value()

        return types.void(*[types.intp] * 8), generate

    return panel


_one_row, _two_rows, _three_rows, _four_rows = (_panel(rows) for rows in (1, 2, 3, 4))
_less_product = _panel(PANEL, -1)
_less_square, _more_square = _panel(TALL, -1), _panel(TALL, 1)


@kernel
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


@kernel
def solve_triangular(S: Any, HP: Any, rows: int, columns: int) -> None:
    """HP <- L^-1 HP, with the factor L^T in the upper triangle of S; `rows` rows, columns rounded up to vectors."""
    for top in range(0, rows, PANEL):
        _less_product(
            at(HP) + 8 * top * HP.shape[1], HP.shape[1], at(S) + 8 * top, S.shape[1], at(HP), HP.shape[1], top, columns
        )
        for i in range(top, min(top + PANEL, rows)):
            row = HP[i]
            for k in range(top, i):
                factor, solved = S[k, i], HP[k]
                for j in range(columns):
                    row[j] -= factor * solved[j]
            inverse = 1.0 / S[i, i]
            for j in range(columns):
                row[j] *= inverse


def _change_by_square(product: Any) -> Any:
    """Kernel that changes the upper triangle of the first n rows of P by HP^T HP."""

    @kernel
    def change(P: Any, HP: Any, rows: int, n: int) -> None:
        for top in range(0, n, TALL):
            left = top - top % LANES
            product(
                at(P) + 8 * (top * P.shape[1] + left),
                P.shape[1],
                at(HP) + 8 * top,
                HP.shape[1],
                at(HP) + 8 * left,
                HP.shape[1],
                rows,
                n - left,
            )

    return change


subtract_square, add_square = _change_by_square(_less_square), _change_by_square(_more_square)
"""P -= HP^T HP and P += HP^T HP: below the triangle, and in the padding behind row and column n, they write, too."""


@kernel
def cholesky(routine: Any, S: Any, rows: int, letters: Any, sizes: Any) -> bool:
    """Cholesky factor of the first rows of S, its transpose in the upper triangle; whether LAPACK found one."""
    first = at(sizes)
    sizes[0], sizes[1], sizes[2] = rows, S.shape[1], 0
    call_fortran(routine, (at(letters), first, at(S), first + 4, first + 8))
    return sizes[2] == 0


if PLAIN:

    def multiply_panel(
        target: Any, first: int, H: Any, rows: int, source: Any, top: int, left: int, depth: int, columns: int
    ) -> None:
        """The same by NumPy."""
        right = source[top : top + depth, left : left + columns]
        target[:rows, first : first + columns] = H[:rows, :depth] @ right

    def solve_triangular(S: Any, HP: Any, rows: int, columns: int) -> None:
        """The same by NumPy."""
        HP[:rows, :columns] = np.linalg.solve(np.triu(S[:rows, :rows]).T, HP[:rows, :columns])

    def subtract_square(P: Any, HP: Any, rows: int, n: int) -> None:
        """P -= HP^T HP by NumPy."""
        P[:n, :n] -= HP[:rows, :n].T @ HP[:rows, :n]

    def add_square(P: Any, HP: Any, rows: int, n: int) -> None:
        """P += HP^T HP by NumPy."""
        P[:n, :n] += HP[:rows, :n].T @ HP[:rows, :n]

    def cholesky(routine: Any, S: Any, rows: int, letters: Any, sizes: Any) -> bool:
        """The same by NumPy."""
        try:
            S[:rows, :rows] = np.linalg.cholesky(np.triu(S[:rows, :rows]).T + np.triu(S[:rows, :rows], 1)).T
        except np.linalg.LinAlgError:
            return False
        return True
