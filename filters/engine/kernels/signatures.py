"""Argument types and compilation options of the kernels."""

from __future__ import annotations

from typing import Any

from numba import types


def read(ndim: int, layout: str = "C", dtype: types.Type = types.float64) -> types.Type:
    """An array that is only read."""
    return types.Array(dtype, ndim, layout, readonly=True)


COVARIANCE = types.Array(types.float64, 2, "F")
VECTOR, MATRIX, MATRICES = read(1), read(2), read(3)
ANY_MATRIX, ANY_MATRICES = read(2, "A"), read(3, "A")
INDEX, ROWS = read(1, dtype=types.int64), read(2, dtype=types.int64)
INTRINSICS = types.UniTuple(types.float64, 5)
SEEN = (INTRINSICS, VECTOR, VECTOR, MATRIX, INDEX, INDEX, types.int64, INDEX)
"""Camera, its pose, blocks, anchor and parameter block of each landmark, width of its rows, landmarks seen."""
MEASURED = (MATRIX, MATRICES, MATRICES, ROWS, ANY_MATRICES)
"""The fields of `kalman.LinearisedMeasurements`."""

FLOATS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
"""IEEE arithmetic, with fused multiply-add."""
FIXED: dict[str, Any] = {"cache": True, **FLOATS}
"""For functions with a signature."""
