"""Chi-square bands and NEES (0.2 s)."""

import numpy as np
import pytest

from filters.checks.consistency import nees
from stereo_slam_env.evaluation.bands import mean_band, share_inside


def test_the_band_of_50_poses_is_the_published_one():
    low, high = mean_band(6, 50)
    assert (low / 6, high / 6) == pytest.approx((0.846, 1.166), abs=2e-3)


@pytest.mark.parametrize(("dof", "runs", "probability"), [(1, 1, 0.95), (6, 10, 0.95), (3, 4, 0.8), (12, 25, 0.99)])
def test_the_band_holds_its_share_of_true_means(dof, runs, probability):
    rng = np.random.default_rng(5)
    means = rng.chisquare(dof, (20_000, runs)).mean(axis=1)
    band = mean_band(dof, runs, probability)
    assert share_inside(means, band) == pytest.approx(probability, abs=0.007)
    below, above = np.mean(means < band[0]), np.mean(means > band[1])
    assert below == pytest.approx(above, abs=0.007)


@pytest.mark.parametrize(
    ("arguments", "complaint"), [((0, 5), "dof"), ((6, 0), "runs"), ((6, 5, 1.0), "probability"), ((6, 5, 0), "probab")]
)
def test_impossible_bands_are_refused(arguments, complaint):
    with pytest.raises(ValueError, match=complaint):
        mean_band(*arguments)


def test_nees_of_errors_drawn_from_their_covariance_averages_to_the_dof():
    rng = np.random.default_rng(1)
    factors = rng.standard_normal((4000, 6, 6))
    errors = np.einsum("kij,kj->ki", factors, rng.standard_normal((4000, 6)))
    assert nees(errors, factors @ factors.transpose(0, 2, 1)).mean() == pytest.approx(6.0, abs=0.2)


def test_nees_is_unknown_where_the_covariance_is_no_covariance():
    covariances = np.array([np.eye(2), np.diag([1.0, 0.0]), np.diag([1.0, -1.0]), np.full((2, 2), np.nan)])
    np.testing.assert_array_equal(nees(np.ones((4, 2)), covariances), [2.0, np.nan, np.nan, np.nan])


def test_share_inside_counts_finite_values_only():
    assert share_inside(np.array([1.0, 2.0, 3.0, np.nan]), (1.5, 3.0)) == pytest.approx(2 / 3)
    assert share_inside(np.array([np.nan, 0.5]), (0.0, 1.0)) == 1.0
    assert np.isnan(share_inside(np.array([np.nan]), (0.0, 1.0)))
