"""The checks of `check_filter` and `check_part` as pytest cases (after scikit-learn's `parametrize_with_checks`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from filters.catalogue.registry import FilterFactory, label_of
from filters.checks.conformance import CHECKS, as_benchmarks_make_it
from filters.checks.part_checks import checks_of

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
    if isinstance(filters, str) or not isinstance(filters, Sequence) or not filters:
        raise ValueError(f"filters must be a list of filter classes and names, such as [MyFilter], got {filters!r}")
    return _cases("filter", [(label_of(factory), as_benchmarks_make_it(factory), CHECKS) for factory in filters])


def parametrize_with_part_checks(parts: Sequence[object]) -> pytest.MarkDecorator:
    """Decorate a test with arguments `part` and `check`: one case for each part and check of `check_part`.

    Parameters
    ----------
    parts : sequence of LandmarkModel, MeasurementModel, MotionModel or ErrorDefinition
        Parts, each as `check_part` takes it.

    Raises
    ------
    ValueError
        `parts` is empty or no sequence, or something in it is no such part.

    Examples
    --------
    >>> @parametrize_with_part_checks([MyLandmark(), MyMotion(0.3)])
    ... def test_part(part, check):
    ...     check(part)
    """
    if not isinstance(parts, Sequence) or not parts:
        raise ValueError(f"parts must be a list of parts, such as [MyLandmark()], got {parts!r}")
    return _cases("part", [(type(part).__name__, part, checks_of(part)) for part in parts])


def _cases(
    argument: str, subjects: Sequence[tuple[str, object, Sequence[Callable[[Any], None]]]]
) -> pytest.MarkDecorator:
    import pytest  # a test has it; estimation does without

    cases = [
        pytest.param(subject, check, id=f"{name}-{check.__name__}")
        for name, subject, checks in subjects
        for check in checks
    ]
    return pytest.mark.parametrize((argument, "check"), cases)
