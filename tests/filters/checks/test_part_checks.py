"""`check_part`: every part of the package passes, and what is wrong with a part is found where it is wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from filters import (
    CalibratedPair,
    ConformanceError,
    ConstantVelocity,
    DepthCamera,
    Euclidean,
    FirstEstimates,
    Hybrid,
    InverseDepth,
    MotionModel,
    Polar,
    QuaternionError,
    RangeBearing,
    RightInvariant,
    RotationVectorError,
    SensorJacobians,
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
    Hybrid(near_distance=10.0),
    RightInvariant(reset=True),
    make_part("measurement", {"name": "unrectified", "right_pose": (0.5, 0.02, -0.1, 0.05, 0.1, -0.2)}),
]


@parametrize_with_part_checks(NAMED + SET)
def test_parts_of_the_package_keep_their_contract(part: Any, check: Any) -> None:
    check(part)


# --- landmarks ---


class StartsElsewhere(InverseDepth):
    """Forgets Eq. 22: rho is that of the ray at z = 1, not of the unit ray."""

    def started(self, position: Any, h_w: Any, scale: Any) -> Any:
        new = super().started(position, h_w, scale)
        return replace(new, parameters=np.column_stack([new.parameters[:, :2], scale]))


class ForgetsTheScale(InverseDepth):
    """Leaves a Jacobian of the start at zero."""

    def started(self, position: Any, h_w: Any, scale: Any) -> Any:
        return replace(super().started(position, h_w, scale), by_scale=np.zeros((len(scale), 3)))


class WrongSign(Euclidean):
    """Its Jacobian by the camera position has the wrong sign."""

    def relative_to(self, position: Any, anchors: Any, parameters: Any) -> Any:
        seen = super().relative_to(position, anchors, parameters)
        return replace(seen, by_position=-seen.by_position)


class HalfBack(Spherical):
    """`local` is not the inverse of `retract`."""

    def local(self, parameters: Any, other: Any) -> Any:
        return 0.5 * super().local(parameters, other)


class NoTransport(Spherical):
    """Takes the error before for the error after a correction."""

    def transport(self, parameters: Any, delta: Any) -> None:
        return None


class StaysBehind(Euclidean):
    """Does not turn with the world."""

    def rotated(self, anchors: Any, parameters: Any, R: Any) -> Any:
        return parameters.copy()


class TurnsTooFar(Polar):
    """The retraction of an invariant error turns it twice."""

    def turned_by(self, y: Any, theta: Any, c: Any) -> Any:
        return super().turned_by(y, tuple(2.0 * angle for angle in theta), c)


class TurnsWithItsAnchor(Polar):
    """It is in the axes of its anchor, and turns with the world as if it were not."""

    in_anchor = True
    anchored = False

    def rotated(self, anchors: Any, parameters: Any, R: Any) -> Any:
        return np.hstack([parameters[:, :3] @ R.T, parameters[:, 3:]])


class AtInfinity(Euclidean):
    """Says that it can start without a distance."""

    def can_start_from(self, h: Any) -> Any:
        return True


# --- measurements ---


class DoubleDisparity(RangeBearing):
    """Predicts what it does not backproject."""

    def predict(self, camera: Any, points_c: Any, values: Any) -> Any:
        return super().predict(camera, points_c, values) * [1.0, 1.0, 2.0]


class NoCrossTerm(RangeBearing):
    """Leaves du / dz out."""

    def jacobians(self, camera: Any, points_c: Any, values: Any) -> Any:
        J = super().jacobians(camera, points_c, values).by_point.copy()
        J[:, 0, 2] = 0.0
        return SensorJacobians(J, {})


class ForgetsItsVariable(CalibratedPair):
    """Has no Jacobian by its own variable."""

    def jacobians(self, camera: Any, points_c: Any, values: Any) -> Any:
        return SensorJacobians(super().jacobians(camera, points_c, values).by_point, {})


class OnlyOnePoint(RangeBearing):
    """Fails where there is nothing to see."""

    def predict(self, camera: Any, points_c: Any, values: Any) -> Any:
        assert len(points_c) > 0
        return super().predict(camera, points_c, values)


class DepthEverywhere(DepthCamera):
    """Claims to see the depth of points at infinity."""

    def in_front(self, points_c: Any) -> Any:
        return points_c[:, 2] > 0.0


class UsesNothing(RangeBearing):
    """A row of its stage is no number of the sensor."""

    def rows(self, with_right: bool) -> Any:
        return (StageRows(((1.0, 0.0, 0.0), (0.0, 0.0, 0.0))),)


# --- motions ---


class HalfTheStep(ConstantVelocity):
    """F of half the time step."""

    def predict(self, state: Any, dt: Any, odometry: Any) -> Any:
        return replace(super().predict(state, dt, odometry), F=super().predict(state, 0.5 * dt, odometry).F)


class DriftsEast(ConstantVelocity):
    """Prefers a direction of the world."""

    def predict(self, state: Any, dt: Any, odometry: Any) -> Any:
        predicted = super().predict(state, dt, odometry)
        east = predicted.state.position + np.array([dt, 0.0, 0.0])
        return replace(predicted, state=replace(predicted.state, position=east))


class Jumps(MotionModel):
    """Moves ahead by a metre, in however little time."""

    def step(self, x: Any, dt: Any, n: Any) -> Any:
        ahead = rotate(x.orientation, (0.0, 0.0, 1.0))
        return plus(plus(x.position, ahead, 1.0), n, 1.0), *x[1:]

    def sigmas(self, dt: Any) -> Any:
        return 1.0, 1.0, 1.0


class CrypticWithoutOdometry(VelocityDriven):
    """Does not say what it misses."""

    def predict(self, state: Any, dt: Any, odometry: Any) -> Any:
        if odometry is None:
            raise ValueError("no input")
        return super().predict(state, dt, odometry)


# --- errors ---


class TwiceTheTurn(RotationVectorError):
    """Turns twice as far as the correction says."""

    def moved(self, state: Any, delta: Any) -> Any:
        twice = delta.copy()
        twice[3:6] *= 2.0
        return super().moved(state, twice)


class StaysAsItWas(QuaternionError):
    """Does not carry the covariance along."""

    def transport(self, state: Any, moved: Any, delta: Any) -> Any:
        return super().transport(state, state, 0.0 * delta)


class AlongTheWorld(RotationVectorError):
    """Corrects less along an axis of the world, the further it goes."""

    reset = False

    def moved(self, state: Any, delta: Any) -> Any:
        changed = delta.copy()
        changed[0] += delta[0] ** 2
        return super().moved(state, changed)


class WrongFrame(RotationVectorError):
    """Claims a covariance of the pose in one frame for an error in another."""

    def pose_error(self, camera: Any, P_pose: Any, position: Any, orientation: Any) -> Any:
        error, covariance = super().pose_error(camera, P_pose, position, orientation)
        return np.concatenate([camera.R_wc.T @ error[:3], error[3:]]), covariance


class Unconstrained(FirstEstimates):
    """Leaves Jacobians as they are."""

    def constrained(self, J: Any, image: Any, state: Any) -> Any:
        return J


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
    ForgetsTheScale(): "Jacobians of a start",
    AtInfinity(): "Jacobians of a start",
    WrongSign(): "Jacobians of a landmark in the map",
    HalfBack(): "A correction is undone",
    NoTransport(): "A correction is undone",
    StaysBehind(): "A landmark is seen the same",
    TurnsTooFar(): "Jacobians of a landmark in the map",
    TurnsWithItsAnchor(): "A landmark is seen the same",
    DoubleDisparity(): "A point is backprojected to where it is",
    NoCrossTerm(): "Jacobians of numbers and backprojection",
    ForgetsItsVariable(offset_sigma=1.0): "Jacobians of numbers and backprojection",
    OnlyOnePoint(): "Numbers have the documented shapes",
    DepthEverywhere(): "Numbers have the documented shapes",
    UsesNothing(): "Stages use the numbers of the sensor",
    HalfTheStep(): "F, G and the H of odometry",
    DriftsEast(): "In a world that is turned and shifted",
    Jumps(): "A prediction has the documented shapes",
    CrypticWithoutOdometry(): "A prediction has the documented shapes",
    TwiceTheTurn(): "To first order a correction adds",
    StaysAsItWas(): "`transport` is the Jacobian",
    AlongTheWorld(): "In a world that is turned, a correction",
    WrongFrame(): "The pose has no error against itself",
    Unconstrained(): "Constrained Jacobians take",
    AcceptsAnything(): "A setting that is no number",
    RefusesAtLength(): "A setting that is no number",
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("part", "line"), BROKEN.items(), ids=[type(part).__name__ for part in BROKEN])
def test_what_is_wrong_with_a_part_is_found(part: object, line: str) -> None:
    failed = check_part(part, raise_on_failure=False).failed
    assert any(failure.startswith(line) for failure in failed), failed


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_every_check_has_a_part_that_fails_it() -> None:
    failing = {line.partition(":")[0] for part in BROKEN for line in check_part(part, raise_on_failure=False).failed}
    every = {check.__doc__.splitlines()[0].rstrip(".") for part in NAMED for check in checks_of(part)}
    assert every <= failing


def test_a_failure_is_raised_with_each_check_that_failed() -> None:
    with pytest.raises(
        ConformanceError,
        match=r"WrongSign: 5 checks passed, 1 failed; runs in Python, on columns\n  failed: Jacobians of a landm",
    ):
        check_part(WrongSign())
    passed = "Euclidean: 6 checks passed, 0 failed; runs in machine code, with Jacobians by dual numbers"
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
