"""The motion of the camera, in spite of landmarks that move (< 1 s)."""

import numpy as np
import pytest

from filters import StereoNoise, StereoObservation
from filters.geometry import rotations
from stereo_slam_env.frontend.ego_motion import (
    Pairs,
    Step,
    chained,
    left_pixel_step,
    most_likely_step,
    perspective_n_point,
    predicted,
    robust_step,
    squared_distances,
    transfer,
)

from .synthetic_steps import CAMERA, STEP, Cloud

REST = Step(np.eye(3), np.zeros(3))


def error(step):
    return np.concatenate([step.t - STEP.t, rotations.log(STEP.R.T @ step.R)])


@pytest.mark.parametrize("start", [STEP, REST, None], ids=["right start", "start at rest", "no start"])
@pytest.mark.parametrize("moved", [0, 16, 30])
def test_the_step_comes_from_what_stands_still(start, moved):
    pairs = Cloud(moved=moved).pairs()
    found = robust_step(CAMERA, pairs, start)
    e = error(found.step)
    assert e @ np.linalg.solve(found.estimate.covariance, e) < 22.5  # chi-square with 6: 0.999
    assert not found.inliers[:moved].any()
    assert found.inliers[moved:].mean() > 0.95


def test_its_covariance_is_honest():
    normalised = []
    for seed in range(60):
        found = robust_step(CAMERA, Cloud(moved=10, seed=seed).pairs(), REST)
        e = error(found.step)
        normalised.append(e @ np.linalg.solve(found.estimate.covariance, e) / 6)
    assert 0.75 < np.mean(normalised) < 1.35  # mean of 60 chi-squares with 6, over 6; the gate trims a little


def test_chaining_carries_points_through_both_cameras():
    p_3 = np.array([1.0, -0.5, 12.0])
    other = Step(rotations.exp([0.1, -0.2, 0.05]), np.array([0.3, 0.1, 0.5]))
    p_2 = other.R @ p_3 + other.t
    both = chained(STEP, other)
    np.testing.assert_allclose(both.R @ p_3 + both.t, STEP.R @ p_2 + STEP.t, atol=1e-12)


def test_predicted_measurements_and_their_covariance():
    pairs = Cloud(count=400, sigma=0.3).pairs()
    sigmas = np.array([0.03, 0.03, 0.03, 0.004, 0.004, 0.004])
    rng = np.random.default_rng(3)
    values = []
    for _ in range(40):
        wrong = STEP.moved(sigmas * rng.standard_normal(6))
        uvd, covariance, in_front = predicted(CAMERA, pairs.first, pairs.R_first, wrong, np.diag(sigmas**2))
        assert in_front.all()
        nu = pairs.second - uvd
        S = covariance + pairs.R_second
        values.append(np.mean(np.einsum("ni,ni->n", nu, np.linalg.solve(S, nu[..., None])[..., 0])) / 3)
    # The error of the step is common to all landmarks of a try, so only the mean over tries is near 1.
    assert 0.7 < np.mean(values) < 1.4
    assert (squared_distances(CAMERA, pairs, STEP) < 30).all()


# --- in numbers ------------------------------------------------------------------------------------------------------


def carried(uvd, step):
    """Measurements of the second frame by points."""
    return CAMERA.project((CAMERA.backproject(uvd) - step.t) @ step.R)


def test_derivatives_of_carried_measurements_are_those_of_differences():
    uvd = Cloud(count=5).pairs().first
    found, h = transfer(CAMERA, uvd, STEP), 1e-6
    np.testing.assert_allclose(found.uvd, carried(uvd, STEP), rtol=1e-12)
    assert found.in_front.all()
    assert not transfer(CAMERA, uvd, Step(np.eye(3), np.array([0.0, 0.0, 100.0]))).in_front.any()
    for axis, unit in enumerate(np.eye(6)):
        by_step = (carried(uvd, STEP.moved(h * unit)) - carried(uvd, STEP.moved(-h * unit))) / (2.0 * h)
        np.testing.assert_allclose(found.by_step[:, :, axis], by_step, rtol=1e-5, atol=1e-4)
    for axis, unit in enumerate(np.eye(3)):
        by_first = (carried(uvd + h * unit, STEP) - carried(uvd - h * unit, STEP)) / (2.0 * h)
        np.testing.assert_allclose(found.by_first[:, :, axis], by_first, rtol=1e-5, atol=1e-6)


