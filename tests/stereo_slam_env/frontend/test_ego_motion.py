"""The motion of the camera, in spite of landmarks that move (< 1 s)."""

import numpy as np
import pytest

from filters.geometry import rotations
from stereo_slam_env.frontend.ego_motion import Step, chained, continued, predicted, robust_step, squared_distances

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


def test_too_few_pairs_tell_nothing():
    assert robust_step(CAMERA, Cloud(count=7).pairs(), STEP) is None


def test_half_a_step_twice_is_the_step():
    half = continued(STEP, 0.5)
    both = chained(half, half)
    np.testing.assert_allclose(both.R, STEP.R, atol=1e-12)
    # The translation is along a straight line in the first camera, so two halves agree to the turn within a step.
    np.testing.assert_allclose(both.t, STEP.t, atol=0.02)


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
