"""Alignments and the covariance that they leave: NEES / 6 is 1 in every gauge for a right claim (10 s)."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from filters import Pose, nees
from filters.geometry import rotations
from stereo_slam_env.evaluation.gauges import carried, correlation_of, find_alignment, is_zero_at_start, own_gauge
from stereo_slam_env.recording.trajectory import Trajectory, tangent_jacobian, transformed

COUNT = 15
STEPS = [
    Pose([1.0, 0.1 * np.sin(k), 0.3 * np.cos(k)], rotations.exp_quaternion([0.2 * np.sin(k), 0.1, 0.3]))
    for k in range(COUNT - 1)
]
SIGMAS = 1e-4 * np.array([1.0, 1.2, 0.8, 0.2, 0.3, 0.25])
START = 1e-4 * np.array([5.0, 4.0, 6.0, 1.0, 1.2, 0.8])
"""m and rad: of a step in the body, of the first pose in the world. Small, so that what is left out is smaller."""


def chain(start, steps):
    poses = [start]
    for step in steps:
        poses.append(poses[-1] @ step)
    return Trajectory([T.position for T in poses], [T.orientation for T in poses], 0.5 * np.arange(COUNT))


TRUTH = chain(Pose(), STEPS)


def odometry(z, start=1.0, tangent="position-rotation"):
    """Dead reckoning with the errors `z` (COUNT, 6) times their deviations; what it claims of each pose is right."""
    first = Pose.exp(start * START * z[0]).inverse()
    found = chain(first, [T @ Pose.exp(SIGMAS * e).inverse() for T, e in zip(STEPS, z[1:], strict=True)])
    left, right = (tangent_jacobian(name, found.positions, found.orientations) for name in ("left", "right"))
    steps = transformed(left @ np.linalg.inv(right), np.tile(np.diag(SIGMAS**2), (COUNT, 1, 1)))
    steps[0] = np.diag((start * START) ** 2)
    J = tangent_jacobian(tangent, found.positions, found.orientations) @ np.linalg.inv(left)
    return replace(found, covariances=transformed(J, np.cumsum(steps, axis=0)), tangent=tangent)


def apart(z):
    """Errors of the poses that have nothing to do with each other."""
    factor = 1e-3 * np.random.default_rng(5).normal(size=(COUNT, 6, 6))
    e = (factor @ z[..., None])[..., 0]
    orientations = rotations.multiply(TRUTH.orientations, rotations.exp_quaternion(-e[:, 3:]))
    covariances = factor @ factor.swapaxes(1, 2)
    return replace(TRUTH, positions=TRUTH.positions - e[:, :3], orientations=orientations, covariances=covariances)


def cubature():
    """Points (2 n, COUNT, 6) whose mean is 0 and covariance 1, exactly: a mean over them has no chance in it."""
    n = 6 * COUNT
    return np.concatenate([np.eye(n), -np.eye(n)]).reshape(-1, COUNT, 6) * np.sqrt(n)


def left_of(estimate, kind, seconds, correlation, scale=1.0):
    """NEES / 6 of each pose after an alignment, by the carried covariance."""
    rows = TRUTH.timestamps <= seconds
    alignment = find_alignment(kind, estimate.moved(Pose(), 1.0 / scale), TRUTH, rows, 2)
    assert alignment.scale == pytest.approx(scale if kind == "sim3" else 1.0, rel=1e-2)
    aligned = alignment.apply(estimate.moved(Pose(), 1.0 / scale))
    errors = aligned.errors(TRUTH.positions, TRUTH.orientations)
    through = carried(aligned.covariances, aligned, alignment, correlation)
    return nees(errors, through) / 6.0


GAUGES = [
    *(("none", 9.0), ("start", 9.0), ("gravity-yaw", 0.0), ("gravity-yaw", 3.0), ("gravity-yaw", 9.0)),
    *(("rigid", 0.0), ("rigid", 3.0), ("rigid", 9.0), ("sim3", 3.0), ("sim3", 9.0)),
]
CLAIMS = {
    "odometry": (odometry, "increments"),
    "from a known start": (lambda z: odometry(z, start=0.0), "increments"),
    "left errors": (lambda z: odometry(z, tangent="left"), "increments"),
    "right errors": (lambda z: odometry(z, tangent="right"), "increments"),
    "independent errors": (apart, "independent"),
}


@cache
def estimates(claim):
    """One for each of the cubature's points."""
    return [CLAIMS[claim][0](z) for z in cubature()]


@pytest.mark.parametrize(("kind", "seconds"), GAUGES)
@pytest.mark.parametrize("claim", CLAIMS)
def test_a_right_claim_is_right_in_every_gauge(claim, kind, seconds):
    scale, correlation = 4.0 if kind == "sim3" else 1.0, CLAIMS[claim][1]
    values = np.array([left_of(each, kind, seconds, correlation, scale) for each in estimates(claim)])
    by_pose = values.mean(axis=0)[1:]  # the first one is fixed by some
    assert np.abs(by_pose - 1.0).max() < 0.03


