"""Section 4.1: which parametrisation describes the cloud of a triangulated point, near and far.

A point straight ahead is measured many times; each measurement puts the landmark somewhere (Eq. 21). How well does
the covariance that first-order propagation gives (J_R R J_R^T of Eq. 25) describe that cloud?
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from filters import Euclidean, InverseDepth, LandmarkModel, RangeBearing, StartedLandmarks, StereoNoise
from stereo_slam_env.benchmark import CONFIDENCE
from stereo_slam_env.paper.paper_claims import (
    ASSUMED_NAMES,
    COUPLED,
    DIAGONAL,
    EUCLIDEAN,
    JOINT,
    NOISES,
    PIXELS,
    RIGHT,
    SENTENCES,
    UVD,
    Claim,
    ClaimFinding,
    FloatArray,
    Interval,
    Measured,
    claim,
    share_interval,
)
from stereo_slam_env.sensing import RIGS

CAMERA = RIGS["reference"]
LANDMARKS: Mapping[str, LandmarkModel] = {JOINT: InverseDepth(), EUCLIDEAN: Euclidean()}
SENSOR = RangeBearing()
FIGURE_1, FIGURE_2 = 70.0, (15.0, 30.0, 45.0)
"""Depths of the paper's figures, m."""
BEYOND = 150.0
"""A depth that the paper does not show, m: it says "for any distance"."""
NEAREST = 5.0
"""A depth at which XYZ should be Gaussian, m."""
DEPTHS = (NEAREST, *FIGURE_2, FIGURE_1, BEYOND)

DIAGONAL_OF_4_1 = StereoNoise.diagonal(1.0, 1.0, 2.0)
ASSUMED: Mapping[str, StereoNoise] = {DIAGONAL: DIAGONAL_OF_4_1, COUPLED: StereoNoise.independent_pixels(1.0)}
"""R that the covariance is made of; in this section the paper's has sigma_d = 2 px."""
TRUE = {UVD: DIAGONAL_OF_4_1, PIXELS: ASSUMED[COUPLED]}
"""Covariance of the measurements."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Gaussian description of a cloud in a parametrisation."""

    coverage: Interval  # share of the cloud in the region that is meant to hold 95 % of it
    distance: float  # Kolmogorov-Smirnov distance of the distribution of depth from the one claimed


def measurements(depth: float, noise: str, samples: int) -> FloatArray:
    """Noisy (u, v, d) of the point at that depth, (samples, 3) px; the same at every call."""
    exact = CAMERA.project([0.0, 0.0, depth])
    rng = np.random.default_rng([int(depth), list(NOISES).index(noise)])
    return rng.multivariate_normal(exact, TRUE[noise].R, samples)


