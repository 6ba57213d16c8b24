"""Derivatives: exact ones by dual numbers, which carry them along, and central differences of fourth order.

A function of tuples of numbers is differentiated by giving it dual numbers. `filters.kernels.duals` has the same in
machine code; here they run on columns, one row for each landmark.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from filters.geometry.arrays import FloatArray


class Dual(NDArrayOperatorsMixin):
    """Number with its derivatives.

    Parameters
    ----------
    value : float or (M,) ndarray
        The number, or one for each row.
    slope : (n,) or (n, M) ndarray
        Derivatives by n variables.
    """

    def __init__(self, value: Any, slope: FloatArray) -> None:
        self.value, self.slope = value, slope

    # Sums and products come most often: these do without the detour over NumPy's dispatch.

    def __add__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    def __sub__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.slope - other.slope)
        return Dual(self.value - other, self.slope)

    def __mul__(self, other: Any) -> Dual:
        if isinstance(other, Dual):
            return Dual(self.value * other.value, other.value * self.slope + self.value * other.slope)
        return Dual(self.value * other, other * self.slope)

    __radd__, __rmul__ = __add__, __mul__

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **named: Any) -> Any:
        """Apply a function of NumPy by the chain rule; comparisons and signs are those of the values."""
        values = [x.value if isinstance(x, Dual) else x for x in inputs]
        if method != "__call__" or named:
            return NotImplemented
        result = ufunc(*values)
        if ufunc in _FLAT:
            return result
        if ufunc not in _PARTIAL:
            return NotImplemented
        partials = _PARTIAL[ufunc](result, *values)
        slopes = [p * x.slope for p, x in zip(partials, inputs, strict=True) if isinstance(x, Dual)]
        return Dual(result, sum(slopes[1:], slopes[0]))

    def __array_function__(self, function: Any, kinds: Any, inputs: Any, named: Any) -> Any:
        """Give `np.sinc`, which is no ufunc; no other function of arrays takes dual numbers."""
        if function is not np.sinc:
            return NotImplemented
        s, x = np.sinc(self.value), np.pi * self.value
        return Dual(
            s, np.pi * np.divide(np.cos(x) - s, x, out=np.zeros_like(s), where=np.asarray(x) != 0.0) * self.slope
        )


def _by_root(result: Any) -> Any:
    """Derivative of a root, at zero that of an even function of what is below it: none."""
    return np.divide(0.5, result, out=np.zeros_like(result, dtype=np.float64), where=np.asarray(result) > 0.0)


def _over(x: Any, result: Any) -> Any:
    return np.divide(x, result, out=np.zeros_like(result, dtype=np.float64), where=np.asarray(result) > 0.0)


_FLAT = {
    np.less,
    np.greater,
    np.less_equal,
    np.greater_equal,
    np.equal,
    np.not_equal,
    np.sign,
    np.copysign,
    np.isfinite,
}
_PARTIAL: Mapping[Any, Callable[..., tuple[Any, ...]]] = {
    np.add: lambda r, a, b: (1.0, 1.0),
    np.subtract: lambda r, a, b: (1.0, -1.0),
    np.multiply: lambda r, a, b: (b, a),
    np.true_divide: lambda r, a, b: (1.0 / b, -r / b),
    np.power: lambda r, a, b: (b * a ** (b - 1.0), 0.0),
    np.negative: lambda r, a: (-1.0,),
    np.positive: lambda r, a: (1.0,),
    np.absolute: lambda r, a: (np.where(a >= 0.0, 1.0, -1.0),),
    np.square: lambda r, a: (2.0 * a,),
    np.sqrt: lambda r, a: (_by_root(r),),
    np.hypot: lambda r, a, b: (_over(a, r), _over(b, r)),
    np.sin: lambda r, a: (np.cos(a),),
    np.cos: lambda r, a: (-np.sin(a),),
    np.tan: lambda r, a: (1.0 + r * r,),
    np.arctan: lambda r, a: (1.0 / (1.0 + a * a),),
    np.arctan2: lambda r, a, b: (b / (a * a + b * b), -a / (a * a + b * b)),
    np.arcsin: lambda r, a: (1.0 / np.sqrt(1.0 - a * a),),
    np.arccos: lambda r, a: (-1.0 / np.sqrt(1.0 - a * a),),
    np.sinh: lambda r, a: (np.cosh(a),),
    np.cosh: lambda r, a: (np.sinh(a),),
    np.tanh: lambda r, a: (1.0 - r * r,),
    np.exp: lambda r, a: (r,),
    np.expm1: lambda r, a: (r + 1.0,),
    np.log: lambda r, a: (1.0 / a,),
    np.log1p: lambda r, a: (1.0 / (1.0 + a),),
    np.minimum: lambda r, a, b: (np.where(a <= b, 1.0, 0.0), np.where(a <= b, 0.0, 1.0)),
    np.maximum: lambda r, a, b: (np.where(a >= b, 1.0, 0.0), np.where(a >= b, 0.0, 1.0)),
}
"""Partial derivatives of the functions that a part may be made of, from the result and the arguments."""


def variables(values: FloatArray, first: int = 0, count: int | None = None) -> tuple[Dual, ...]:
    """Columns of (M, n) values, or the numbers of (n,) ones, as variables first, first + 1, ... of `count`."""
    columns = values.T
    units = np.eye(len(columns), len(columns) if count is None else count, first)
    shaped = units[:, :, None] if columns.ndim > 1 else units
    return tuple(Dual(column, unit) for column, unit in zip(columns, shaped, strict=True))


def columns_of(function: Callable[..., Any], *arrays: FloatArray) -> FloatArray:
    """Results (M, k) of a function of tuples of numbers for each row of its arguments (M, n)."""

    def called(*rows: FloatArray) -> FloatArray:
        shape = np.broadcast_shapes(*(row.shape[:-1] for row in rows))
        return np.stack([np.broadcast_to(one, shape) for one in function(*(tuple(row.T) for row in rows))], axis=-1)

    return _of_rows(called, arrays)


def jacobian_of(function: Callable[..., Any], *arrays: FloatArray, by: int = 0) -> tuple[FloatArray, FloatArray]:
    """Results (M, k) of a function of tuples for each row of its arguments, and their Jacobian (M, k, n) by one."""
    n = arrays[by].shape[1]

    def called(*rows: FloatArray) -> FloatArray:
        shape = np.broadcast_shapes(*(row.shape[:-1] for row in rows))
        results = function(*(variables(row) if k == by else tuple(row.T) for k, row in enumerate(rows)))
        both = np.zeros((*shape, len(results), 1 + n))
        for k, one in enumerate(results):
            both[..., k, 0] = one.value if isinstance(one, Dual) else one
            if isinstance(one, Dual):
                both[..., k, 1:] = one.slope.T
        return both

    both = _of_rows(called, arrays)
    return both[..., 0], both[..., 1:]


def _of_rows(called: Callable[..., FloatArray], arrays: tuple[FloatArray, ...]) -> FloatArray:
    """A function of all rows at once, or of one after the other where it branches on its numbers."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        try:
            return called(*arrays)
        except (TypeError, ValueError):
            count = max(map(len, arrays))
            if count == 0:  # its shape is that of any row
                return np.zeros((0, *called(*(np.ones(array.shape[1]) for array in arrays)).shape))
            full_arrays = (np.broadcast_to(array, (count, array.shape[1])) for array in arrays)
            return np.stack([called(*rows) for rows in zip(*full_arrays, strict=True)])


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