@pytest.mark.parametrize(("kind", "seconds"), [gauge for gauge in GAUGES if gauge != ("gravity-yaw", 0.0)])
@pytest.mark.parametrize("correlation", ["independent", "increments"])
def test_the_carried_covariance_is_that_of_differences_of_the_alignment(correlation, kind, seconds):
    """Each error of each of eight poses by itself, through the alignment to the errors that are left of all of them."""
    rng, step = np.random.default_rng(1), 1e-6
    truth = TRUTH.rows(slice(0, 8))
    A = rng.normal(size=(8, 6, 6))
    own = np.cumsum(A @ A.swapaxes(1, 2), axis=0) if correlation == "increments" else A @ A.swapaxes(1, 2)
    whole = np.array([[own[min(j, k)] if correlation == "increments" or j == k else 0.0 * own[0] for k in range(8)]
                      for j in range(8)]).transpose(0, 2, 1, 3).reshape(48, 48)  # fmt: skip
    tangent = "left" if correlation == "increments" else "position-rotation"
    J = tangent_jacobian(tangent, truth.positions, truth.orientations)  # from errors of position and rotation

    def aligned(errors):
        e = np.linalg.solve(J, errors[..., None])[..., 0]
        turns = rotations.multiply(truth.orientations, rotations.exp_quaternion(-e[:, 3:]))
        estimate = replace(truth, positions=truth.positions - e[:, :3], orientations=turns, tangent=tangent)
        alignment = find_alignment(kind, estimate, truth, truth.timestamps <= seconds, 2)
        return alignment.apply(estimate), alignment

    columns = []
    for unit in np.eye(48).reshape(48, 8, 6):
        plus, minus = (aligned(sign * step * unit)[0].errors(truth.positions, truth.orientations) for sign in (1, -1))
        columns.append((plus - minus).ravel() / (2.0 * step))
    through = np.array(columns).T
    expected = (through @ whole @ through.T).reshape(8, 6, 8, 6)[np.arange(8), :, np.arange(8)]
    found, alignment = aligned(np.zeros((8, 6)))
    np.testing.assert_allclose(
        carried(own, found, alignment, correlation), expected, atol=1e-4 * np.abs(expected).max()
    )


def test_a_claim_says_itself_how_its_errors_are_correlated():
    z = np.zeros((COUNT, 6))
    assert correlation_of(odometry(z)) == correlation_of(odometry(z, start=0.0)) == "increments"
    assert correlation_of(apart(z)) == correlation_of(TRUTH) == "independent"
    for constant in (np.eye(6), np.diag([1.0, 1.0, 1.0, 1e-12, 1e-12, 1e-12])):
        claimed = replace(TRUTH, covariances=np.tile(constant, (COUNT, 1, 1)))
        assert correlation_of(claimed) == "independent"


def test_the_gauge_is_that_of_the_claim_and_of_the_header():
    z = np.zeros((COUNT, 6))
    known, open_ = odometry(z, start=0.0), odometry(z)
    assert is_zero_at_start(known)
    assert not is_zero_at_start(open_)
    for estimate, gauge, kind in (
        (known, None, "start"),
        (known, "fixed", "none"),
        (known, "se3", "start"),
        (open_, None, "none"),
        (open_, "se3", "rigid"),
        (open_, "gravity_yaw", "gravity-yaw"),
        (open_, "sim3", "sim3"),
    ):
        assert own_gauge(replace(estimate, gauge=gauge)) == kind


@pytest.mark.parametrize("up", [0, 1, 2])
@pytest.mark.parametrize("seconds", [0.0, 9.0])
def test_a_heading_is_turned_about_gravity_alone(up, seconds):
    turn = Pose([3.0, -2.0, 5.0], rotations.exp_quaternion(1.2 * np.eye(3)[up]))
    rows = TRUTH.timestamps <= seconds
    found = find_alignment("gravity-yaw", TRUTH.moved(turn), TRUTH, rows, up)
    np.testing.assert_allclose((found.T @ turn).log(), 0.0, atol=1e-9)
    tilted = TRUTH.moved(Pose(np.zeros(3), rotations.exp_quaternion([0.1, 0.1, 0.1])))
    turned = find_alignment("gravity-yaw", tilted, TRUTH, rows, up).T.log()[3:]
    np.testing.assert_allclose(np.delete(turned, up), 0.0, atol=1e-12)


def test_a_drive_along_gravity_has_no_heading():
    rise = replace(TRUTH, positions=np.outer(np.arange(COUNT), [0.0, 0.0, 1.0]))
    with pytest.raises(ValueError, match="does not determine a heading"):
        find_alignment("gravity-yaw", rise, rise, np.ones(COUNT, dtype=bool), 2)
