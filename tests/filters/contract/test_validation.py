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


LARGE, ROOT = 1e14 * np.eye(3), np.random.default_rng(0).standard_normal((12, 3))
BATCH = {"batch": 2, "definite": True}
check = validation


@pytest.mark.parametrize(
    ("call", "message"),
    [
        *((lambda x=x: check.finite_array("x", x, (3,)), r"x must (be numeric|have shape|be finite)")
          for x in (None, "a", [[1, 2], [3]], object())),
        *((lambda x=x: check.positive("x", x), "x must be a") for x in (0, -1, np.nan, np.inf, None, "a", [1, 2])),
        (lambda: check.positive("x", -1e-300, allow_zero=True), "x must be a finite number >= 0"),
        *((lambda q=q: check.unit_quaternion("q", q), "q must")
          for q in ([0, 0, 0, 0], [0, 0, 0, 1.01], [0, 0, 1], [np.nan, 0, 0, 1])),
        *((lambda i=i: check.unique_ids("ids", i), "ids must")
          for i in ([1, 1], [1.0, 2.0], [True, False], ["1"], 5, [[1]])),
        (lambda: check.covariance_matrix("P", ROOT @ ROOT.T - 0.001 * np.eye(12), 12),
         "P must be positive semi-definite, smallest eigenvalue is -0.00"),
        # Beside a large one a bad one does not hide.
        (lambda: check.covariance_matrix("R", np.stack([LARGE, np.diag([1.0, 1.0, -1e-3])]), 3, **BATCH),
         "R must be positive definite"),
        (lambda: check.covariance_matrix("R", np.stack([LARGE, np.eye(3) + 0.5 * np.eye(3, k=1)]), 3, **BATCH),
         "R must be symmetric"),
    ],
)  # fmt: skip
def test_what_is_none_is_refused_by_name(call, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_what_is_legal_at_the_edge() -> None:
    """A covariance that another filter made may be singular, and off by rounding."""
    validation.covariance_matrix("P", ROOT @ ROOT.T, 12)
    assert validation.positive("x", 0, allow_zero=True) == 0.0
    for length in (0, 1, 5):
        assert validation.finite_array("x", np.zeros((length, 3)), ("M", 3)).shape == (length, 3)


@pytest.mark.parametrize("norm", [1 - 9e-4, 1.0, 1 + 9e-4])
def test_a_nearly_unit_quaternion_is_normalised(norm: float) -> None:
    quaternion = validation.unit_quaternion("q", norm * np.array([0.5, 0.5, 0.5, 0.5]))
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("dtype", [np.int8, np.int32, np.uint16, np.int64])
def test_ids_of_any_integer_type_become_int64(dtype: type) -> None:
    assert validation.unique_ids("ids", np.array([3, 1, 2], dtype=dtype)).dtype == np.int64


def test_an_unchecked_observation_equals_a_checked_one_and_its_arrays_cannot_be_changed() -> None:
    ids, uvd = np.arange(2), np.ones((2, 3))
    checked = StereoObservation(ids, uvd)
    made = validation.unchecked(StereoObservation, ids=ids, uvd=uvd, v_right=None, R=None, bodies=None)
    assert vars(made).keys() == vars(checked).keys()
    assert made.uvd is uvd
    with pytest.raises(ValueError, match="read-only"):
        made.uvd[0] = 0.0
