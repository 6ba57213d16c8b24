"""Clones of the pose: correlated copies that stay behind, and leave without a trace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from filters import ErrorDefinition, LeftInvariant, Pose, RightInvariant, Start, StereoEKF, StereoObservation, jacobian
from filters.geometry import rotations, symmetric
from filters.geometry.poses import relative_jacobian

from ..dense import constrained, gamma_of_variables, linearised, moved_by
from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, drive, run, start
from ..engine.linear_problems import assert_covariances_equal
from ..slots import ERRORS


def make(**options) -> StereoEKF:
    return start(StereoEKF(CAMERA, INDEPENDENT_PIXELS, **{"gate": None, **options}))


def driven(frames: list, clone_at: int | None = None, **options) -> StereoEKF:
    """A filter after a drive, with a clone of its pose at one frame."""
    slam = make(**options)
    for k, _ in enumerate(run(slam, frames)):
        if k == clone_at:
            slam.clone_pose("here")
    return slam


def test_a_clone_is_the_pose_of_its_instant() -> None:
    """P becomes J P J^T, where J repeats the rows of the pose."""
    slam = driven(drive(40, 5))
    pose, P, used = slam.pose, symmetric.full(slam.state.P), np.arange(len(slam.state.P))
    slam.clone_pose("here")
    belief = slam.belief("here")
    np.testing.assert_array_equal(belief.value, np.concatenate([pose.position, pose.orientation]))
    np.testing.assert_array_equal(belief.covariance, pose.covariance)
    rows = np.concatenate([used, slam.state.block_rows(slam.state.clones["here"].blocks)])
    repeated = np.concatenate([used, np.arange(6)])
    np.testing.assert_array_equal(symmetric.full(slam.state.P)[np.ix_(rows, rows)], P[np.ix_(repeated, repeated)])
    slam.predict(DT)
    np.testing.assert_array_equal(slam.belief("here").covariance, pose.covariance)
    assert np.abs(slam.pose.position - pose.position).max() > 0.1


def test_what_is_learnt_of_a_clone_is_what_a_dense_filter_learns() -> None:
    """Value and covariance of all, by F, H and R as whole matrices; errors are not transported with first estimates."""
    slam = make(error="first-estimates", landmark="euclidean", drop_unseen=False, gate=None)
    frames = drive(42, 10, visible=10, missed=0.0, depths=(15.0, 40.0))
    first = frames[0].observation
    slam.predict(DT)  # the velocity is not well known, and so the pose is not, either
    slam.update(first)
    slam.clone_pose("here")
    P, learnt = symmetric.full(slam.state.P), np.zeros(6)
    rows = slam.state.block_rows(slam.state.clones["here"].blocks)
    before = slam.belief("here")
    for frame in frames[1:]:
        before_it = slam.state
        step = slam.options.motion.predict(before_it.camera, DT, None)
        slam.predict(DT)
        seen = frame.observation.select(np.isin(frame.observation.ids, first.ids))
        linear = linearised(slam, seen)
        slam.update(seen)
        F, added = np.eye(len(P)), np.zeros_like(P)
        image = gamma_of_variables(before_it.layout, step.state)
        F[:12, :12] = constrained(step.F, image, before_it.predicted, before_it.layout)
        added[:12, :12] = step.G @ step.Q @ step.G.T
        P = F @ P @ F.T + added
        nu, H, R = linear.innovation.ravel(), linear.H.reshape(-1, len(P)), block_diag(*linear.R)
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        I_KH = np.eye(len(P)) - K @ H
        P = I_KH @ P @ I_KH.T + K @ R @ K.T
        learnt += (K @ nu)[rows]
    assert_covariances_equal(symmetric.full(slam.state.P), P, 1e-8)
    after = slam.belief("here")
    assert_covariances_equal(after.covariance, P[np.ix_(rows, rows)], 1e-8)
    np.testing.assert_allclose(after.value[:3] - before.value[:3], learnt[:3], rtol=0, atol=1e-10)
    assert np.abs(learnt).min() > 1e-9
    assert (np.diag(after.covariance) < np.diag(before.covariance)).all()


def test_names_of_clones_are_checked() -> None:
    slam = make()
    slam.clone_pose("here")
    for taken in ("here", "pose", "velocity"):
        with pytest.raises(ValueError, match=f"name must be new, there is a variable '{taken}' already"):
            slam.clone_pose(taken)
    with pytest.raises(ValueError, match="there is no clone 'her', did you mean 'here'"):
        slam.forget_clone("her")
    slam.reset()
    with pytest.raises(ValueError, match="there is no variable 'here'"):
        slam.belief("here")


@pytest.mark.parametrize("error", ERRORS)
def test_the_relative_pose_is_that_of_both_with_their_correlation(error: str) -> None:
    """At the clone's own instant it is known; later its covariance is that of errors drawn from the joint one."""
    slam = driven(drive(44, 5), error=error)
    slam.clone_pose("here")
    there = slam.relative_pose("here")
    np.testing.assert_allclose(there.position, 0.0, atol=1e-12)
    np.testing.assert_allclose(there.covariance, 0.0, atol=1e-15)
    for _ in range(3):
        slam.predict(DT)
    clone, pose, moved = slam.belief("here").value, slam.pose, slam.relative_pose("here")
    first, last = Pose(clone[:3], clone[3:]), Pose(pose.position, pose.orientation)
    np.testing.assert_allclose((first @ Pose(moved.position, moved.orientation)).position, last.position, atol=1e-12)
    state = slam.state
    rows = np.concatenate([state.block_rows(state.clones["here"].blocks), np.arange(6)])
    joint = symmetric.full(symmetric.rows(state.P, rows)[:, rows])

    def error_of(delta: np.ndarray) -> np.ndarray:
        a, b = (
            Pose(T.position + d[:3], rotations.multiply(T.orientation, rotations.exp_quaternion(d[3:])))
            for T, d in ((first, delta[:6]), (last, delta[6:]))
        )
        T = a.inverse() @ b
        return np.concatenate(
            [T.position - moved.position, 2.0 * rotations.between(moved.orientation, T.orientation)[:3]]
        )

    J = jacobian(error_of, 12)
    np.testing.assert_allclose(relative_jacobian(first, last), J, rtol=0, atol=1e-8)
    np.testing.assert_allclose(moved.covariance, J @ joint @ J.T, rtol=1e-6, atol=1e-12)
    with pytest.raises(ValueError, match="there is no clone 'gone'"):
        slam.relative_pose("gone")


