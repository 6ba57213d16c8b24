"""Intervals hold what they promise (2 s); those over the frames of one run are in `test_trajectory_score.py`."""

from itertools import product

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.differences import level
from stereo_slam_env.evaluation.bands import rms_ratio_interval, studentised_interval

DRAWS = {
    "normal": lambda rng, shape: rng.standard_normal(shape),
    "heavy-tailed": lambda rng, shape: rng.standard_t(3, shape),
    "contaminated": lambda rng, shape: rng.standard_normal(shape) * np.where(rng.random(shape) < 0.1, 10.0, 1.0),
}


@pytest.mark.parametrize("draw", DRAWS)
@pytest.mark.parametrize("count", [8, 10, 20, 50])
def test_an_interval_holds_the_truth_in_at_least_93_of_100_cases(draw, count):
    data = DRAWS[draw](np.random.default_rng(count), (count, 400))
    low, high = studentised_interval(data, 0.95)
    assert np.mean((low <= 0.0) & (high >= 0.0)) >= 0.93


@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_an_interval_is_halls_symmetric_studentised_one(confidence):
    """Written out with other random numbers: |mean* - mean| / error* of 200,000 resamples of nine rows."""
    data = np.random.default_rng(3).gamma(2.0, size=9)
    resamples = data[np.random.default_rng(4).integers(9, size=(200_000, 9))]
    errors = resamples.std(axis=1, ddof=1) / 3.0
    ratios = np.abs(resamples.mean(axis=1) - data.mean()) / np.where(errors > 1e-9, errors, np.inf)
    half = np.quantile(ratios, confidence) * data.std(ddof=1) / 3.0
    low, high = studentised_interval(data[:, None], confidence)
    assert float(high[0] + low[0]) / 2 == pytest.approx(data.mean(), rel=1e-12)
    assert float(high[0] - low[0]) / 2 == pytest.approx(half, rel=0.03)  # without ddof: 0.06 less


def test_resamples_of_a_single_row_count_as_no_shift():
    """Of the 27 equally likely resamples of three rows, three: the others are enumerated."""
    data = np.array([0.0, 1.0, 4.0])
    resamples = data[np.array(list(product(range(3), repeat=3)))]
    errors = resamples.std(axis=1, ddof=0) / np.sqrt(2.0)
    shifts = np.abs(resamples.mean(axis=1) - data.mean())
    ratios = np.divide(shifts, errors, out=np.zeros(27), where=errors > 1e-9)
    low, high = studentised_interval(data[:, None], 0.9)
    wanted = np.quantile(ratios, 0.9, method="inverted_cdf") * data.std(ddof=1) / np.sqrt(3.0)
    assert float(high[0] - low[0]) / 2 == pytest.approx(wanted, rel=1e-6)


def test_an_interval_for_many_comparisons_holds_for_all_of_them_together():
    data = DRAWS["heavy-tailed"](np.random.default_rng(5), (10, 12 * 60))
    low, high = studentised_interval(data, level(12))
    assert np.all(((low <= 0.0) & (high >= 0.0)).reshape(12, 60), axis=0).mean() >= 0.93


def test_same_seed_same_interval_and_a_column_does_not_depend_on_the_others():
    data = DRAWS["normal"](np.random.default_rng(6), (10, 3))
    once, again = studentised_interval(data, 0.95), studentised_interval(data, 0.95)
    assert np.array_equal(once, again)
    np.testing.assert_allclose(
        np.array(studentised_interval(data[:, 1:2], 0.95))[:, 0], np.array(once)[:, 1], rtol=1e-9
    )
    assert not np.array_equal(once, studentised_interval(data, 0.95, seed=1))


def test_the_interval_of_a_ratio_holds_that_of_the_root_mean_squares():
    rng = np.random.default_rng(0)
    first = rng.uniform(0.05, 0.1, 10)
    assert rms_ratio_interval(first, 2.0 * first) == pytest.approx((0.5, 0.5))
    inside = 0
    for _ in range(100):
        second = 0.08 * np.sqrt(rng.chisquare(6, 20) / 6)
        low, high = rms_ratio_interval(np.full(20, 0.08), second)
        assert 0 < low < high < 2
        inside += low <= 1 <= high
    assert 85 <= inside <= 99
