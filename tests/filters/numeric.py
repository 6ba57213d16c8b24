"""Numerical differentiation, to hold analytic Jacobians against."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Fourth-order central difference: f'(0) from f at -2h, -h, h, 2h.
_NODES = np.array([-2.0, -1.0, 1.0, 2.0])
_WEIGHTS = np.array([1.0, -8.0, 8.0, -1.0]) / 12.0


def numeric_jacobian(function: Callable[[np.ndarray], np.ndarray], size: int, step: float = 1e-5) -> np.ndarray:
    """Jacobian at 0 of `function`, which takes `size` numbers; output shape (..., size)."""
    columns = []
    here = function(np.zeros(size))
    for direction in np.eye(size):
        values = [function(node * step * direction) - here for node in _NODES]
        columns.append(np.tensordot(_WEIGHTS, np.stack(values), axes=1) / step)
    return np.stack(columns, axis=-1)


def relative_difference(actual: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference in units of the largest entry of its row, or of 1e-3 of the largest of all.

    Rows are outputs of different units, so each is measured by its own size; the floor keeps a row that is zero
    by construction from being measured by rounding.
    """
    size = np.abs(expected).max(axis=-1, keepdims=True)
    return float((np.abs(actual - expected) / np.maximum(size, 1e-3 * size.max() + 1e-12)).max())
