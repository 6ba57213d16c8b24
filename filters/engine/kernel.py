"""Machine code for functions of a filter's own."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel(function: _Function) -> _Function:
    """Compile a function of numbers and arrays by Numba, when it is first called, and keep the code on disk.

    What Numba's `njit` does, but for the long import of Numba before it is needed, and kept anew where any source that
    the function reaches has changed. With `NUMBA_DISABLE_JIT=1` it stays Python.
    """

    @cache
    def machine_code() -> Any:
        from filters.kernels.blas import entry
        from filters.kernels.compilation import include

        include(function.__module__)
        return entry(function)

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return machine_code()(*arguments)

    return cast("_Function", call)
