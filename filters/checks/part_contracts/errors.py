"""Checks of error definitions."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE
from filters.checks.part_contracts.comparison import TURN, assert_close, moved_world
from filters.checks.part_contracts.motions import a_camera
from filters.contract.inputs import Start, StereoObservation
from filters.engine.stereo_ekf import StereoEKF
from filters.errors.error_definition import ErrorDefinition
from filters.geometry import derivatives, rotations, symmetric
from filters.geometry.arrays import FloatArray
from filters.landmarks.euclidean import Euclidean
from filters.landmarks.inverse_depth import InverseDepth
from filters.landmarks.landmark_model import LandmarkModel
from filters.motions.motion_model import ROTATION
from filters.state.joint_state import JointState, world_rotation_of_variables


def _state(model: LandmarkModel) -> JointState:
    """A state with four landmarks, one of which is far; the camera has moved on."""
    root = 0.1 * np.random.default_rng(0).standard_normal((12, 12))
    at = a_camera({})
    start = Start(at.position - [0.5, 0.1, 0.3], at.orientation, at.linear_velocity, at.angular_velocity, root @ root.T)
    slam = StereoEKF(REFERENCE_CAMERA, REFERENCE_NOISE, landmark=model)
    slam.reset(start)
    uvd = np.array([[600.0, 200.0, 30.0], [300.0, 100.0, 20.0], [900.0, 250.0, 10.0], [800.0, 180.0, 1.0]])
    slam.update(StereoObservation(np.arange(4), uvd))
    state = slam.state
    state.camera = state.predicted = at
    return state


def _difference(error: ErrorDefinition, state: JointState, other: JointState) -> FloatArray:
    """Errors of `state` against another one, in the standard coordinates; (n,)."""
    blocks = other.blocks[:, :3] - state.blocks[:, :3]
    blocks[state.parameter_block] = state.model.local(state.parameters(), other.parameters())
    a, b = state.camera, other.camera
    turn = error.orientation.local(a.orientation, b.orientation)
    velocities = b.linear_velocity - a.linear_velocity, b.angular_velocity - a.angular_velocity
    return np.concatenate([b.position - a.position, turn, *velocities, blocks.ravel()])


def _transport(error: ErrorDefinition, state: JointState, delta: FloatArray) -> FloatArray:
    step = error.transport(state, error.moved(state, delta), delta)
    J, size = np.eye(len(delta)), len(step.leading)
    J[:size, :size] = step.leading
    if step.by_rotation is not None:
        J[size:, ROTATION] = step.by_rotation
    if step.rows is not None and step.own is not None:
        J[step.rows[:, :, None], step.rows[:, None, :]] = step.own
    return J


def check_error_retraction(error: ErrorDefinition) -> None:
    """To first order a correction adds to the errors in standard coordinates, and nothing is changed by none."""
    state = _state(InverseDepth())
    still = np.zeros(len(state.P))
    assert_close("moved by nothing", _difference(error, state, error.moved(state, still)), still)
    by_delta = derivatives.jacobian(lambda e: _difference(error, state, error.moved(state, e)), len(still))
    assert_close("moved", by_delta, np.eye(len(still)))
    assert_close("transport of no correction", _transport(error, state, still), np.eye(len(still)))


def check_error_transport(error: ErrorDefinition) -> None:
    """`transport` is the Jacobian of the retraction at a correction, unless the definition has no `reset`."""
    for state in (_state(InverseDepth()), _state(Euclidean())) if error.reset else ():
        delta = np.random.default_rng(1).uniform(-0.05, 0.05, len(state.P))

        def after(e: FloatArray, state: JointState = state, delta: FloatArray = delta) -> FloatArray:
            return _difference(error, error.moved(state, delta), error.moved(state, delta + e))

        assert_close("transport", _transport(error, state, delta), derivatives.jacobian(after, len(delta)))


def check_error_invariance(error: ErrorDefinition) -> None:
    """In a world that is turned, a correction that is turned with it leads to the turned state."""
    state = _state(Euclidean())
    turned = dataclasses.replace(state, camera=moved_world(state.camera, np.zeros(3)), blocks=state.blocks @ TURN.T)
    delta = np.random.default_rng(1).uniform(-0.05, 0.05, len(state.P)).reshape(-1, 3)
    other = delta @ TURN.T
    other[[1, 3]] = delta[[1, 3]]  # rotation and angular velocity are those of the camera
    after, again = error.moved(state, delta.ravel()), error.moved(turned, other.ravel())
    assert_close("landmarks in a turned world", again.blocks, after.blocks @ TURN.T, 1e-9)
    assert_close("position in a turned world", again.camera.position, TURN @ after.camera.position, 1e-9)
    assert_close("orientation in a turned world", again.camera.R_wc, TURN @ after.camera.R_wc, 1e-9)


def check_error_of_the_pose(error: ErrorDefinition) -> None:
    """The pose has no error against itself, and `pose_error` has the covariance of small ones."""
    state = _state(Euclidean())
    camera, P = state.camera, symmetric.full(state.P[:6, :6])
    none, covariance = error.pose_error(camera, P, camera.position, camera.orientation)
    assert_close("pose_error of the pose itself", none, np.zeros(6))

    def against(e: FloatArray) -> FloatArray:
        true = rotations.multiply(camera.orientation, rotations.exp_quaternion(e[3:]))
        return error.pose_error(camera, P, camera.position + e[:3], true)[0]

    J = derivatives.jacobian(against, 6)
    assert_close("covariance of pose_error", covariance, J @ P @ J.T)


def check_error_constraint(error: ErrorDefinition) -> None:
    """Constrained Jacobians take the effect of a rotation of the world on the state to that on what they are of."""
    state, rng = _state(InverseDepth()), np.random.default_rng(1)
    J, image = rng.standard_normal((5, state.layout.size)), rng.standard_normal((5, 3))
    adjusted = error.constrained(J, image, state)
    if error.constrains:
        assert_close("constrained", adjusted @ world_rotation_of_variables(state.layout, state.predicted), image, 1e-9)
    else:
        assert_close("constrained", adjusted, J, 1e-12)


CHECKS: tuple[Callable[..., None], ...] = (
    check_error_retraction,
    check_error_transport,
    check_error_invariance,
    check_error_of_the_pose,
    check_error_constraint,
)
