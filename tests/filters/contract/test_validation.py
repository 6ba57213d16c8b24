"""Checks of arguments: one line that names the argument, the value and the remedy."""

from __future__ import annotations

import numpy as np
import pytest

from filters.contract import validation
from filters.contract.inputs import StereoObservation


def test_finite_array_gives_a_read_only_float_copy() -> None:
    given = np.arange(3)
    array = validation.finite_array("x", given, (3,))
    assert array.dtype == np.float64
    assert not array.flags.writeable
    assert not np.shares_memory(array, given)


def test_a_free_length_takes_any_length() -> None:
    for length in (0, 1, 5):
        assert validation.finite_array("x", np.zeros((length, 3)), ("M", 3)).shape == (length, 3)


@pytest.mark.parametrize("value", [None, "a", [[1, 2], [3]], object()])
def test_what_is_not_numeric_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match=r"x must (be numeric|have shape|be finite)"):
        validation.finite_array("x", value, (3,))


@pytest.mark.parametrize("value", [0, -1, np.nan, np.inf, None, "a", [1, 2]])
def test_positive_refuses_the_rest(value: object) -> None:
    with pytest.raises(ValueError, match="x must be a"):
        validation.positive("x", value)


def test_positive_may_allow_zero() -> None:
    assert validation.positive("x", 0, allow_zero=True) == 0.0
    with pytest.raises(ValueError, match="x must be a finite number >= 0"):
        validation.positive("x", -1e-300, allow_zero=True)


def test_semi_definite_up_to_rounding() -> None:
    """A covariance that another filter made may be singular, and off by rounding."""
    root = np.random.default_rng(0).standard_normal((12, 3))
    P = root @ root.T
    validation.covariance_matrix("P", P, 12)
    with pytest.raises(ValueError, match=r"P must be positive semi-definite, smallest eigenvalue is -0.00"):
        validation.covariance_matrix("P", P - 0.001 * np.eye(12), 12)


def test_an_indefinite_matrix_does_not_hide_beside_a_large_one() -> None:
    batch = np.stack([1e14 * np.eye(3), np.diag([1.0, 1.0, -1e-3])])
    with pytest.raises(ValueError, match="R must be positive definite"):
        validation.covariance_matrix("R", batch, 3, batch=2, definite=True)


def test_an_asymmetric_matrix_does_not_hide_beside_a_large_one() -> None:
    batch = np.stack([1e14 * np.eye(3), np.eye(3) + 0.5 * np.eye(3, k=1)])
    with pytest.raises(ValueError, match="R must be symmetric"):
        validation.covariance_matrix("R", batch, 3, batch=2, definite=True)


@pytest.mark.parametrize("norm", [1 - 9e-4, 1.0, 1 + 9e-4])
def test_a_nearly_unit_quaternion_is_normalised(norm: float) -> None:
    quaternion = validation.unit_quaternion("q", norm * np.array([0.5, 0.5, 0.5, 0.5]))
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("value", [[0, 0, 0, 0], [0, 0, 0, 1.01], [0, 0, 1], [np.nan, 0, 0, 1]])
def test_what_is_no_unit_quaternion_is_refused(value: list[float]) -> None:
    with pytest.raises(ValueError, match="q must"):
        validation.unit_quaternion("q", value)


@pytest.mark.parametrize("dtype", [np.int8, np.int32, np.uint16, np.int64])
def test_ids_of_any_integer_type_become_int64(dtype: type) -> None:
    assert validation.unique_ids("ids", np.array([3, 1, 2], dtype=dtype)).dtype == np.int64


@pytest.mark.parametrize("value", [[1, 1], [1.0, 2.0], [True, False], ["1"], 5, [[1]]])
def test_what_are_no_ids_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match="ids must"):
        validation.unique_ids("ids", value)


def test_an_unchecked_observation_equals_a_checked_one_and_its_arrays_cannot_be_changed() -> None:
    ids, uvd = np.arange(2), np.ones((2, 3))
    checked = StereoObservation(ids, uvd)
    made = validation.unchecked(StereoObservation, ids=ids, uvd=uvd, v_right=None, R=None)
    assert vars(made).keys() == vars(checked).keys()
    assert made.uvd is uvd
    with pytest.raises(ValueError, match="read-only"):
        made.uvd[0] = 0.0
