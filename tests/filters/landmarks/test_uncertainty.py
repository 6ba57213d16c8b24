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


FIGURES = {
    "inverse-depth": ((0.951, 0.0), (0.951, 0.0), (0.951, 0.0), (0.951, 0.0), (0.951, 0.0)),
    "euclidean": ((0.942, 0.021), (0.920, 0.042), (0.892, 0.063), (0.844, 0.096), (0.736, 0.185)),
}


@pytest.mark.parametrize("name", FIGURES)
@pytest.mark.parametrize(("row", "depth"), list(enumerate(DEPTHS)))
def test_share_of_the_cloud_in_the_95_percent_region_and_distance_from_the_gaussian(
    name: str, row: int, depth: float
) -> None:
    """The second by Kolmogorov-Smirnov, of what carries the depth: rho, or Z (infinite where d <= 0)."""
    exact, noisy = measured(depth)
    centre, P = landmark(name, exact)
    offset = cloud(name, noisy) - centre
    distances = np.einsum("si,ij,sj->s", offset, np.linalg.inv(P[0]), offset)
    depths = offset[:, 2] / np.sqrt(P[0, 2, 2])
    if name == "euclidean":
        depths[noisy[:, 2] <= 0] = np.inf
    distance = np.abs(np.arange(1, SAMPLES + 1) / SAMPLES - norm.cdf(np.sort(depths))).max()
    assert ((distances <= chi2.ppf(0.95, 3)).mean(), distance) == pytest.approx(FIGURES[name][row], abs=0.01)


def test_two_sigma_band_of_the_depth_at_70_m() -> None:
    """Inverse depth [41.7, 219] m, XYZ [22.4, 117.6] m."""
    bands = []
    for name in FIGURES:
        centre, P = landmark(name, measured(70.0)[0])
        bands.append(centre[0, 2] + 2 * np.sqrt(P[0, 2, 2]) * np.array([1.0, -1.0]))
    assert 1 / bands[0] == pytest.approx(np.array([41.7, 219.0]), rel=3e-3)
    assert bands[1] == pytest.approx(np.array([117.6, 22.4]), abs=0.1)
