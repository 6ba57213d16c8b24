"""Products, solutions and squares on arrays that end where memory does: one number further ends the process.

Run by `test_tiles.py`, in a process of its own.
"""

from __future__ import annotations

import ctypes
import mmap
import sys

import numpy as np
from numba import njit

from filters.kernels import blas
from filters.kernels.records import padded

LANES = 8
_libc = ctypes.CDLL(None, use_errno=True)
_kept: list[mmap.mmap] = []


@njit
def multiply(target, H, few, source, depth, columns):
    """Kernels are only there for other kernels."""
    blas.multiply_panel(target, 0, H, few, source, 0, 0, depth, columns)


@njit
def solve(S, HP, rows, columns):
    """The same."""
    blas.solve_triangular(S, HP, rows, columns)


@njit
def change(P, HP, rows, n, more):
    """The same."""
    if more:
        blas.add_square(P, HP, rows, n)
    else:
        blas.subtract_square(P, HP, rows, n)


def up(columns: int) -> int:
    """Whole vectors."""
    return -(-columns // LANES) * LANES


def guarded(values: np.ndarray) -> np.ndarray:
    """A copy that ends at a page which nobody may touch."""
    size = -(-values.nbytes // mmap.PAGESIZE) * mmap.PAGESIZE
    memory = mmap.mmap(-1, size + mmap.PAGESIZE)
    _kept.append(memory)
    first = ctypes.addressof(ctypes.c_char.from_buffer(memory))
    if _libc.mprotect(ctypes.c_void_p(first + size), ctypes.c_size_t(mmap.PAGESIZE), 0):
        raise OSError(ctypes.get_errno(), "mprotect")
    room = np.frombuffer(memory, np.float64, values.size, size - values.nbytes).reshape(values.shape)
    room[:] = values
    return room


def check(n: int, rows: int, rng: np.random.Generator) -> None:
    """All four at n columns and so many rows, against NumPy, in no more room than whole vectors, squares in a P's."""
    width, room = up(n), padded(n)
    HP, wide, P = (rng.standard_normal(shape) for shape in ((rows, width), (rows, room), (room, room)))
    upper = np.triu_indices(n)
    for sign in (-1.0, 1.0):
        changed = guarded(P)
        change(changed, guarded(wide), rows, n, sign > 0.0)
        expected = P[:n, :n] + sign * wide[:, :n].T @ wide[:, :n]
        np.testing.assert_allclose(changed[:n, :n][upper], expected[upper], rtol=1e-12, atol=1e-12)
    for few in range(1, 5):
        H, target = rng.standard_normal((few, rows)), guarded(np.zeros((few, width)))
        multiply(target, guarded(H), few, guarded(HP), rows, n)
        np.testing.assert_allclose(target[:, :n], H @ HP[:, :n], rtol=1e-12, atol=1e-12)
    whole = -(-rows // 4) * 4  # four rows at a time
    S, solved = np.zeros((whole, whole)), np.zeros((whole, width))
    S[:rows, :rows] = np.linalg.cholesky(np.eye(rows) * rows + np.ones((rows, rows))).T
    solved[:rows] = HP
    S, solved = guarded(S), guarded(solved)
    solve(S, solved, rows, n)
    np.testing.assert_allclose(solved[:rows, :n], np.linalg.solve(S[:rows, :rows].T, HP[:, :n]), rtol=1e-10, atol=1e-12)


if __name__ == "__main__":
    if sys.argv[1:] == ["short"]:  # nine columns and no padding: the guard must end this
        multiply(guarded(np.zeros((1, 9))), np.ones((1, 1)), 1, guarded(np.ones((1, 9))), 1, 9)
    generator = np.random.default_rng(0)
    for columns in (*range(1, 41), 63, 64, 65):
        for depth in (1, 2, 3, 4, 5, 9, 36):
            check(columns, depth, generator)
    print("no number beyond the padding")
