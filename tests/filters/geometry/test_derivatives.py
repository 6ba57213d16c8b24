"""Dual numbers: exact derivatives, the same in NumPy on columns, row by row, and in machine code."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numba import config

from filters.geometry.derivatives import Dual, columns_of, jacobian, jacobian_of
from filters.kernels.blas import entry
from filters.kernels.duals import variables, write

X = np.array([[0.3, 1.7], [0.9, 0.4], [2.5, 3.0]])


def arithmetic(x: Any) -> Any:
    a, b = x
    return a + b, a - 2.0, 3.0 - b, a * b, 2.0 * a, a / b, 1.0 / a, b / 4.0, -a, abs(-b), a**3.0


def functions(x: Any) -> Any:
    a, b = x
    return (
        *(np.sin(a), np.cos(a), np.tan(a), np.sqrt(a), np.exp(a), np.log(a), np.square(b), np.arctan(b), np.sinc(b)),
        *(np.hypot(a, b), np.hypot(a, 2.0), np.hypot(2.0, b)),
        *(np.arctan2(a, b), np.arctan2(a, -2.0), np.arctan2(2.0, b)),
        *(np.arcsin(0.3 * a), np.arccos(0.3 * a), np.sinh(b), np.cosh(b), np.tanh(a), np.expm1(a), np.log1p(b)),
        *(np.minimum(a, b), np.minimum(a, 1.0), np.minimum(1.0, b)),
        *(np.maximum(a, b), np.maximum(a, 1.0), np.maximum(1.0, b)),
        *(np.copysign(2.0, -a) * b, 5.0),
    )


def branching(x: Any) -> Any:
    """Of another form on each side of a line."""
    a, b = x
    if a < b:
        return a * b, b
    return a / b, a


CASES = pytest.mark.parametrize("function", [arithmetic, functions, branching], ids=lambda function: function.__name__)


@CASES
def test_jacobians_are_those_of_differences(function: Any) -> None:
    values, J = jacobian_of(function, X)
    np.testing.assert_array_equal(values, columns_of(function, X))
    for row, exact in zip(X, J, strict=True):
        by_differences = jacobian(lambda e, at=row: np.array(function(tuple(at + e)), dtype=float), 2)
        np.testing.assert_allclose(exact, by_differences, rtol=1e-9, atol=1e-9)


@CASES
@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_machine_code_says_what_numpy_says(function: Any) -> None:
    from filters.kernels.blas import kernel

    compiled, (values, J) = kernel(function), jacobian_of(function, X)

    @entry
    def all_rows(rows: Any, values: Any, J: Any) -> None:
        for i in range(len(rows)):
            write(values[i], J[i], compiled(variables(rows[i], 2, 0, 2)))

    written = np.zeros_like(values), np.zeros_like(J)
    all_rows(X, *written)
    np.testing.assert_allclose(written[0], values, rtol=1e-15)
    np.testing.assert_allclose(written[1], J, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("function", [np.sqrt, lambda x: np.hypot(x, 0.0 * x), lambda x: np.sinc(x / np.pi)])
def test_at_zero_it_is_that_of_an_even_function(function: Any) -> None:
    """As lengths of rotation vectors are: not the quotient of zeros."""
    assert function(Dual(0.0, np.ones(1))).slope.tolist() == [0.0]


def test_what_has_no_derivative_is_an_error() -> None:
    with pytest.raises(TypeError):
        np.floor(Dual(1.5, np.ones(1)))
    with pytest.raises(TypeError):
        math.sin(Dual(1.5, np.ones(1)))  # type: ignore[arg-type]


def test_one_row_holds_for_all() -> None:
    """A rotation vector, or the value of a variable, is one for all landmarks."""
    values, J = jacobian_of(lambda t, x: (t[0] * x[0], x[1] + t[1]), np.array([[2.0, 3.0]]), X)
    np.testing.assert_array_equal(values, np.column_stack([2.0 * X[:, 0], X[:, 1] + 3.0]))
    np.testing.assert_array_equal(J[:, 0], np.column_stack([X[:, 0], np.zeros(3)]))
    np.testing.assert_array_equal(J[:, 1], np.tile([0.0, 1.0], (3, 1)))
