"""Invariant errors: corrections are elements of the group, and both sides are one filter (20 s)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from filters import (
    BodyVelocity,
    ErrorDefinition,
    LeftInvariant,
    RightInvariant,
    Start,
    StereoObservation,
    VelocityDriven,
)
from filters.geometry import rotations, symmetric
from filters.joint_state import JointState
from filters.motions.motion_model import ANGULAR, CAMERA_SIZE, LINEAR, POSITION, ROTATION

from ..dense import gamma, minus, moved_by
from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, drive
from ..engine.beliefs import assert_same_belief, make, scaled
from ..invariant_ekf import InvariantEKF, wedge
from ..slots import LANDMARKS
from .worlds import odometry, small_correction, some_filter, turned_world

SIDES: dict[str, ErrorDefinition] = {"right": RightInvariant(reset=True), "left": LeftInvariant()}


def to_right(state: JointState) -> np.ndarray:
    """T of xi = T delta: theta = R delta_theta, and the rest is what a rotation by theta does not explain."""
    R_wc = state.camera.R_wc
    T = np.eye(len(state.P))
    T[:, ROTATION] -= gamma(state) @ R_wc
    T[ROTATION, ROTATION] = R_wc
    return T


def to_left(state: JointState) -> np.ndarray:
    """T of xi = T delta, of XYZ landmarks: points are seen from the camera."""
    return np.kron(np.eye(len(state.P) // 3), state.camera.R_wc.T) + np.pad(
        np.eye(3) - state.camera.R_wc.T, ((3, len(state.P) - 6), (3, len(state.P) - 6))
    )


COORDINATES: dict[str, Callable[[JointState], np.ndarray]] = {"right": to_right, "left": to_left}


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_without_reset_a_correction_leaves_p_alone_in_invariant_coordinates(landmark: str) -> None:
    slam = some_filter(landmark, RightInvariant(reset=False))
    before = slam.state
    after, transported = moved_by(slam, small_correction(before, 4))
    covariance = symmetric.full(before.P)
    P, P_after = to_right(before) @ covariance @ to_right(before).T, to_right(after) @ transported @ to_right(after).T
    np.testing.assert_allclose(P_after, P, rtol=0, atol=1e-7 * np.abs(P).max())
    assert np.abs(transported - covariance).max() > 1.0


@pytest.mark.parametrize("side", SIDES)
def test_a_correction_is_the_exponential_of_the_group(side: str) -> None:
    """Of [[R, r, v, f_1 ... f_n], [0, I]], from its side; the angular velocity is added to."""
    slam = some_filter("euclidean", SIDES[side])
    state = slam.state
    delta = small_correction(state, 5)
    xi = COORDINATES[side](state) @ delta
    columns = np.vstack([xi[ROTATION], xi[POSITION], xi[LINEAR], xi[CAMERA_SIZE:].reshape(-1, 3)])
    X, step = np.eye(len(columns) + 2), expm(wedge(columns.ravel()))
    X[:3, :3] = state.camera.R_wc
    X[:3, 3:] = np.vstack([state.camera.position, state.camera.linear_velocity, state.blocks]).T
    X = step @ X if side == "right" else X @ step
    moved, _ = moved_by(slam, delta)
    np.testing.assert_allclose(moved.camera.R_wc, X[:3, :3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(moved.camera.position, X[:3, 3], rtol=0, atol=1e-8)
    np.testing.assert_allclose(moved.camera.linear_velocity, X[:3, 4], rtol=0, atol=1e-8)
    np.testing.assert_allclose(moved.blocks, X[:3, 5:].T, rtol=0, atol=1e-7)
    np.testing.assert_allclose(
        moved.camera.angular_velocity, state.camera.angular_velocity + delta[ANGULAR], rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_correction_along_gamma_turns_the_world(landmark: str, side: str) -> None:
    """However large: this is what makes the filter blind to the choice of W."""
    slam, theta = some_filter(landmark, SIDES[side]), np.array([0.3, -1.1, 0.7])
    state = slam.state
    moved, _ = moved_by(slam, gamma(state) @ theta)
    expected = turned_world(state, Rotation.from_rotvec(theta))
    np.testing.assert_allclose(minus(expected, moved), 0.0, rtol=0, atol=1e-7)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_correction_of_the_camera_alone_leaves_the_map_where_it_is(landmark: str, side: str) -> None:
    """However large: a surprising turn of the camera says nothing of the map."""
    slam = some_filter(landmark, SIDES[side])
    state = slam.state
    delta = np.zeros(len(state.P))
    delta[ROTATION], delta[POSITION] = [0.3, -1.1, 0.7], [0.5, 0.2, -0.4]
    moved, _ = moved_by(slam, delta)
    np.testing.assert_allclose(moved.blocks, state.blocks, rtol=0, atol=1e-7)


@pytest.mark.parametrize("measurement", ["joint", "sequential"])
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_both_sides_are_one_filter(landmark: str, measurement: str) -> None:
    """Estimates and covariances, over a drive in which landmarks enter, leave and are missed."""
    frames = drive(21, 25, visible=12, depths=(6.0, 25.0))
    right, left = (make(landmark=landmark, measurement=measurement, error=error) for error in SIDES.values())
    rng = np.random.default_rng(3)
    for k, frame in enumerate(frames):
        moved = odometry(frames[k - 1], frame, rng, sigma=0.2) if k % 3 == 1 else None
        for slam in (right, left):
            if k:
                slam.predict(DT, moved)
            slam.update(frame.observation)
        assert_same_belief(right, left, 1e-9)
    assert len(right.landmarks.ids) > 8


def with_noisy_odometry(reference: InvariantEKF, error: ErrorDefinition) -> None:
    """Pose, map and both covariances are those of the reference over 20 steps; landmarks enter and are missed."""
    frames = drive(3, 21, visible=12, depths=(6.0, 20.0))
    slam = make(landmark="euclidean", error=error, motion=VelocityDriven(), drop_unseen=False)
    sigmas = np.array([0.2, 0.3, 0.1, 0.02, 0.05, 0.03])
    slam.reset(Start(covariance=np.diag(np.concatenate([sigmas, np.ones(6)]) ** 2)))
    reference.P = np.diag(np.concatenate([sigmas[3:], sigmas[:3]]) ** 2)
    rng = np.random.default_rng(8)
    for k, frame in enumerate(frames):
        if k:
            moved = odometry(frames[k - 1], frame, rng, sigma=0.3)
            slam.predict(DT, moved)
            reference.predict(DT, moved)
        slam.update(frame.observation)
        reference.update(frame.observation)
        np.testing.assert_allclose(slam.pose.position, reference.position, rtol=0, atol=1e-8)
        np.testing.assert_allclose(rotations.matrix(slam.pose.orientation), reference.rotation, atol=1e-8)
        _, covariance = slam.pose_error(frame.position, frame.orientation)
        swapped = reference.P[np.ix_([3, 4, 5, 0, 1, 2], [3, 4, 5, 0, 1, 2])]
        np.testing.assert_allclose(*scaled(covariance, swapped), rtol=0, atol=1e-8)
        believed = slam.landmarks
        order = believed.ids.tolist()
        assert sorted(reference.ids) == order
        np.testing.assert_allclose(believed.positions, [reference.landmark(i) for i in order], rtol=0, atol=1e-8)
        expected = np.array([reference.landmark_covariance(i) for i in order])
        np.testing.assert_allclose(*scaled(believed.covariances, expected), rtol=0, atol=1e-8)
    assert len(reference.ids) > 20


def test_without_reset_it_is_the_filter_written_from_the_paper() -> None:
    with_noisy_odometry(InvariantEKF(CAMERA, INDEPENDENT_PIXELS.R, reset=False), RightInvariant(reset=False))


@pytest.mark.parametrize("side", SIDES)
def test_it_is_the_dense_filter_on_the_group_with_the_full_jacobian_of_the_reset(side: str) -> None:
    with_noisy_odometry(InvariantEKF(CAMERA, INDEPENDENT_PIXELS.R, side=side), SIDES[side])


def kept_by_a_still_camera(landmark: str, error: str | ErrorDefinition) -> float:
    """Least share of the variance of its rotation, along any axis, that 40 frames leave."""
    nothing = BodyVelocity(np.zeros(3), np.zeros(3), np.zeros((6, 6)))
    rng = np.random.default_rng(12)
    uvd = rng.uniform([200.0, 50.0, 10.0], [1100.0, 350.0, 40.0], (8, 3))
    sigma, slam = 0.2, make(landmark=landmark, error=error, motion=VelocityDriven())
    slam.reset(Start(covariance=sigma**2 * np.eye(12)))
    for k in range(40):
        if k:
            slam.predict(DT, nothing)
        seen = uvd + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, 8)
        slam.update(StereoObservation(np.arange(8), seen))
    return float(np.linalg.eigvalsh(slam.pose.covariance[3:, 3:])[0] / sigma**2)


@pytest.mark.parametrize("landmark", LANDMARKS)
def test_a_still_camera_learns_nothing_about_its_own_pose(landmark: str) -> None:
    """It sees where things are relative to itself; the plain EKF takes the noise of that for a compass."""
    for error in ("first-estimates", RightInvariant(reset=False)):
        assert kept_by_a_still_camera(landmark, error) == pytest.approx(1.0, abs=1e-7)
    for error in ("quaternion", "so3"):
        assert kept_by_a_still_camera(landmark, error) < 0.99


@pytest.mark.parametrize("error", SIDES.values(), ids=SIDES)
def test_the_reset_loses_that_but_less_than_a_plain_ekf(error: ErrorDefinition) -> None:
    """The Jacobian of the group turns the unobservable directions by what separates its points, rays among them."""
    for landmark in ("inverse-depth", "shared-anchor", "euclidean"):
        plain, kept = kept_by_a_still_camera(landmark, "so3"), kept_by_a_still_camera(landmark, error)
        assert 2.0 * plain < kept < 0.99
