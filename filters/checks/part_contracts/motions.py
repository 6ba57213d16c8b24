"""Checks of motion models."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from filters.checks.conformance import require
from filters.checks.part_contracts.comparison import assert_close, assert_refusal, moved_world
from filters.contract.inputs import BodyVelocity, InertialSamples, InertialUnit
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import FloatArray
from filters.motions.motion_model import (
    CameraState,
    MotionModel,
    StepInput,
)

DT = 0.1


def a_camera(variables: Mapping[str, FloatArray]) -> CameraState:
    """Somewhere, turned and moving."""
    q = rotations.exp_quaternion(np.array([0.3, 0.5, -0.2]))
    return CameraState(np.array([1.0, -2.0, 3.0]), q, np.array([4.0, 0.5, -1.0]), np.array([0.1, -0.3, 0.2]), variables)


def _before(motion: MotionModel, dt: float = DT) -> tuple[CameraState, StepInput]:
    """A state, and odometry or inertial samples of a step that all models take."""
    rng = np.random.default_rng(0)
    near = {v.name: v.retraction.retract(v.value, 1e-2 * rng.standard_normal(v.size)) for v in motion.variables}
    odometry = BodyVelocity(np.array([0.2, -0.1, 5.0]), np.array([0.02, 0.3, -0.1]), np.diag(np.full(6, 1e-2)))
    if motion.takes is not InertialSamples:
        return a_camera(near), odometry
    tilted = rotations.exp_quaternion(np.array([0.1, -0.2, 1.3]))
    unit = InertialUnit(np.array([0.1, -0.3, 0.2]), tilted, 2e-3, 2e-2, 2e-4, 3e-3)
    rates, forces = rng.normal([0.02, 0.3, -0.1], 0.1, (6, 3)), rng.normal([-9.0, 1.0, 2.0], 0.5, (6, 3))
    return a_camera(near), InertialSamples(dt * np.linspace(0.1, 0.95, 6), rates, forces, unit)


def check_motion_prediction(motion: MotionModel) -> None:
    """A prediction has the documented shapes and a semi-definite noise, and no time moves the pose by nothing."""
    state, odometry = _before(motion)
    predicted = motion.predict(state, DT, odometry)
    require((np.linalg.eigvalsh(predicted.Q) >= -1e-12).all(), "Q is not positive semi-definite")
    at_once = motion.predict(state, 1e-9, _before(motion, 1e-9)[1]).state
    assert_close("position after no time", at_once.position, state.position)
    assert_close("orientation after no time", at_once.orientation, state.orientation)
    try:
        motion.predict(state, DT, None)
    except ValueError as error:
        assert_refusal(error, "inertial" if motion.takes is InertialSamples else "odometry")


def check_motion_jacobians(motion: MotionModel) -> None:
    """F, G and the H of odometry are those of differences."""
    state, odometry = _before(motion)
    predicted, size = motion.predict(state, DT, odometry), motion.size

    def after(e: FloatArray) -> CameraState:
        return motion.predict(motion.corrected(state, e), DT, odometry).state

    assert_close("F", predicted.F, derivatives.jacobian(lambda e: motion.difference(predicted.state, after(e)), size))
    if motion.driven and isinstance(odometry, BodyVelocity):

        def pushed(n: FloatArray) -> FloatArray:
            other = replace(odometry, linear=odometry.linear + n[:3], angular=odometry.angular + n[3:])
            return motion.difference(predicted.state, motion.predict(state, DT, other).state)

        assert_close("G", predicted.G, derivatives.jacobian(pushed, 6))
    measured = motion.odometry_measurement(state, DT, odometry)
    if measured is not None:

        def innovation(e: FloatArray) -> FloatArray:
            at = motion.odometry_measurement(motion.corrected(state, e), DT, odometry)
            if at is None:
                raise AssertionError("odometry is a measurement of some states only")
            return -at.innovation

        assert_close("H of odometry", measured.H, derivatives.jacobian(innovation, size))


def check_motion_invariance(motion: MotionModel) -> None:
    """In a world that is turned and shifted, with its variables that are vectors in W, the motion is the same."""
    state, odometry = _before(motion)
    expected = moved_world(motion.predict(state, DT, odometry).state, variables=motion.variables)
    in_another = motion.predict(moved_world(state, variables=motion.variables), DT, odometry).state
    where = "in a moved world (a vector in W is to be a Variable with in_world=True)"
    for name in ("position", "linear_velocity", "angular_velocity", "R_wc"):
        assert_close(f"{name} {where}", getattr(in_another, name), getattr(expected, name), 1e-9)
    for name in (variable.name for variable in motion.variables):
        assert_close(f"{name} in a moved world", in_another.variables[name], expected.variables[name], 1e-9)


CHECKS: tuple[Callable[..., None], ...] = (
    check_motion_prediction,
    check_motion_jacobians,
    check_motion_invariance,
)
