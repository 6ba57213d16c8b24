"""The checks of `check_filter` as pytest cases (after scikit-learn's `parametrize_with_checks`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from filters.conformance import CHECKS, as_benchmarks_make_it
from filters.registry import FilterFactory, label_of

if TYPE_CHECKING:
    import pytest


def parametrize_with_checks(filters: Sequence[str | FilterFactory]) -> pytest.MarkDecorator:
    """Decorate a test with arguments `filter` and `check`: one case for each filter and check of `check_filter`.

    Parameters
    ----------
    filters : sequence of str or callable
        Filters, each as `check_filter` takes it.

    Returns
    -------
    pytest.MarkDecorator
        Gives the test `filter`, which makes the filter as a benchmark does, and `check`, which raises an
        `AssertionError` if that filter fails it. The ids are such as `MyFilter-check_reset`, for `pytest -k`.

    Raises
    ------
    ValueError
        `filters` is empty or no sequence, or there is no filter of a name.

    Examples
    --------
    >>> @parametrize_with_checks([MyFilter, "inverse-depth"])
    ... def test_contract(filter, check):
    ...     check(filter)
    """
    import pytest  # a test has it; estimation does without

    if isinstance(filters, str) or not isinstance(filters, Sequence) or not filters:
        raise ValueError(f"filters must be a list of filter classes and names, such as [MyFilter], got {filters!r}")
    cases = [
        pytest.param(make, check, id=f"{label_of(factory)}-{check.__name__}")
        for factory, make in [(factory, as_benchmarks_make_it(factory)) for factory in filters]
        for check in CHECKS
    ]
    return pytest.mark.parametrize(("filter", "check"), cases)
