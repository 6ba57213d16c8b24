"""Variables that come and go: what they are made of, how they step, what landmarks they carry, and that they leave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from filters import ConstantVelocity, MovedLandmarks, Start, StereoEKF, StereoObservation, Variable
from filters.geometry import rotations, symmetric

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, drive, run, start
from ..engine.beliefs import assert_same_belief
from ..slots import ERRORS, LANDMARKS

TILT = Variable("tilt", [0.1, 9.7, 0.2], 0.3**2 * np.eye(3), in_world=True)
SCALES = Variable("scales", [1.0, 1.1, 0.9, 1.2], np.diag([0.1, 0.2, 0.3, 0.4]) ** 2, random_walk=[0.0, 0.1, 0.2, 0.3])


@dataclass(frozen=True)
class WithVariables(ConstantVelocity):
    """Constant velocity beside variables that it has from the start."""

    variables: tuple[Variable, ...] = (TILT, SCALES)

    def step(self, x, dt, n):
        return *ConstantVelocity.step(self, x, dt, n), *x[4:]


def make(**options) -> StereoEKF:
    return start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **{"gate": None, **options}))


def measure(slam: StereoEKF, k: int) -> None:
    """A measurement of both variables with the pose."""
    rng = np.random.default_rng(k)
    H = {name: rng.standard_normal((2, size)) for name, size in (("tilt", 3), ("scales", 4), ("pose", 6))}
    slam.correct(0.1 * rng.standard_normal(2), H, 0.01 * np.eye(2))


@pytest.mark.parametrize("error", ERRORS)
def test_a_variable_that_is_added_is_believed_in_as_one_that_a_part_has(error: str) -> None:
    frames = drive(50, 10, visible=10, depths=(6.0, 20.0))
    part, added = make(error=error, motion=WithVariables()), make(error=error)
    for slam in (part, added):
        for k, _ in enumerate(run(slam, frames)):
            if k == 0 and slam is added:
                slam.add_variable(TILT)
                slam.add_variable(SCALES)
            if k in (2, 5, 8):
                measure(slam, k)
    names = "pose", "velocity", "tilt", "scales"
    near = (
        1e-8 if error != "first-estimates" else 0.05
    )  # linearised where a vector was added, not where it was predicted
    sigmas = np.sqrt(np.diag(part.belief(*names).covariance))
    for name in names:
        np.testing.assert_allclose(added.belief(name).value, part.belief(name).value, rtol=near, atol=1e-10)
    off = np.abs(added.belief(*names).covariance - part.belief(*names).covariance) / np.outer(sigmas, sigmas)
    assert off.max() < near
    assert np.abs(added.belief("tilt").value - TILT.value).max() > 1e-3


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("landmark", LANDMARKS)
def test_it_changes_nothing_else_and_leaves_without_a_trace(landmark: str, error: str) -> None:
    frames = drive(51, 12, visible=10, depths=(6.0, 20.0))
    never, stays, left = (make(landmark=landmark, error=error) for _ in range(3))
    for slam in (never, stays, left):
        for k, _ in enumerate(run(slam, frames)):
            if k == 4 and slam is not never:
                slam.add_variable(SCALES, {"pose": 0.1 * np.ones((4, 6))})
                slam.clone_pose("here")
            if k == 9 and slam is left:
                slam.remove_variable("scales")
                slam.forget_clone("here")
    assert_same_belief(stays, never, 1e-9)
    assert_same_belief(left, never, 1e-9)
    assert stays.state_size - 6 - 6 == left.state_size == never.state_size
    assert not left.state.clones


def test_it_is_correlated_with_what_it_is_made_of() -> None:
    """The error of the value is J e + its own: P becomes [[P, P J^T], [J P, J P J^T + C]]."""
    slam = make(drop_unseen=False)
    list(run(slam, drive(52, 5)))
    one, rng = int(slam.ids[0]), np.random.default_rng(0)
    J = {"pose": rng.standard_normal((4, 6)), one: rng.standard_normal((4, 6))}
    slam.clone_pose("before")
    P = slam.belief("pose", "velocity").covariance
    by = np.zeros((4, 12))
    by[:, :6] = J["pose"]
    slam.add_variable(SCALES, {"pose": J["pose"]})
    there = slam.belief("scales", "pose", "velocity").covariance
    np.testing.assert_allclose(there[:4, 4:], by @ P, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(there[:4, :4], by @ P @ by.T + SCALES.covariance, rtol=1e-9)
    slam.remove_variable("scales")
    slam.add_variable(SCALES, J)
    assert slam.belief("scales").covariance[0, 0] > by[0] @ P @ by[0]


def body(slam: StereoEKF, seed: int = 0) -> tuple:
    """A step of a twist (velocity, angular velocity in W) that carries three landmarks along."""
    rng, ids = np.random.default_rng(seed), np.sort(slam.ids)[[1, 3, 4]]
    value = slam.belief("twist").value
    turn, shift = 0.1 * value[3:], 0.1 * value[:3]
    D = rotations.exp(turn)
    positions = slam.landmarks.positions[np.searchsorted(np.sort(slam.ids), ids)]
    by_variable = np.zeros((3, 3, 6))
    by_variable[:, :, :3] = 0.1 * np.eye(3)
    by_variable[:, :, 3:] = -0.1 * rotations.skew(positions @ D.T)
    F, Q = np.eye(6) + 0.01 * rng.standard_normal((6, 6)), np.diag(np.arange(1.0, 7.0)) * 1e-3
    carried = MovedLandmarks(ids, positions @ D.T + shift, np.broadcast_to(D, (3, 3, 3)), by_variable)
    return value, F, Q, carried


TWIST = Variable("twist", [0.5, 0.0, 2.0, 0.0, 0.1, 0.0], 0.1 * np.eye(6))


def test_a_step_carries_landmarks_along() -> None:
    """Against whole matrices: T (P + Q) T^T."""
    slam = make(landmark="euclidean", drop_unseen=False)
    list(run(slam, drive(53, 4, visible=8, missed=0.0, depths=(6.0, 20.0))))
    slam.add_variable(TWIST, {"velocity": 0.2 * np.eye(6)})
    value, F, Q, carried = body(slam)
    before = slam.state
    P, T, added = symmetric.full(before.P), np.eye(len(before.P)), np.zeros_like(before.P)
    rows = before.block_rows(before.added["twist"].blocks)
    own = before.own_rows()[np.searchsorted(before.ids, carried.ids)]
    T[np.ix_(rows, rows)], added[np.ix_(rows, rows)] = F, Q
    for at, D, B in zip(own, carried.by_landmark, carried.by_variable, strict=True):
        T[np.ix_(at, at)], T[np.ix_(at, rows)] = D, B
    slam.move_variable("twist", value + 0.1, F, Q, carried)
    np.testing.assert_allclose(symmetric.full(slam.state.P), T @ (P + added) @ T.T, rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(slam.belief("twist").value, value + 0.1)
    where = np.searchsorted(slam.landmarks.ids, carried.ids)
    np.testing.assert_allclose(slam.landmarks.positions[where], carried.positions)


@pytest.mark.parametrize("error", ["so3", "first-estimates", "right-invariant"])
def test_the_velocity_of_landmarks_that_move_together_is_found(error: str) -> None:
    """Ten points drift by 1 m/s to the right, which nobody told the filter; twenty stand still."""
    rng, slam = np.random.default_rng(3), make(landmark="euclidean", drop_unseen=False, error=error)
    points = CAMERA.backproject(rng.uniform([300.0, 80.0, 20.0], [1000.0, 320.0, 60.0], (30, 3)))
    drift, speed = np.array([1.0, 0.0, 0.2]), np.array([0.0, 0.0, 3.0])
    slam.reset(Start(linear_velocity=speed))
    slam.add_variable(Variable("drift", np.zeros(3), np.eye(3), in_world=True))
    for k in range(15):
        if k:
            slam.predict(DT)
            value, ids = slam.belief("drift").value, np.arange(10)
            B = np.broadcast_to(DT * np.eye(3), (10, 3, 3))
            positions = slam.landmarks.positions[:10] + DT * value
            carried = MovedLandmarks(ids, positions, np.broadcast_to(np.eye(3), (10, 3, 3)), B)
            slam.move_variable("drift", value, np.eye(3), 1e-6 * np.eye(3), carried)
        at = points - speed * k * DT
        at[:10] += drift * k * DT
        uvd = CAMERA.project(at) + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, 30)
        slam.update(StereoObservation(np.arange(30), uvd))
    belief = slam.belief("drift")
    error_of = belief.value - drift
    assert error_of @ np.linalg.solve(belief.covariance, error_of) < 16.3  # chi2, 99.9 %
    assert np.sqrt(np.diag(belief.covariance)).max() < 0.15


def test_a_copy_of_the_state_has_it() -> None:
    slam = make()
    slam.clone_pose("first")
    slam.add_variable(SCALES)
    slam.clone_pose("last")
    slam.remove_variable("first")
    other = make()
    other.state = slam.state
    for name in ("scales", "last"):
        np.testing.assert_array_equal(other.belief(name).value, slam.belief(name).value)
    assert other.clones == slam.clones == ("last",)
    for one in (slam, other):
        one.predict(0.2)
    np.testing.assert_array_equal(other.belief("scales").covariance, slam.belief("scales").covariance)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.add_variable(SCALES), r"^name must be new, there is a variable 'scales' already"),
        (lambda s: s.remove_variable("tilt"), r"^there is no added variable 'tilt'"),
        (lambda s: s.add_variable(TILT, {"pose": np.eye(3)}), r"^H of 'pose' must have shape \(3, 6\), got \(3, 3\)$"),
        (lambda s: s.add_variable(TILT, {"nobody": np.eye(3)}), r"^there is no variable 'nobody'"),
        (
            lambda s: s.move_variable("nobody", np.zeros(7), np.eye(6), np.eye(6)),
            r"^there is no added variable 'nobody'",
        ),
        (lambda s: s.move_variable("scales", np.zeros(3), np.eye(4), np.eye(4)), r"^value must have shape \(4,\)"),
        (lambda s: carry(s, MovedLandmarks.none(3)), r"^landmarks.by_variable must have shape \(0, 3, 4\), got"),
        (
            lambda s: carry(s, MovedLandmarks([10**6], np.zeros((1, 3)), np.zeros((1, 3, 3)), np.zeros((1, 3, 4)))),
            r"^landmarks.ids must be in the map, not there: \[1000000\]$",
        ),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(call, message: str) -> None:
    slam = make(landmark="inverse-depth")
    slam.update(drive(1, 1)[0].observation)
    slam.clone_pose("here")
    slam.add_variable(SCALES)
    P = slam.state.P.copy()
    with pytest.raises(ValueError, match=message):
        call(slam)
    np.testing.assert_array_equal(slam.state.P, P)


def carry(slam: StereoEKF, landmarks: MovedLandmarks) -> None:
    slam.move_variable("scales", np.zeros(4), np.eye(4), np.eye(4), landmarks)