@pytest.mark.parametrize("error", ["right-invariant", RightInvariant(reset=True), LeftInvariant()], ids=repr)
def test_a_large_correction_of_a_clone_carries_p_as_its_error_says(error: str | ErrorDefinition) -> None:
    """Clone and camera, turned in general position, are corrected by some tenths of a radian."""
    rng = np.random.default_rng(7)
    slam = make(error=error)
    turned = Rotation.from_rotvec([0.4, -0.9, 0.3]).as_quat()
    slam.reset(Start((1.0, 2.0, -3.0), turned, (0.5, 0.1, 4.0), covariance=np.diag(np.repeat([4.0, 0.3], 6))))
    slam.update(StereoObservation(np.arange(3), [[500.0, 150.0, 20.0], [900.0, 250.0, 9.0], [700.0, 100.0, 40.0]]))
    slam.predict(DT)
    slam.clone_pose("here")
    before, H, R = slam.state, rng.standard_normal((4, 6)), 0.01 * np.eye(4)
    P, rows = symmetric.full(before.P), before.block_rows(before.clones["here"].blocks)
    nu = 0.3 * rng.standard_normal(4)
    K = P[:, rows] @ H.T @ np.linalg.inv(H @ P[np.ix_(rows, rows)] @ H.T + R)
    delta = K @ nu
    slam.correct(nu, {"here": H}, R)
    same, carried = make(error=error), []
    for left in (P - K @ H @ P[rows] + np.eye(len(P)), np.eye(len(P))):  # its own has no factor: the clone is a copy
        same.state = replace(before, P=np.asfortranarray(left))
        moved, there = moved_by(same, delta)
        carried.append(there)
    carried = carried[0] - carried[1]
    assert_covariances_equal(symmetric.full(slam.state.P), carried, 1e-6)
    clone = moved.clones["here"]
    np.testing.assert_allclose(slam.belief("here").value, [*clone.position, *clone.orientation], rtol=0, atol=1e-8)
    assert np.abs(delta[rows]).max() > 0.1


def test_a_jacobian_may_be_by_several_variables_together() -> None:
    """As by each of them alone, bit for bit."""
    rng, frames, ends = np.random.default_rng(5), drive(41, 6), []
    H, nu = rng.standard_normal((4, 12)), 0.01 * rng.standard_normal(4)
    for given in ({("here", "pose"): H}, {"here": H[:, :6], "pose": H[:, 6:]}):
        slam = driven(frames, clone_at=2)
        assert slam.correct(nu, given, np.eye(4)).used
        ends.append(np.concatenate([slam.pose.position, slam.belief("here", "pose").covariance.ravel()]))
    np.testing.assert_array_equal(*ends)
    with pytest.raises(ValueError, match=r"^there is no variable 'there'"):
        slam.correct(nu, {("pose", "there"): H}, np.eye(4))
