"""Extreme but legal numbers, mixed: every pose keeps a Cholesky factor, and what is beyond the contract is refused."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from filters import BodyVelocity, ConstantVelocity, FilterBatch, Start, StereoEKF, StereoNoise, StereoObservation

from ..drives import CAMERA, INDEPENDENT_PIXELS
from .beliefs import make

CHOICES = {
    "landmark": ("inverse-depth", "shared-anchor", "euclidean"),
    "measurement": ("joint", "sequential", "stacked", "left"),
    "error": ("quaternion", "so3", "first-estimates", "right-invariant"),
    "gate": (0.99, None),
    "drop_unseen": (False, True),
    "iterations": (1, 1, 2),
}
RUNS, FRAMES = 100, 12
LOST_ONCE = [1270, 3062, 3740, 5887, 6047, 7132, 7282, 7552, 7618, 8017, 8033]
"""Seeds of 10,500 in which rounding took a whole variance, or all but the last digits of one."""


def covariance(rng: np.random.Generator, size: int, low: float, high: float) -> np.ndarray:
    """Variances from 10^low to 10^high along any axes."""
    variances = 10.0 ** rng.uniform(low, high, size)
    axes = np.linalg.qr(rng.standard_normal((size, size)))[0] if rng.random() < 0.5 else np.eye(size)
    C = (axes * variances) @ axes.T
    return 0.5 * (C + C.T)


def frames(rng: np.random.Generator):
    """dt from 1 ms to 100 s, odometry and measurements whose variances differ by up to 1e26, outliers everywhere."""
    for _ in range(FRAMES):
        dt, count = 10.0 ** rng.uniform(-3, 2), int(rng.integers(0, 12))
        moved = rng.standard_normal(3) * 10.0 * rng.random(), 0.3 * rng.standard_normal(3)
        odometry = BodyVelocity(*moved, covariance(rng, 6, -12, 6)) if rng.random() < 0.6 else None
        uvd = rng.uniform([0, 0, 0.05], [1343, 390, 90], (count, 3))
        R = None if rng.random() < 0.33 or not count else np.array([covariance(rng, 3, -14, 12) for _ in range(count)])
        try:
            yield dt, odometry, StereoObservation(rng.choice(20, count, replace=False), uvd, R=R)
        except ValueError:  # rounding took what is positive definite of variances that differ by 1e26 in one matrix
            continue


@pytest.mark.parametrize("seeds", [*(range(first, first + 25) for first in range(0, RUNS, 25)), LOST_ONCE], ids=min)
def test_every_mixture_of_legal_numbers_leaves_the_pose_a_covariance(seeds: Sequence[int]) -> None:
    for seed in seeds:
        rng = np.random.default_rng(seed)
        options = {name: values[rng.integers(len(values))] for name, values in CHOICES.items()}
        slam = StereoEKF(CAMERA, INDEPENDENT_PIXELS, **options)
        slam.reset(Start())
        for dt, odometry, observation in frames(rng):
            for call, arguments in ((slam.predict, (dt, odometry)), (slam.update, (observation,))):
                call(*arguments)
                assert np.isfinite(slam.pose.position).all()
                np.linalg.cholesky(slam.pose.covariance)


def test_a_belief_that_rounding_has_not_touched_is_not_touched() -> None:
    """Known to 1e-6 and 1e3 at once, and standing still: variances that differ, without a correlation."""
    slam = make()
    slam.reset(Start(covariance=np.diag(np.tile([1e-12, 1e6, 1.0], 4))))
    np.testing.assert_array_equal(np.diag(slam.pose.covariance), [1e-12, 1e6, 1.0, 1e-12, 1e6, 1.0])
    slam.correct([0.0, 0.0, 0.0], {"pose": np.eye(3, 6)}, 1e-4 * np.eye(3))
    np.testing.assert_allclose(np.diag(slam.pose.covariance)[:3], [1e-12, 1e-4, 1e-4], rtol=1e-3)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: make().predict(100.1), "dt must be at most 100 s, got 100.1: reset the filter after so long a gap"),
        (lambda: FilterBatch(make, 2).predict(101.0), "dt must be at most 100 s"),
        (lambda: FilterBatch(make, 2).predict([0.1, 101.0]), "dt must be numbers above 0 and up to 100 s"),
        (lambda: StereoNoise(2e18 * np.eye(3)), r"R must be at most 1e\+18 px\^2 in size, got 2e\+18: check its unit"),
        (lambda: StereoObservation([1], [[1, 2, 3]], R=[2e18 * np.eye(3)]), "R must be at most"),
        (lambda: BodyVelocity([2e6, 0, 0], [0, 0, 0], np.eye(6)), r"odometry.linear must be at most 1e\+06 m/s"),
        (lambda: BodyVelocity([0, 0, 0], [0, 2e6, 0], np.eye(6)), r"odometry.angular must be at most 1e\+06 rad/s"),
        (lambda: BodyVelocity([0, 0, 0], [0, 0, 0], 2e12 * np.eye(6)), r"odometry.covariance must be at most 1e\+12"),
    ],
)
def test_beyond_the_contract_one_line_says_what_is_too_large(build, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refusal:
        build()
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("dt", [30.0, 100.0])
@pytest.mark.parametrize("known", [1e-6, 0.0])
def test_no_variance_is_finer_than_the_rounding_of_the_one_it_was_measured_down_from(known: float, dt: float) -> None:
    """A long step with an acceleration of 1 m/s^2 in doubt, and odometry beyond the last digit of its variance."""
    slam = make(motion=ConstantVelocity(1.0, 1e-3))
    slam.reset(Start(covariance=np.diag(np.repeat([known, 1e-3, 0.5, 1e-3], 3) ** 2)))
    slam.predict(dt, BodyVelocity([0, 0, 5.0], [0, 0, 0], np.diag(np.repeat([1e-22, 1e-8], 3))))
    np.linalg.cholesky(slam.pose.covariance)
    assert np.diag(slam.pose.covariance)[:3].min() > np.finfo(float).eps * dt**4


def test_what_is_known_exactly_stays_so_and_is_no_loss_by_rounding() -> None:
    """A camera that cannot turn: its rotation has no variance, its position the one that the motion gives it."""
    slam = make(motion=ConstantVelocity(1.0, 1e-9))
    slam.reset(Start(covariance=np.diag(np.repeat([0.5, 0.0, 0.2, 0.0], 3) ** 2)))
    slam.predict(0.5)
    expected = 0.5**2 + 0.5**2 * (0.2**2 + (0.5 * 1.0) ** 2)
    np.testing.assert_allclose(np.diag(slam.pose.covariance)[:3], expected, rtol=1e-9)
    assert np.diag(slam.pose.covariance)[3:].max() < 1e-17