def landmark(parametrisation: str, uvd: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Parameters (3,) of the landmark that a measurement (3,) starts, and their covariance (3, 3)."""
    new = started(parametrisation, uvd[None])
    J_R = (new.by_seen @ SENSOR.backprojection_jacobians(CAMERA, uvd[None], {}).by_point)[0]
    return new.parameters[0], J_R @ R @ J_R.T


def started(parametrisation: str, uvd: FloatArray) -> StartedLandmarks:
    """Landmarks from measurements (N, 3) of a camera at the origin."""
    points_c = SENSOR.backproject(CAMERA, uvd, {})
    return LANDMARKS[parametrisation].started(np.zeros(3), points_c[:, :3], points_c[:, 3])


def places(parametrisation: str, uvd: FloatArray) -> FloatArray:
    """Parameters of the landmark from measurements (N, 3); for XYZ the literal Eq. 21, also for d < 0."""
    if parametrisation == JOINT:
        return started(JOINT, uvd).parameters
    placed: FloatArray = CAMERA.ray(uvd) * (CAMERA.disparity_constant / uvd[:, 2])[:, None]
    return placed


def points(inverse_depths: FloatArray) -> FloatArray:
    """Points (N, 3), m, of parameters theta, phi, rho (N, 3): Eq. 5 over rho."""
    theta, phi, rho = inverse_depths.T
    ray = np.array([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)])
    points_w: FloatArray = (ray / rho).T
    return points_w


def fit(parametrisation: str, depth: float, uvd: FloatArray, R: FloatArray) -> Fit:
    """Description of the cloud of measurements (N, 3) by the covariance at the true point for that R."""
    centre, P = landmark(parametrisation, CAMERA.project([0.0, 0.0, depth]), R)
    cloud = places(parametrisation, uvd)
    offset = cloud - centre
    inside = np.einsum("si,ij,sj->s", offset, np.linalg.inv(P), offset) <= chi2.ppf(CONFIDENCE, 3)
    carriers = cloud[:, 2]  # of the depth: rho, or Z
    if parametrisation == EUCLIDEAN:
        carriers = np.where(uvd[:, 2] > 0, carriers, np.inf)  # beyond infinity
    claimed = norm.cdf(np.sort((carriers - centre[2]) / np.sqrt(P[2, 2])))
    steps = np.arange(len(uvd) + 1) / len(uvd)
    distance = max(np.max(steps[1:] - claimed), np.max(claimed - steps[:-1]))
    return Fit(share_interval(int(inside.sum()), len(uvd)), float(distance))


def fits(samples: int) -> dict[tuple[str, str, float, str], Fit]:
    """(noise, assumed R, depth, parametrisation) -> how it fits."""
    fits_by_name = {}
    for noise in NOISES:
        for depth in DEPTHS:
            uvd = measurements(depth, noise, samples)
            for assumed, R in ASSUMED.items():
                for parametrisation in LANDMARKS:
                    fits_by_name[noise, assumed, depth, parametrisation] = fit(parametrisation, depth, uvd, R.R)
    return fits_by_name


def judge(samples: int) -> tuple[Claim, ...]:
    """The claims of section 4.1."""
    fits_of_samples = fits(samples)

    def coverage(parametrisation: str, depths: tuple[float, ...]) -> Measured:
        return [
            (_condition(noise, assumed, depth), one.coverage)
            for (noise, assumed, depth, name), one in fits_of_samples.items()
            if name == parametrisation and depth in depths
        ]

    # Dvoretzky, Kiefer and Wolfowitz: with 95 % the cloud is nowhere farther from its distribution than half of this.
    slack = 2.0 * np.sqrt(np.log(2.0 / (1.0 - CONFIDENCE)) / (2.0 * samples))
    closer = []
    for noise in NOISES:
        for assumed in ASSUMED:
            inverse_depth, euclidean = (fits_of_samples[noise, assumed, FIGURE_1, name].distance for name in LANDMARKS)
            gain = euclidean - inverse_depth
            closer.append((_condition(noise, assumed, FIGURE_1), Interval(gain, gain - slack, gain + slack)))
    return (
        claim("region-70m", coverage(JOINT, (FIGURE_1,))),
        claim("region-70m-xyz", coverage(EUCLIDEAN, (FIGURE_1,))),
        claim("region-any-distance", coverage(JOINT, DEPTHS)),
        claim("histogram", closer),
        Claim(SENTENCES["xyz-near"], tuple(_only_near(fits_of_samples))),
    )


def _only_near(found: Mapping[tuple[str, str, float, str], Fit]) -> Iterator[ClaimFinding]:
    """XYZ describes the nearest cloud, and no far one: with the R that is right."""
    for (noise, assumed, depth, name), one in found.items():
        if name == EUCLIDEAN and assumed == RIGHT[noise] and depth in (NEAREST, FIGURE_1, BEYOND):
            wanted_range = SENTENCES["region-70m"].asked if depth == NEAREST else SENTENCES["region-70m-xyz"].asked
            yield ClaimFinding({"noise": NOISES[noise], "depth": f"{depth:g} m"}, one.coverage, wanted_range)


def _condition(noise: str, assumed: str, depth: float) -> dict[str, str]:
    return {"noise": NOISES[noise], "R": ASSUMED_NAMES[assumed], "depth": f"{depth:g} m"}
