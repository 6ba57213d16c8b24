"""`check_part`: every part of the package passes, and what is wrong with a part is found where it is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from filters import (
    CalibratedPair,
    ConformanceError,
    ConstantVelocity,
    DepthCamera,
    Euclidean,
    Hybrid,
    InverseDepth,
    MotionModel,
    Polar,
    RangeBearing,
    RightInvariant,
    RotationVectorError,
    Spherical,
    StageRows,
    Variable,
    VelocityDriven,
    check_part,
    make_part,
    parametrize_with_part_checks,
)
from filters.checks.part_checks import checks_of
from filters.geometry.vectors import plus, rotate
from filters.parts import SLOTS

CHECKED = ("landmark", "measurement", "motion", "error")
NAMED = [make_part(slot, name) for slot in CHECKED for name in SLOTS[slot].named]
SET = [
    CalibratedPair(0.25, 3e-3, 2e-3, 5e-3, 2e-3, 1e-3),
    Hybrid(linearity_limit=None),
    RightInvariant(reset=True),
    make_part("measurement", {"name": "unrectified", "right_pose": (0.5, 0.02, -0.1, 0.05, 0.1, -0.2)}),
]


@parametrize_with_part_checks(NAMED + SET)
def test_parts_of_the_package_keep_their_contract(part: Any, check: Any) -> None:
    check(part)


# --- landmarks ---


class StartsElsewhere(InverseDepth):
    """Forgets Eq. 22: rho is that of the ray at z = 1, not of the unit ray."""

    def start_from(self, h: Any) -> Any:
        theta, phi, _ = super().start_from(h)
        return theta, phi, h[3]


class CutsTheDerivative(InverseDepth):
    """Takes a number out of its derivatives."""

    def start_from(self, h: Any) -> Any:
        theta, phi, rho = super().start_from(h)
        return theta, phi, getattr(rho, "value", rho)


class WrongSlope(Euclidean):
    """A number that it gives does not follow its argument."""

    def point_of(self, y: Any) -> Any:
        x = getattr(y[0], "value", y[0])
        return x, y[1], y[2], 1.0


class HalfBack(Spherical):
    """`local_by` is not the inverse of `retract_by`."""

    def local_by(self, y: Any, other: Any) -> Any:
        return tuple(0.5 * c for c in super().local_by(y, other))


class StaysBehind(Spherical):
    """Starts in a direction of the world, whatever it sees."""

    def start_from(self, h: Any) -> Any:
        x, y, z, rho = super().start_from((h[0] + 0.1, h[1], h[2], h[3]))
        return x, y, z, rho


class TurnsTooFar(Polar):
    """The retraction of an invariant error turns it twice."""

    def turned_by(self, y: Any, theta: Any, c: Any) -> Any:
        return super().turned_by(y, tuple(2.0 * angle for angle in theta), c)


class AtInfinity(Euclidean):
    """Says that it can start without a distance."""

    def can_start_from(self, h: Any) -> Any:
        return True


class RotatesItself(InverseDepth):
    """Overrides what follows from its functions."""

    def relative_to(self, position: Any, anchors: Any, parameters: Any) -> Any:
        return super().relative_to(position, anchors, parameters)


# --- measurements ---


class DoubleDisparity(RangeBearing):
    """Predicts what it does not backproject."""

    def project(self, camera: Any, h: Any, values: Any = None) -> Any:
        u, v, d = super().project(camera, h)
        return u, v, 2.0 * d


class NoCrossTerm(RangeBearing):
    """Leaves du / dz out."""

    def project(self, camera: Any, h: Any, values: Any = None) -> Any:
        u, v, d = super().project(camera, (h[0], h[1], getattr(h[2], "value", h[2]), h[3]))
        return u, v, d


class ForgetsItsVariable(CalibratedPair):
    """Has no derivative by its own variable."""

    def project(self, camera: Any, h: Any, values: Any = None) -> Any:
        still = type(values)(*(tuple(getattr(x, "value", x) for x in value) for value in values))
        return super().project(camera, h, still)


class NotTheSameScale(RangeBearing):
    """Sees longer directions as other points."""

    def project(self, camera: Any, h: Any, values: Any = None) -> Any:
        u, v, d = super().project(camera, h)
        return u, v, d * h[2]

    def unproject(self, camera: Any, uvd: Any, values: Any = None) -> Any:
        return super().unproject(camera, uvd)


class DepthEverywhere(DepthCamera):
    """Claims to see the depth of points at infinity."""

    def can_see(self, h: Any) -> Any:
        return h[2] > 0.0


class UsesNothing(RangeBearing):
    """A row of its stage is no number of the sensor."""

    def rows(self, with_right: bool) -> Any:
        return (StageRows(((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))),)


# --- motions ---


class HalfTheStep(ConstantVelocity):
    """Takes the derivatives of a part of the step away."""

    def step(self, x: Any, dt: Any, n: Any) -> Any:
        after = super().step(x, dt, n)
        still = tuple(getattr(v, "value", v) for v in x.linear_velocity)
        return plus(plus(after[0], x.linear_velocity, -0.5 * dt), still, 0.5 * dt), *after[1:]


class DriftsEast(ConstantVelocity):
    """Prefers a direction of the world."""

    def step(self, x: Any, dt: Any, n: Any) -> Any:
        after, *others = super().step(x, dt, n)  # which Numba cannot compile
        return plus(after, (1.0, 0.0, 0.0), dt), *others


class Jumps(MotionModel):
    """Moves ahead by a metre, in however little time."""

    def step(self, x: Any, dt: Any, n: Any) -> Any:
        ahead = rotate(x.orientation, (0.0, 0.0, 1.0))
        return plus(plus(x.position, ahead, 1.0), n, 1.0), *x[1:]

    def sigmas(self, dt: Any) -> Any:
        return 1.0, 1.0, 1.0


class CrypticWithoutOdometry(VelocityDriven):
    """Does not say what it misses."""

    def check_odometry(self, odometry: Any) -> None:
        if odometry is None:
            raise ValueError("no input")


# --- errors ---


class AlongTheWorld(RotationVectorError):
    """Claims the error of the pose along an axis of the world."""

    def pose_error(self, camera: Any, P_pose: Any, position: Any, orientation: Any) -> Any:
        error, covariance = super().pose_error(camera, P_pose, position, orientation)
        return error + np.eye(6)[0], covariance


class WrongFrame(RotationVectorError):
    """Claims a covariance of the pose in one frame for an error in another."""

    def pose_error(self, camera: Any, P_pose: Any, position: Any, orientation: Any) -> Any:
        error, covariance = super().pose_error(camera, P_pose, position, orientation)
        return np.concatenate([camera.R_wc.T @ error[:3], error[3:]]), covariance


@dataclass(frozen=True)
class AcceptsAnything(RangeBearing):
    """Has a setting that it does not look at."""

    limit: float = 1.0


@dataclass(frozen=True)
class RefusesAtLength(RangeBearing):
    """Refuses in two lines."""

    limit: float = 1.0

    def __post_init__(self) -> None:
        if self.limit != 1.0:
            raise ValueError("limit must be 1\nand nothing else")


BROKEN = {
    StartsElsewhere(): "A landmark is seen where it was started",
    CutsTheDerivative(): "Derivatives of a start",
    AtInfinity(): "Derivatives of a start",
    WrongSlope(): "Derivatives of a landmark in the map",
    HalfBack(): "A correction is undone",
    StaysBehind(): "A landmark starts where the turned one is",
    TurnsTooFar(): "Derivatives of a landmark in the map",
    RotatesItself(): "A part gives its plain functions",
    DoubleDisparity(): "A point is backprojected to where it is",
    NoCrossTerm(): "Derivatives of numbers and backprojection",
    ForgetsItsVariable(offset_sigma=1.0): "Derivatives of numbers and backprojection",
    NotTheSameScale(): "Numbers have the documented shapes",
    DepthEverywhere(): "Numbers have the documented shapes",
    UsesNothing(): "Stages use the numbers of the sensor",
    HalfTheStep(): "F, G and the H of odometry",
    DriftsEast(): "The motion is the same in a turned",
    Jumps(): "A prediction has the documented shapes",
    CrypticWithoutOdometry(): "A prediction has the documented shapes",
    AlongTheWorld(): "The pose has no error against itself",
    WrongFrame(): "The pose has no error against itself",
    AcceptsAnything(): "A setting that is no number",
    RefusesAtLength(): "A setting that is no number",
}
ENGINE = {"A measurement that is what the filter expects", "The same measurements lead to the turned estimate"}
"""Checks of what the engine does with an error definition: a part says which, and cannot break it."""


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("part", "line"), BROKEN.items(), ids=[type(part).__name__ for part in BROKEN])
def test_what_is_wrong_with_a_part_is_found(part: object, line: str) -> None:
    failed = check_part(part, raise_on_failure=False).failed
    assert any(failure.startswith(line) for failure in failed), failed


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_every_check_has_a_part_that_fails_it() -> None:
    failing = {line.partition(":")[0] for part in BROKEN for line in check_part(part, raise_on_failure=False).failed}
    every = {check.__doc__.splitlines()[0].rstrip(".") for part in NAMED for check in checks_of(part)}
    assert {line for line in every if not any(map(line.startswith, ENGINE))} <= failing


def test_a_failure_is_raised_with_each_check_that_failed() -> None:
    with pytest.raises(
        ConformanceError, match=r"NoCrossTerm: 5 checks passed, 1 failed; runs in .*\n  failed: Derivatives of numbers"
    ):
        check_part(NoCrossTerm())
    passed = "Euclidean: 7 checks passed, 0 failed; runs in machine code, with Jacobians by dual numbers"
    assert str(check_part(Euclidean())) == passed


@pytest.mark.parametrize(
    "value", ["euclidean", Euclidean, Variable("bias", np.zeros(1), np.eye(1))], ids=["a name", "a class", "a variable"]
)
def test_what_is_no_part_is_refused_in_one_line(value: object) -> None:
    with pytest.raises(ValueError, match=r"^part must be one of LandmarkModel, MeasurementModel, .* make_part makes$"):
        check_part(value)


@pytest.mark.parametrize("parts", [[], Euclidean()], ids=["none", "one"])
def test_cases_are_made_of_a_list_of_parts(parts: Any) -> None:
    with pytest.raises(ValueError, match=r"^parts must be a list of parts, such as \[MyLandmark\(\)\], got "):
        parametrize_with_part_checks(parts)


def test_a_case_is_named_by_part_and_check() -> None:
    mark = parametrize_with_part_checks([Euclidean()])
    assert mark.args[0] == ("part", "check")
    assert mark.args[1][0].id == "Euclidean-check_landmark_start"
