"""Functions that are Python where Python calls them, and machine code where a kernel does.

Numba is imported when a kernel is compiled, not before: it takes longer than all the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, update_wrapper
from typing import Any, TypeVar, cast

import numpy as np

from filters.geometry.arrays import FloatArray

_Function = TypeVar("_Function", bound=Callable[..., Any])
_compilers: list[Callable[[Callable[..., Any]], Any]] = []


def compile_with(compiler: Callable[[Callable[..., Any]], Any]) -> None:
    """Say what makes machine code of the functions that are `compiled`: the engine does, when it is imported."""
    _compilers.append(compiler)


def settings_of(part: Any, kernels: Any) -> FloatArray:
    """First argument of the kernels of a part: the numbers of the attributes that they name."""
    numbers = [np.ravel(getattr(part, name)) for name in kernels.settings]
    return np.concatenate([np.zeros(0), *numbers]).astype(np.float64)


class Compiled:
    """Function that is Python where Python calls it, and machine code where a kernel does."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.py_func = function
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        """Run it in Python."""
        return self.py_func(*arguments)

    def __reduce__(self) -> Any:
        """Its name: it is one of a module."""
        return self.py_func.__qualname__

    @cached_property
    def _dispatcher(self) -> Any:
        return _compilers[-1](self.py_func)

    @property
    def _numba_type_(self) -> Any:
        """Type that Numba takes it for where a kernel names it."""
        return self._dispatcher._numba_type_


def compiled(function: _Function) -> _Function:
    """Mark a function of numbers and arrays as one that kernels may call."""
    return cast("_Function", Compiled(function))
