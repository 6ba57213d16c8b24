"""R of (u, v, d)."""

from __future__ import annotations

import json

import numpy as np
import pytest

from filters import ColouredNoise, LandmarkDrift, StereoNoise


def test_independent_pixels_is_the_covariance_of_d_equal_to_left_minus_right() -> None:
    """Against samples of u_left, v, u_right with equal independent errors."""
    u, v, u_right = 0.7 * np.random.default_rng(0).standard_normal((3, 400_000))
    np.testing.assert_allclose(StereoNoise.independent_pixels(0.7).R, np.cov([u, v, u - u_right]), atol=0.005)


def test_diagonal_takes_standard_deviations() -> None:
    np.testing.assert_array_equal(StereoNoise.diagonal(1, 2, 3).R, np.diag([1.0, 4.0, 9.0]))


def test_equal_noises_are_equal_and_hash_alike() -> None:
    assert StereoNoise.diagonal(1, 1, 1) == StereoNoise(np.eye(3))
    assert hash(StereoNoise.diagonal(1, 1, 1)) == hash(StereoNoise(np.eye(3)))
    assert StereoNoise.diagonal(1, 1, 1) != StereoNoise.independent_pixels(1.0)


def test_r_is_a_read_only_copy() -> None:
    R = np.eye(3)
    noise = StereoNoise(R)
    R[0, 0] = 7.0
    assert noise.R[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        noise.R[0, 0] = 7.0


@pytest.mark.parametrize(
    ("R", "message"),
    [
        (np.eye(2), r"R must have shape \(3, 3\)"),
        (np.diag([1.0, 1.0, 0.0]), "R must be positive definite"),
        (np.diag([1.0, 1.0, -1.0]), "R must be positive definite"),
        (np.eye(3) + np.eye(3, k=1), "R must be symmetric"),
        (np.full((3, 3), np.nan), "R must be finite"),
        ("one", "R must be numeric"),
    ],
)
def test_what_is_no_covariance_is_refused(R: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        StereoNoise(R)


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan, np.inf])
def test_standard_deviations_must_be_positive(sigma: float) -> None:
    with pytest.raises(ValueError, match="sigma must be"):
        StereoNoise.independent_pixels(sigma)
    with pytest.raises(ValueError, match="sigma_v must be"):
        StereoNoise.diagonal(1.0, sigma, 1.0)


def test_coloured_noise_is_made_again_of_its_parts() -> None:
    """Also of those that JSON has kept, whose tuples are lists."""
    noise = ColouredNoise(
        np.eye(3), 0.1 * np.eye(3), LandmarkDrift(0.2, (1.0, 0.8, 0.3), (0.4, 0.4, 0.2)), 0.004, 0.005
    )
    assert ColouredNoise(noise.R, **json.loads(json.dumps(noise.parts))) == noise
    assert noise != StereoNoise(noise.R)
    assert ColouredNoise(noise.R, **{**noise.parts, "gauge_walk": 0.0}) != noise


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ({"white": np.zeros((3, 3))}, "white must be positive definite"),
        ({"gauge_walk": -1.0}, "gauge_walk must be"),
        ({"misalignment": np.nan}, "misalignment must be"),
        ({"disparity_offset": -0.1}, "disparity_offset must be"),
        ({"drift": {"pixels": (1.0, 1.0, -1.0)}}, "pixels of drift must be"),
    ],
)
def test_impossible_parts_are_refused(parts: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ColouredNoise(np.eye(3), **parts)
