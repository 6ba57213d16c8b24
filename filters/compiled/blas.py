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
