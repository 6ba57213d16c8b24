"""`check_part`: the checks that every landmark, measurement, motion and error must pass.

Jacobians are held against differences of the functions that they belong to, corrections are undone, and the world is
moved as a whole. Landmarks and points are near, far, at infinity and beyond it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from filters.checks.conformance import ConformanceReport, checked
from filters.checks.part_contracts import errors, landmarks, measurements, motions
from filters.checks.part_contracts.comparison import assert_refusal
from filters.engine.options import check_functions
from filters.errors import ErrorDefinition
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel
from filters.motions.motion_model import MotionModel

PartCheck = Callable[[Any], None]


def check_part(part: object, *, raise_on_failure: bool = True) -> ConformanceReport:
    """Check that a part of a filter keeps the contract of its base class.

    Parameters
    ----------
    part : LandmarkModel, MeasurementModel, MotionModel or ErrorDefinition
        The part, as a filter is given it.
    raise_on_failure : bool
        Raise if a check fails; else only report.

    Raises
    ------
    ConformanceError
        With every failed check listed.
    ValueError
        It is no such part.
    """
    from filters.kernels.lift import how_it_runs  # Numba takes longer to import than all the rest

    return checked(type(part).__name__, checks_of(part), part, raise_on_failure, how_it_runs(part))


def checks_of(part: object) -> tuple[PartCheck, ...]:
    """The checks for a part of this kind."""
    for kind, checks in PART_CHECKS.items():
        if isinstance(part, kind):
            return (*checks, check_plain_functions, check_settings)
    kinds = ", ".join(kind.__name__ for kind in PART_CHECKS)
    raise ValueError(f"part must be one of {kinds}, got {part!r}: give an object, such as make_part makes")


def check_plain_functions(part: Any) -> None:
    """A part gives its plain functions, and leaves what follows from them alone."""
    if not isinstance(part, ErrorDefinition):
        try:
            check_functions(part)
        except ValueError as error:
            raise AssertionError(str(error)) from None


def check_settings(part: Any) -> None:
    """A setting that is no number is refused in one line that names it."""
    for field in dataclasses.fields(part) if dataclasses.is_dataclass(part) else ():
        now = getattr(part, field.name)
        number = now is None or (isinstance(now, float | int) and not isinstance(now, bool))
        for value in (float("nan"), "a word") if number else ():
            try:
                dataclasses.replace(part, **{field.name: value})
            except ValueError as error:
                assert_refusal(error, field.name)
            else:
                raise AssertionError(f"{field.name}={value!r} is accepted")


PART_CHECKS: Mapping[type, tuple[PartCheck, ...]] = {
    LandmarkModel: landmarks.CHECKS,
    MeasurementModel: measurements.CHECKS,
    MotionModel: motions.CHECKS,
    ErrorDefinition: errors.CHECKS,
}
"""The checks of `check_part` for each kind, besides that of its settings."""
