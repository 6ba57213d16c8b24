"""Effects of crossed factors, from data with known ones (< 2 s)."""

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.effects import fit_factorial

A = np.array([-0.2, 0.5, -0.3])
B = np.array([0.4, -0.4])
AB = np.array([[0.1, -0.1], [-0.3, 0.3], [0.2, -0.2]])


def values(seeds=8, scatter=0.0, rng=None):
    """Block + A + B + AB (+ noise), three levels by two by two; the third factor does nothing."""
    rng = rng or np.random.default_rng(0)
    made = 5.0 * rng.standard_normal(seeds) + (A[:, None] + B + AB)[:, :, None, None] + np.zeros((3, 2, 2, seeds))
    return made + scatter * rng.standard_normal(made.shape)


def test_known_effects_come_out_exactly_whatever_the_blocks():
    fit = fit_factorial(values())
    np.testing.assert_allclose(fit.blocks[0,], np.tile(A, (8, 1)), atol=1e-12)
    np.testing.assert_allclose(fit.blocks[1,], np.tile(B, (8, 1)), atol=1e-12)
    np.testing.assert_allclose(fit.blocks[0, 1], np.tile(AB, (8, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(fit.blocks[2,], 0.0, atol=1e-12)
    assert fit.left_out == ()


def test_shares_are_those_of_the_analysis_of_variance():
    fit = fit_factorial(values())
    parts = {(0,): np.mean(A**2), (1,): np.mean(B**2), (0, 1): np.mean(AB**2), (2,): 0.0, (0, 2): 0.0, (1, 2): 0.0}
    for term, part in parts.items():
        assert fit.shares[term] == pytest.approx(part / sum(parts.values()), abs=1e-12)
    assert fit.rest == pytest.approx(0.0, abs=1e-12)


def test_shares_do_not_depend_on_how_large_the_effects_are():
    whole, small = fit_factorial(values(scatter=0.3)), fit_factorial(1e-3 * values(scatter=0.3))
    assert small.shares == pytest.approx(whole.shares, rel=1e-9)
    assert small.rest == pytest.approx(whole.rest, rel=1e-9)


def test_with_all_values_a_block_is_fitted_by_itself():
    data = values(scatter=0.3)
    together, alone = fit_factorial(data), [fit_factorial(data[..., s : s + 1]) for s in range(8)]
    for term in ((0,), (0, 1), (1, 2)):
        np.testing.assert_allclose(together.blocks[term], [fit.blocks[term][0] for fit in alone], atol=1e-12)


def test_the_mean_over_blocks_is_least_squares_although_values_are_missing():
    rng = np.random.default_rng(1)
    data = values(scatter=0.3, rng=rng)
    data[rng.random(data.shape) < 0.15] = np.nan
    fit = fit_factorial(data)
    # The same by brute force: dummy variables for blocks and cells of A x B, A x C and B x C.
    at = np.argwhere(np.isfinite(data))
    coding = {3: np.vstack([np.eye(2), -np.ones(2)]), 2: np.array([[1.0], [-1.0]])}
    a, b, c = coding[3][at[:, 0]], coding[2][at[:, 1]], coding[2][at[:, 2]]
    design = np.hstack([np.eye(8)[at[:, 3]], a, b, c, a * b, a * c, b * c])
    expected = np.linalg.lstsq(design, data[tuple(at.T)], rcond=None)[0][8:]
    np.testing.assert_allclose(fit.blocks[0,].mean(axis=0)[:2], expected[:2], atol=1e-9)
    np.testing.assert_allclose(fit.blocks[0, 1].mean(axis=0)[:2, 0], expected[4:6], atol=1e-9)


def test_effects_survive_missing_combinations_and_blocks():
    data = values()
    data[0, 0, 0, :] = np.nan
    data[2, 1, 1, :5] = np.nan
    data[..., 7] = np.nan
    fit = fit_factorial(data)
    np.testing.assert_allclose(fit.blocks[0,].mean(axis=0), A, atol=1e-9)
    np.testing.assert_allclose(fit.blocks[0, 1].mean(axis=0), AB, atol=1e-9)
    assert len(fit.blocks[0,]) == 7


def test_an_interaction_with_an_empty_cell_is_left_out():
    data = values()
    data[1, 1] = np.nan
    fit = fit_factorial(data)
    assert fit.left_out == ((0, 1),)
    assert (0, 1) not in fit.blocks
    assert (0, 2) in fit.blocks


def test_factors_that_cannot_be_told_apart_are_refused():
    data = np.full((2, 2, 5), np.nan)
    data[0, 0], data[1, 1] = 1.0, 2.0
    with pytest.raises(ValueError, match="the effects of the factors cannot be told apart"):
        fit_factorial(data)
