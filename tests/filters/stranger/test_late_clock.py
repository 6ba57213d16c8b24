"""A measurement may depend on the velocity: the delay of a camera is estimated, and the filter stays consistent."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from filters import BodyVelocity, StereoEKF, StereoObservation, check_part, nees

from ..drives import CAMERA, DT, INDEPENDENT_PIXELS, SPEED, Frame
from .late_clock import LateClock
from .test_stranger import START


class ByNumbers(LateClock):
    """The same in Python."""

    in_machine_code = False


SIGMAS = np.repeat([0.05, 0.01], 3)  # of odometry, m/s and rad/s: without it a delay hides behind other accelerations


def drive(seed: int, delay: float, count: int = 25) -> list[tuple[Frame, BodyVelocity]]:
    """Poses by the motion model with its noise, observations that are made `delay` seconds later, and odometry."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-20, 25, 900), rng.uniform(-6, 6, 900), rng.uniform(4, 60, 900)])
    v, w = np.array([0.0, 0.0, SPEED]) + rng.normal(0, 0.5, 3), rng.normal(0, 0.05, 3)
    position, turn, frames = np.zeros(3), Rotation.identity(), []
    for k in range(count):
        if k:
            v, w = v + rng.normal(0, 3.0 * DT, 3), w + rng.normal(0, 0.6 * DT, 3)
            position, turn = position + DT * v, turn * Rotation.from_rotvec(DT * w)
        p_c = (turn * Rotation.from_rotvec(delay * w)).inv().apply(points - position - delay * v)
        uvd = CAMERA.project(np.where(p_c[:, 2:] > 1.0, p_c, [0.0, 0.0, 1.0]))
        ids = np.flatnonzero((p_c[:, 2] > 3.0) & CAMERA.in_view(uvd))[:30]
        uvd = uvd[ids] + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(ids))
        felt = (turn * Rotation.from_rotvec(-0.5 * DT * w)).inv().apply(v)
        linear, angular = np.split(np.concatenate([felt, w]) + SIGMAS * rng.standard_normal(6), 2)
        frame = Frame(position, turn.as_quat(), StereoObservation(ids, uvd))
        frames.append((frame, BodyVelocity(linear, angular, np.diag(SIGMAS**2))))
    return frames


def driven(sensor: object, seed: int, **options: object) -> tuple[StereoEKF, Frame, np.ndarray]:
    """The filter at the end of a drive with a delay drawn from its prior; the truth, and error and variance of that."""
    delay = float(0.015 * np.random.default_rng(seed + 100).standard_normal())
    slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, **{"landmark": "shared-anchor", "measurement": sensor, **options})
    slam.reset(START)
    for k, (frame, odometry) in enumerate(drive(seed, delay)):
        if k:
            slam.predict(DT, odometry)
        slam.update(frame.observation)
    belief = slam.belief("time-offset")
    return slam, frame, np.array([belief.value[0] - delay, belief.covariance[0, 0]])


@pytest.mark.parametrize("sensor", [LateClock(), ByNumbers()], ids=["compiled", "by numbers"])
def test_the_part_is_right(sensor: LateClock) -> None:
    check_part(sensor)


@pytest.mark.parametrize("error", ["quaternion", "first-estimates", "right-invariant", "left-invariant"])
@pytest.mark.parametrize("landmark", ["inverse-depth", "shared-anchor", "euclidean"])
def test_kernels_lead_where_the_numbers_do(landmark: str, error: str) -> None:
    options = {"error": error, "landmark": landmark, "iterations": 2}
    compiled, by_numbers = driven(LateClock(), 1, **options)[0], driven(ByNumbers(), 1, **options)[0]
    np.testing.assert_allclose(compiled.pose.position, by_numbers.pose.position, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(compiled.pose.covariance, by_numbers.pose.covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("error", ["so3", "first-estimates", "right-invariant"])
def test_the_delay_is_found_and_the_belief_is_consistent(error: str) -> None:
    """Over 16 drives: 16 squares and 96 numbers of variance one, within four sigmas and a half of their means."""
    delays, poses = [], []
    for seed in range(16):
        slam, frame, (off, variance) = driven(LateClock(), seed, error=error, gate=None)
        assert variance < 0.2 * 0.015**2  # the drive tells it
        delays.append(off**2 / variance)
        found, covariance = slam.pose_error(frame.position, frame.orientation)
        poses.append(nees(found[None], covariance[None])[0] / 6.0)
    assert np.mean(delays) < 2.6
    assert 0.4 < np.mean(poses) < 1.65
