"""Noise models draw what their declared R says."""

import numpy as np
import pytest

from filters.noise import StereoNoise
from stereo_slam_env.sensing.pixel_noise import NOISE_MODELS, IndependentPixels, IndependentUvd

COUNT = 200_000


@pytest.mark.parametrize("name", NOISE_MODELS)
def test_sample_covariance_is_the_declared_one(name):
    model = NOISE_MODELS[name](0.7)
    true = np.tile([100.0, 50.0, 12.0], (COUNT, 1))
    errors = model.corrupt(true, np.random.default_rng(0))[0] - true
    np.testing.assert_allclose(errors.mean(axis=0), 0, atol=6 * 1.0 / np.sqrt(COUNT))
    np.testing.assert_allclose(np.cov(errors.T), model.stereo_noise.R, atol=0.01)


def test_independent_pixels_measures_a_right_row_of_its_own():
    model = IndependentPixels(0.7)
    true = np.tile([100.0, 50.0, 12.0], (COUNT, 1))
    uvd, v_right = model.corrupt(true, np.random.default_rng(0))
    errors = np.column_stack([uvd[:, 0] - 100, uvd[:, 1] - 50, uvd[:, 0] - uvd[:, 2] - 88, v_right - 50])
    np.testing.assert_allclose(np.cov(errors.T), 0.49 * np.eye(4), atol=0.01)
    assert model.stereo_noise == StereoNoise.independent_pixels(0.7)


def test_independent_uvd_has_no_right_row():
    model = IndependentUvd(0.7)
    assert model.corrupt(np.zeros((3, 3)), np.random.default_rng(0))[1] is None
    assert model.stereo_noise == StereoNoise.diagonal(0.7, 0.7, 0.7)
