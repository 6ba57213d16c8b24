"""Numerical Jacobians: central differences of fourth order."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from filters.geometry.arrays import FloatArray

STEP = 1e-4
"""Where truncation (STEP^4) and rounding (1e-16 / STEP) are both about 1e-12 of a function of size one."""


def jacobian(function: Callable[[FloatArray], FloatArray], size: int) -> FloatArray:
    """d function(delta) / d delta at zero.

    Parameters
    ----------
    function : callable
        (size,) -> (..., k), for as many things at once as it likes.
    size : int
        Numbers of delta.

    Returns
    -------
    (..., k, size) ndarray
        By f' = (8 (f(h) - f(-h)) - (f(2 h) - f(-2 h))) / (12 h).
    """
    steps = STEP * np.eye(size)
    columns = [8.0 * (function(e) - function(-e)) - (function(2.0 * e) - function(-2.0 * e)) for e in steps]
    return np.stack(columns, axis=-1) / (12.0 * STEP)