def test_what_is_exact_gives_the_step_exactly_and_its_likelihood_nothing_to_add():
    pairs = Cloud(count=20, sigma=0.0).pairs()
    R = np.tile(0.04 * np.array([[1.0, 0.2, 0.6], [0.2, 1.0, 0.1], [0.6, 0.1, 2.0]]), (20, 1, 1))
    pairs = Pairs(pairs.first, pairs.second, R, 2.0 * R)
    found = most_likely_step(CAMERA, pairs, REST)
    np.testing.assert_allclose(error(found.step), 0.0, atol=1e-9)
    assert (found.nis, found.nis_dof) == (pytest.approx(0.0, abs=1e-9), 54)
    exact = transfer(CAMERA, pairs.first, STEP)
    S = 2.0 * R + exact.by_first @ R @ exact.by_first.transpose(0, 2, 1)
    information = np.einsum("mji,mjk->ik", exact.by_step, np.linalg.solve(S, exact.by_step))
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information), rtol=1e-6)
    np.testing.assert_allclose(squared_distances(CAMERA, pairs, STEP), 0.0, atol=1e-12)
    off = np.array([0.3, -0.2, 0.1])
    wrong = Pairs(pairs.first, pairs.second + off, R, 2.0 * R)
    expected = np.einsum("i,mi->m", off, np.linalg.solve(S, np.tile(off, (20, 1))[..., None])[..., 0])
    np.testing.assert_allclose(squared_distances(CAMERA, wrong, STEP), expected, rtol=1e-9)
    behind = Step(np.eye(3), np.array([0.0, 0.0, 100.0]))
    assert np.isinf(squared_distances(CAMERA, pairs, behind)).all()


def test_the_error_of_a_step_is_the_gain_times_the_noise():
    """To first order: -sum K (n_second - A n_first); also of the step of the least squares of left pixels."""
    exact, rng = Cloud(count=25, sigma=0.0).pairs(), np.random.default_rng(0)
    R = np.tile(1e-6 * np.eye(3), (25, 1, 1))
    n_first, n_second = 1e-3 * rng.standard_normal((2, 25, 3))
    noisy = Pairs(exact.first + n_first, exact.second + n_second, R, R)
    found = most_likely_step(CAMERA, noisy, STEP)
    innovations = n_second - np.einsum("mij,mj->mi", found.by_first, n_first)
    moved = np.concatenate([found.step.t - STEP.t, rotations.log(STEP.R.T @ found.step.R)])
    np.testing.assert_allclose(np.einsum("mij,mj->i", found.gain, innovations), moved, rtol=0.02, atol=1e-8)
    left = left_pixel_step(CAMERA, exact, STEP)
    H = transfer(CAMERA, exact.first, STEP).by_step[:, :2].reshape(-1, 6)
    np.testing.assert_allclose(left.gain[:, :, :2].transpose(1, 0, 2).reshape(6, -1), np.linalg.pinv(H), rtol=1e-6)
    assert not left.gain[:, :, 2].any()
    with_R = left_pixel_step(CAMERA, Pairs(exact.first, exact.second, 0.0 * R, R), STEP)
    np.testing.assert_allclose(with_R.covariance, 1e-6 * np.linalg.inv(H.T @ H), rtol=1e-6)


@pytest.mark.parametrize("polished", [False, True])
def test_pnp_finds_the_step_and_who_agrees_with_it(polished):
    pairs = Cloud(count=60, moved=15, sigma=0.1).pairs()
    step, inliers = perspective_n_point(CAMERA, pairs, 8, polished=polished)
    np.testing.assert_allclose(error(step), 0.0, atol=0.02)
    assert (np.diff(inliers) > 0).all()
    assert set(inliers.tolist()) <= set(range(15, 60))
    assert len(inliers) >= 38
    assert perspective_n_point(CAMERA, pairs, 61) is None


@pytest.mark.parametrize(("count", "found"), [(7, False), (8, True)])
def test_eight_pairs_are_enough(count, found):
    pairs = Cloud(count=count, sigma=0.05).pairs()
    assert (robust_step(CAMERA, pairs, STEP) is not None) == found


def test_pairs_are_those_that_both_frames_have():
    R = np.arange(1.0, 4.0)[:, None, None] * np.eye(3)
    first = StereoObservation([2, 5, 9], np.arange(9.0).reshape(3, 3) + 1.0, R=R)
    second = StereoObservation([5, 7, 9], np.arange(9.0).reshape(3, 3) + 20.0)
    pairs = Pairs.between(first, second, StereoNoise.diagonal(2.0, 2.0, 2.0))
    assert len(pairs) == 2
    np.testing.assert_array_equal(pairs.first, first.uvd[1:])
    np.testing.assert_array_equal(pairs.second, second.uvd[[0, 2]])
    np.testing.assert_array_equal(pairs.R_first, R[1:])
    np.testing.assert_array_equal(pairs.R_second, np.tile(4.0 * np.eye(3), (2, 1, 1)))
    assert len(pairs.select(np.array([True, False]))) == 1
