"""Noise models draw what their declared R says."""

import numpy as np
import pytest

from filters.contract.noise import StereoNoise
from stereo_slam_env.sensing.corruptions import (
    MATCHING_SIGMA,
    NOISE_MODELS,
    HeavyTailedPixels,
    IndependentPixels,
    IndependentUvd,
    QuantisedPixels,
    matching_errors,
)

COUNT = 400_000


@pytest.mark.parametrize("name", NOISE_MODELS)
def test_sample_covariance_is_the_declared_one(name):
    model = NOISE_MODELS[name](0.7)
    true = np.tile([100.0, 50.0, 12.0], (COUNT, 1))
    errors = model.corrupt(true, np.random.default_rng(0))[0] - true
    np.testing.assert_allclose(errors.mean(axis=0), 0, atol=6 * 1.0 / np.sqrt(COUNT))
    standard_error = (errors[:, :, None] * errors[:, None, :]).std(axis=0) / np.sqrt(COUNT)
    assert (np.abs(np.cov(errors.T) - model.stereo_noise.R) < 4.0 * standard_error).all()
    assert standard_error.max() < (0.008 if name == "heavy-tailed" else 0.003)


@pytest.mark.parametrize("name", NOISE_MODELS)
@pytest.mark.parametrize("sigma", [0.01, 2.0])
def test_no_error_is_as_large_as_the_largest(name, sigma):
    model = NOISE_MODELS[name](sigma)
    true = np.random.default_rng(1).uniform(10.0, 90.0, (100_000, 3))
    errors = model.corrupt(true, np.random.default_rng(0))[0] - true
    assert np.abs(errors).max() < model.largest_error


def test_the_largest_error_is_that_of_ten_standard_deviations_or_of_the_farthest_mismatch():
    """Bounds of the observation rest on it: a wider one makes learners' numbers smaller."""
    sizes = {model(0.5).largest_error for model in (IndependentPixels, IndependentUvd)}
    assert (sizes, HeavyTailedPixels(0.5).largest_error, QuantisedPixels(0.5).largest_error) == ({5.0}, 10.0, 6.0)


def test_independent_pixels_measures_a_right_row_of_its_own():
    model = IndependentPixels(0.7)
    true = np.tile([100.0, 50.0, 12.0], (COUNT, 1))
    uvd, v_right = model.corrupt(true, np.random.default_rng(0))
    errors = np.column_stack([uvd[:, 0] - 100, uvd[:, 1] - 50, uvd[:, 0] - uvd[:, 2] - 88, v_right - 50])
    np.testing.assert_allclose(np.cov(errors.T), 0.49 * np.eye(4), atol=0.01)
    assert model.stereo_noise == StereoNoise.independent_pixels(0.7)


def test_independent_uvd_has_no_right_row():
    assert IndependentUvd(0.7).corrupt(np.zeros((3, 3)), np.random.default_rng(0))[1] is None


def test_heavy_tails_are_the_mixture_that_was_measured():
    drawn = np.abs(matching_errors(np.random.default_rng(0), (COUNT,)))
    # Within 0.14 px: 95.45 % of the sharp Gaussian, 24.4 % of the blunt one, 0.7 % of the uniform part.
    assert np.mean(drawn < 0.14) == pytest.approx(0.60 * 0.9545 + 0.36 * 0.2443 + 0.04 * 0.007, abs=0.003)
    # Beyond 2 px there is only the uniform part: 4 % over 20 px.
    assert np.mean(drawn > 2.0) == pytest.approx(0.04 * 0.9, abs=0.002)
    assert drawn.max() <= 20.0
    assert np.median(drawn) == pytest.approx(0.09, abs=0.01)
    assert pytest.approx(2.326, abs=0.001) == MATCHING_SIGMA


def test_heavy_tails_have_the_covariance_of_independent_pixels_and_their_size_as_measured():
    assert HeavyTailedPixels(0.7).stereo_noise == IndependentPixels(0.7).stereo_noise
    as_measured = HeavyTailedPixels(MATCHING_SIGMA)
    uvd, v_right = as_measured.corrupt(np.zeros((1000, 3)), np.random.default_rng(0))
    errors = matching_errors(np.random.default_rng(0), (4, 1000))
    np.testing.assert_allclose([uvd[:, 0], uvd[:, 1], uvd[:, 0] - uvd[:, 2], v_right], errors, atol=1e-12)


def test_quantised_measurements_are_whole_pixels_and_their_covariance_holds_without_other_noise():
    """Rounding alone: uniform errors of 1/12 px^2, where landmarks fall anywhere between pixels."""
    rng = np.random.default_rng(0)
    true = rng.uniform([100.0, 50.0, 5.0], [900.0, 300.0, 60.0], (COUNT, 3))
    model = QuantisedPixels(1e-6)
    uvd, v_right = model.corrupt(true, rng)
    np.testing.assert_array_equal(uvd, np.rint(uvd))
    np.testing.assert_array_equal(v_right, uvd[:, 1])  # the rows are the same, and so is their rounding
    np.testing.assert_allclose(np.cov((uvd - true).T), model.stereo_noise.R, atol=0.001)
    np.testing.assert_allclose(model.stereo_noise.R[0, 0], 1.0 / 12.0, rtol=1e-9)
