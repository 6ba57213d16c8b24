"""Motion models: the mean of Eq. 6 and of dead reckoning, and the noise they add."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, ConstantVelocity, InverseDepthStereoEKF, MotionModel, VelocityDriven
from filters.motions.motion_model import CameraState, MotionPrediction

from ..drives import CAMERA, INDEPENDENT_PIXELS

DT = 0.1


def random_state(seed: int) -> CameraState:
    rng = np.random.default_rng(seed)
    return CameraState(
        rng.standard_normal(3),
        Rotation.from_quat(rng.standard_normal(4)).as_quat(),
        rng.standard_normal(3),
        rng.standard_normal(3),
    )


def test_constant_velocity_is_equation_6() -> None:
    state = random_state(0)
    moved = ConstantVelocity().predict(state, DT, None).state
    np.testing.assert_allclose(moved.position, state.position + DT * state.linear_velocity)
    expected = Rotation.from_quat(state.orientation) * Rotation.from_rotvec(DT * state.angular_velocity)
    np.testing.assert_allclose(moved.R_wc, expected.as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(moved.linear_velocity, state.linear_velocity)
    np.testing.assert_array_equal(moved.angular_velocity, state.angular_velocity)


def test_noise_is_that_of_the_impulses() -> None:
    """V = a dt and Omega = alpha dt: sigma a dt on the velocity, sigma a dt^2 on the position."""
    predicted = ConstantVelocity(3.0, 0.6).predict(random_state(1), DT, None)
    np.testing.assert_allclose(predicted.Q, np.diag(np.repeat([0.3, 0.06], 3) ** 2))
    added = predicted.G @ predicted.Q @ predicted.G.T
    np.testing.assert_allclose(added[6:9, 6:9], 0.09 * np.eye(3))
    np.testing.assert_allclose(added[:3, :3], 0.09 * DT**2 * np.eye(3))
    np.testing.assert_allclose(added[:3, 6:9], 0.09 * DT * np.eye(3))
    np.testing.assert_allclose(added[9:, 9:], 0.0036 * np.eye(3))


def test_velocity_driven_follows_an_arc() -> None:
    """Constant body velocity for many short steps draws a circle of radius v / omega."""
    model = VelocityDriven()
    odometry = BodyVelocity([0.0, 0.0, 5.0], [0.0, 0.5, 0.0], np.eye(6))
    state = CameraState(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3))
    steps = 200
    for _ in range(steps):
        state = model.predict(state, np.pi / 0.5 / steps, odometry).state
    # Half a circle of radius 10 m to the right (+x).
    np.testing.assert_allclose(state.position, [20.0, 0.0, 0.0], atol=2e-3)
    np.testing.assert_allclose(state.R_wc, np.diag([-1.0, 1.0, -1.0]), atol=1e-9)
    np.testing.assert_array_equal(state.angular_velocity, odometry.angular)


def test_a_step_of_odometry_is_exact_to_second_order_in_the_turn() -> None:
    """Displacement R Exp(w dt / 2) v dt against the integral over the arc."""
    state = random_state(2)
    v, w = np.array([0.3, -0.2, 5.0]), np.array([0.1, 0.4, -0.1])
    moved = VelocityDriven().predict(state, DT, BodyVelocity(v, w, np.eye(6))).state
    times = (np.arange(1000) + 0.5) * DT / 1000
    arc = Rotation.from_rotvec(times[:, None] * w).apply(v).mean(axis=0) * DT
    np.testing.assert_allclose(moved.position, state.position + state.R_wc @ arc, atol=1e-3 * DT)


def test_odometry_of_a_state_that_agrees_with_it_has_no_innovation() -> None:
    """What VelocityDriven makes of odometry, ConstantVelocity expects as odometry."""
    odometry = BodyVelocity([0.2, 0.1, 5.0], [0.05, 0.4, -0.1], np.eye(6))
    after = VelocityDriven().predict(random_state(4), DT, odometry).state
    measured = ConstantVelocity().odometry_measurement(after, DT, odometry)
    np.testing.assert_allclose(measured.innovation, 0.0, atol=1e-12)
    np.testing.assert_array_equal(measured.R, np.eye(6))


@pytest.mark.parametrize("name", ["sigma_acceleration", "sigma_angular_acceleration"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_impossible_sigmas_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} must be"):
        ConstantVelocity(**{name: value})


class _FifteenStates(ConstantVelocity):
    def step(self, x, dt, n):
        return *ConstantVelocity.step(self, x, dt, n), (0.0, 0.0, 0.0)


class _PositionInThePlane(ConstantVelocity):
    def step(self, x, dt, n):
        return (x.position[0], x.position[2]), *ConstantVelocity.step(self, x, dt, n)[1:]


class _PredictsByItself(ConstantVelocity):
    def predict(self, state: CameraState, dt: float, odometry: BodyVelocity | None) -> MotionPrediction:
        return super().predict(state, dt, odometry)


@pytest.mark.parametrize(
    ("motion", "complaint"),
    [
        (_FifteenStates(), r"^_FifteenStates.step must give \(3, 4, 3, 3\) numbers, got \(3, 4, 3, 3, 3\)$"),
        (_PositionInThePlane(), r"^_PositionInThePlane.step must give \(3, 4, 3, 3\) numbers, got \(2, 4, 3, 3\)$"),
        (_PredictsByItself(), "^_PredictsByItself must not have predict of its own: it follows from step$"),
        (MotionModel(), "^MotionModel must have step: see MotionModel$"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, MotionModel) else "",
)
def test_a_motion_of_other_functions_is_refused(motion: MotionModel, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        InverseDepthStereoEKF(CAMERA, INDEPENDENT_PIXELS, motion=motion)
