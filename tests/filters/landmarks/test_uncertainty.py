"""The paper's 4.1: which parametrisation describes the cloud of a triangulated point, near and far.

A point straight ahead is measured many times with sigma_u = sigma_v = 1 and sigma_d = 2 px; how many of the resulting
landmarks lie in the 95 % region of the covariance that Eq. 25 gives? Reference figures: an independent prototype.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, norm

from filters import StereoCamera, StereoNoise

from ..first_sight import first_sight
from ..slots import LANDMARKS

CAMERA = StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391)
NOISE = StereoNoise.diagonal(1.0, 1.0, 2.0)
DEPTHS = (15.0, 30.0, 45.0, 70.0, 150.0)
COVERAGE = {"inverse-depth": (0.951, 0.951, 0.951, 0.951, 0.951), "euclidean": (0.942, 0.920, 0.892, 0.844, 0.736)}
KOLMOGOROV_SMIRNOV = {"inverse-depth": (0.0, 0.0, 0.0, 0.0, 0.0), "euclidean": (0.021, 0.042, 0.063, 0.096, 0.185)}
SAMPLES = 40_000


def measured(depth: float) -> tuple[np.ndarray, np.ndarray]:
    """The exact measurement, and noisy ones."""
    exact = CAMERA.project([0.0, 0.0, depth])
    return exact, np.random.default_rng(int(depth)).multivariate_normal(exact, NOISE.R, SAMPLES)


def landmark(name: str, uvd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameters and J_R R J_R^T of landmarks started at the origin."""
    new = first_sight(LANDMARKS[name], CAMERA, np.zeros(3), np.eye(3), np.atleast_2d(uvd), NOISE.R)
    return new.parameters, new.noise


def cloud(name: str, uvd: np.ndarray) -> np.ndarray:
    """Where noisy measurements put the landmark; for XYZ the literal Eq. 21, which also takes d < 0."""
    if name != "euclidean":
        points_c = np.column_stack([CAMERA.ray(uvd), uvd[:, 2] / CAMERA.disparity_constant])
        return LANDMARKS[name].started(np.zeros(3), points_c[:, :3], points_c[:, 3]).parameters
    return CAMERA.ray(uvd) * (CAMERA.disparity_constant / uvd[:, 2])[:, None]


@pytest.mark.parametrize("name", COVERAGE)
@pytest.mark.parametrize(("row", "depth"), list(enumerate(DEPTHS)))
def test_share_of_the_cloud_in_the_95_percent_region(name: str, row: int, depth: float) -> None:
    exact, noisy = measured(depth)
    centre, P = landmark(name, exact)
    offset = cloud(name, noisy) - centre
    distances = np.einsum("si,ij,sj->s", offset, np.linalg.inv(P[0]), offset)
    assert (distances <= chi2.ppf(0.95, 3)).mean() == pytest.approx(COVERAGE[name][row], abs=0.01)


@pytest.mark.parametrize("name", KOLMOGOROV_SMIRNOV)
@pytest.mark.parametrize(("row", "depth"), list(enumerate(DEPTHS)))
def test_distance_of_the_depth_marginal_from_the_gaussian(name: str, row: int, depth: float) -> None:
    """Kolmogorov-Smirnov, of the parameter that carries the depth: rho, or Z (infinite where d <= 0)."""
    exact, noisy = measured(depth)
    centre, P = landmark(name, exact)
    carriers = cloud(name, noisy)[:, 2]
    if name == "euclidean":
        carriers[noisy[:, 2] <= 0] = np.inf
    values = np.sort((carriers - centre[0, 2]) / np.sqrt(P[0, 2, 2]))
    empirical = np.arange(1, SAMPLES + 1) / SAMPLES
    distance = np.abs(empirical - norm.cdf(values)).max()
    assert distance == pytest.approx(KOLMOGOROV_SMIRNOV[name][row], abs=0.01)


def test_two_sigma_band_of_the_depth_at_70_m() -> None:
    """Inverse depth [41.7, 219] m, XYZ [22.4, 117.6] m."""
    exact, _ = measured(70.0)
    centre, P = landmark("inverse-depth", exact)
    sigma = np.sqrt(P[0, 2, 2])
    assert 1 / (centre[0, 2] + 2 * sigma) == pytest.approx(41.7, abs=0.1)
    assert 1 / (centre[0, 2] - 2 * sigma) == pytest.approx(219, abs=1)
    centre, P = landmark("euclidean", exact)
    sigma = np.sqrt(P[0, 2, 2])
    assert centre[0, 2] - 2 * sigma == pytest.approx(22.4, abs=0.1)
    assert centre[0, 2] + 2 * sigma == pytest.approx(117.6, abs=0.1)


def test_share_of_negative_disparities_at_150_m() -> None:
    assert (measured(150.0)[1][:, 2] <= 0).mean() == pytest.approx(0.085, abs=0.005)
