"""A motion model of one's own: rates whose six biases walk slowly and are estimated, from public parts only."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from filters import (
    BodyVelocity,
    MotionModel,
    Start,
    StereoCamera,
    StereoEKF,
    StereoNoise,
    StereoObservation,
    Variable,
    check_part,
)
from filters.geometry.vectors import plus, product, quaternion, rotate, scaled, turned_by

CAMERA = StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391)
NOISE = StereoNoise.independent_pixels(1.0)
DT, FRAMES, RUNS = 0.1, 25, 60
LOW, HIGH = chi2.ppf((0.025, 0.975), 6 * RUNS) / (6 * RUNS)
RATES = np.repeat([0.05, 0.005], 3)  # noise of the measured velocities: m/s, rad/s
BIASES = np.repeat([0.3, 0.02], 3)
WALKS = np.repeat([0.02, 0.002], 3)  # per square root of a second


@dataclass(frozen=True)
class BiasedRates(MotionModel):
    """Dead reckoning on velocities that are off by six biases; noise n = errors of (v, w)."""

    variables: tuple[Variable, ...] = (Variable("rate-bias", np.zeros(6), np.diag(BIASES**2), random_walk=WALKS),)

    driven = True

    def step(self, x, dt, n):
        bias = (*x[4:], (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))[0]
        v, w = plus(n[0], bias[:3], -1.0), plus(n[1], bias[3:], -1.0)
        v_w = rotate(x.orientation, turned_by(scaled(0.5 * dt, w), v))
        return plus(x.position, v_w, dt), product(x.orientation, quaternion(scaled(dt, w))), v_w, w, *x[4:]


WITHOUT_BIASES = replace(BiasedRates(), variables=())


@cache
def drive(seed: int) -> tuple[list[tuple[BodyVelocity, StereoObservation]], np.ndarray, Rotation, np.ndarray]:
    """What the filter is given frame by frame; the true pose and the true biases at the end."""
    rng = np.random.default_rng(seed)
    position, heading, bias = np.zeros(3), Rotation.identity(), BIASES * rng.standard_normal(6)
    points, ids, frames = np.zeros((0, 3)), np.zeros(0, dtype=np.int64), []
    for frame in range(FRAMES):
        v, w = np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.3 * np.sin(0.2 * frame), 0.0])
        if frame:
            position = position + (heading * Rotation.from_rotvec(0.5 * DT * w)).apply(v) * DT
            heading = heading * Rotation.from_rotvec(DT * w)
        rates = np.concatenate([v, w]) + bias + RATES * rng.standard_normal(6)
        bias = bias + (frame > 0) * WALKS * np.sqrt(DT) * rng.standard_normal(6)
        points_c = heading.inv().apply(points - position) if len(points) else points
        seen = (points_c[:, 2] > 3.0) & CAMERA.in_view(CAMERA.project(points_c), 5.0)
        new = np.column_stack([rng.uniform(100, 1200, 12), rng.uniform(40, 350, 12), rng.uniform(10.0, 60.0, 12)])
        new_c = CAMERA.backproject(new)[: 12 - seen.sum()]
        points = np.vstack([points[seen], position + heading.apply(new_c)])
        ids = np.concatenate([ids[seen], 100 * frame + np.arange(len(new_c))])
        uvd = CAMERA.project(heading.inv().apply(points - position))
        uvd = uvd + rng.multivariate_normal(np.zeros(3), NOISE.R, len(uvd))
        frames.append((BodyVelocity(rates[:3], rates[3:], np.diag(RATES**2)), StereoObservation(ids, uvd)))
    return frames, position, heading, bias


@cache
def driven(seed: int, motion: MotionModel) -> StereoEKF:
    slam = StereoEKF(CAMERA, NOISE, motion=motion, landmark="shared-anchor", error="so3")
    slam.reset(Start(linear_velocity=(0.0, 0.0, 5.0)))
    for number, (odometry, observation) in enumerate(drive(seed)[0]):
        if number:
            slam.predict(DT, odometry)
        slam.update(observation)
    return slam


def mean_nees(motion: MotionModel, runs: int = RUNS) -> float:
    def nees(seed: int) -> float:
        _, position, heading, _ = drive(seed)
        error, covariance = driven(seed, motion).pose_error(position, heading.as_quat())
        return error @ np.linalg.solve(covariance, error) / 6.0

    return float(np.mean([nees(seed) for seed in range(runs)]))


@pytest.mark.parametrize("motion", [BiasedRates(), WITHOUT_BIASES], ids=["biases", "none"])
def test_it_is_a_motion_model(motion: MotionModel) -> None:
    check_part(motion)


@pytest.mark.slow
def test_with_its_biases_the_pose_is_as_certain_as_it_is_right_and_without_it_is_not() -> None:
    assert LOW < mean_nees(BiasedRates()) < HIGH
    assert mean_nees(WITHOUT_BIASES, 15) > 3.0 * HIGH


@pytest.mark.slow
def test_the_biases_are_found() -> None:
    beliefs = [driven(seed, BiasedRates()).belief("rate-bias") for seed in range(RUNS)]
    errors = [drive(seed)[3] - belief.value for seed, belief in enumerate(beliefs)]
    squared = [e @ np.linalg.solve(b.covariance, e) / 6.0 for e, b in zip(errors, beliefs, strict=True)]
    assert LOW < np.mean(squared) < HIGH
    off = [np.abs(e) / np.sqrt(np.diag(b.covariance)) for e, b in zip(errors, beliefs, strict=True)]
    assert np.mean(np.array(off) < 3.0) > 0.99
    assert all((np.diag(b.covariance) < 0.1 * BIASES**2).all() for b in beliefs)
