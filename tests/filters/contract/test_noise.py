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


def test_equal_noises_are_equal_and_hash_alike() -> None:
    assert StereoNoise.diagonal(1, 2, 3) == StereoNoise(np.diag([1.0, 4.0, 9.0]))
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
    ("make", "message"),
    [
        (lambda: StereoNoise(np.eye(2)), r"R must have shape \(3, 3\)"),
        (lambda: StereoNoise(np.diag([1.0, 1.0, 0.0])), "R must be positive definite"),
        (lambda: StereoNoise(np.diag([1.0, 1.0, -1.0])), "R must be positive definite"),
        (lambda: StereoNoise(np.eye(3) + np.eye(3, k=1)), "R must be symmetric"),
        (lambda: StereoNoise(np.full((3, 3), np.nan)), "R must be finite"),
        (lambda: StereoNoise("one"), "R must be numeric"),
        *((lambda s=s: StereoNoise.independent_pixels(s), "sigma must be") for s in (0.0, -1.0, np.nan, np.inf)),
        *((lambda s=s: StereoNoise.diagonal(1.0, s, 1.0), "sigma_v must be") for s in (0.0, -1.0, np.nan, np.inf)),
        (lambda: ColouredNoise(np.eye(3), np.zeros((3, 3))), "white must be positive definite"),
        (lambda: ColouredNoise(np.eye(3), gauge_walk=-1.0), "gauge_walk must be"),
        (lambda: ColouredNoise(np.eye(3), misalignment=np.nan), "misalignment must be"),
        (lambda: ColouredNoise(np.eye(3), disparity_offset=-0.1), "disparity_offset must be"),
        (lambda: ColouredNoise(np.eye(3), drift={"pixels": (1.0, 1.0, -1.0)}), "pixels of drift must be"),
    ],
)
def test_what_is_no_noise_is_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_coloured_noise_is_made_again_of_its_parts() -> None:
    """Also of those that JSON has kept, whose tuples are lists."""
    noise = ColouredNoise(
        np.eye(3), 0.1 * np.eye(3), LandmarkDrift(0.2, (1.0, 0.8, 0.3), (0.4, 0.4, 0.2)), 0.004, 0.005
    )
    assert ColouredNoise(noise.R, **json.loads(json.dumps(noise.parts))) == noise
    assert noise != StereoNoise(noise.R)
    assert ColouredNoise(noise.R, **{**noise.parts, "gauge_walk": 0.0}) != noise
