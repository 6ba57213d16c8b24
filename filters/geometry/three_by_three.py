"""3x3 matrices as nine numbers, row by row, for kernels."""

from __future__ import annotations

from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import compiled
from filters.geometry.rotations import Nine, Three

IDENTITY: Nine = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@compiled
def multiply(a: Nine, b: Nine) -> Nine:
    """Product of two matrices."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
        a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
        a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
        a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
        a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )


@compiled
def transposed(a: Nine) -> Nine:
    """Transpose of a matrix."""
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


@compiled
def times(a: Nine, x: float, y: float, z: float) -> Three:
    """Product with a vector."""
    return a[0] * x + a[1] * y + a[2] * z, a[3] * x + a[4] * y + a[5] * z, a[6] * x + a[7] * y + a[8] * z


@compiled
def cross_matrix(x: float, y: float, z: float) -> Nine:
    """[a]x, so that [a]x b = a x b."""
    return 0.0, -z, y, z, 0.0, -x, -y, x, 0.0


@compiled
def put(target: FloatArray, row: int, column: int, nine: Nine, scale: float) -> None:
    """target[row:, column:] (3, 3) = scale times a matrix."""
    for i, number in enumerate(nine):
        target[row + i // 3, column + i % 3] = scale * number
