"""One-point RANSAC: the largest set of measurements that agree with one of them."""

from __future__ import annotations

import numpy as np
import pytest

from filters import Start, StereoEKF, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.checks.conformance import REFERENCE_NOISE as NOISE
from filters.engine.consensus import largest_agreement
from filters.engine.gating import gate_limit
from filters.state import symmetric
from filters.state.linearised import LinearisedMeasurements

COUNT, DT, SPEED = 30, 0.1, 5.0
VAGUE = np.diag(np.repeat([1e-6, 1e-6, 3.0, 0.3], 3) ** 2)


class Scene:
    """A cloud of points ahead, and a filter that has seen them once and knows its velocity badly."""

    def __init__(self, seed: int, **options: object) -> None:
        self.rng = np.random.default_rng(seed)
        uvd = self.rng.uniform((300, 80, 8), (1000, 320, 40), (COUNT, 3))
        self.points = CAMERA.backproject(uvd)
        self.slam = StereoEKF(CAMERA, NOISE, compiled=False, **options)
        self.slam.reset(Start(linear_velocity=(0, 0, SPEED - 3.0), covariance=VAGUE))
        self.slam.update(StereoObservation(np.arange(COUNT), uvd))
        self.slam.predict(DT)

    def observe(self, outliers: np.ndarray) -> StereoObservation:
        uvd = CAMERA.project(self.points - (0.0, 0.0, SPEED * DT))
        uvd += self.rng.multivariate_normal(np.zeros(3), NOISE.R, COUNT)
        uvd[outliers] += self.rng.choice([-1.0, 1.0], (len(outliers), 3)) * self.rng.uniform(5, 7, (len(outliers), 3))
        return StereoObservation(np.arange(COUNT), uvd)


@pytest.mark.parametrize("measurement", ["joint", "stacked", "sequential"])
def test_outliers_that_a_vague_prediction_lets_through_are_found(measurement: str) -> None:
    outliers = np.array([2, 7, 11, 19, 23])
    caught = {True: 0, False: 0}
    for seed in range(6):
        for consensus in (True, False):
            scene = Scene(seed, consensus=consensus, measurement=measurement, gate=0.99)
            report = scene.slam.update(scene.observe(outliers))
            caught[consensus] += np.isin(outliers, report.gated).sum()
            assert len(report.updated) >= 0.8 * (COUNT - len(outliers))
    assert caught[True] >= 0.9 * 6 * len(outliers)
    assert caught[True] > caught[False]


def test_the_pose_is_better_for_it() -> None:
    errors = {True: [], False: []}
    for seed in range(8):
        for consensus, found in errors.items():
            scene = Scene(seed, consensus=consensus)
            scene.slam.update(scene.observe(np.arange(0, COUNT, 3)))
            found.append(np.linalg.norm(scene.slam.pose.position - (0.0, 0.0, SPEED * DT)))
    assert np.mean(errors[True]) < 0.7 * np.mean(errors[False])


def test_without_outliers_nearly_all_are_used_and_the_estimate_is_nearly_that_of_the_gate_alone() -> None:
    with_test, without = Scene(1, consensus=True), Scene(1)
    observation = with_test.observe(np.zeros(0, dtype=int))
    report = with_test.slam.update(observation)
    without.slam.update(observation)
    assert len(report.updated) >= COUNT - 2
    apart = with_test.slam.pose.position - without.slam.pose.position
    sigmas = np.sqrt(np.diag(without.slam.pose.covariance)[:3])
    assert np.abs(apart / sigmas).max() < 1.0


def test_it_is_the_best_of_all_single_updates_written_out() -> None:
    """Against a loop over hypotheses with a dense Kalman update each."""
    rng = np.random.default_rng(4)
    n, count, size = 12 + 3 * 6, 6, 3
    root = rng.standard_normal((n, n))
    dense = root @ root.T / n
    rows = 12 + 3 * np.arange(count)[:, None] + np.arange(3)
    measurements = LinearisedMeasurements(
        3.0 * rng.standard_normal((count, size)),
        rng.standard_normal((count, size, 6)),
        rng.standard_normal((count, size, 3)),
        rows,
        np.broadcast_to(0.5 * np.eye(size), (count, size, size)),
    )
    limit = gate_limit(0.99, size)
    H = np.zeros((count, size, n))
    H[:, :, :6] = measurements.by_leading
    for j in range(count):
        H[j][:, rows[j]] += measurements.by_map[j]
    supports = []
    for i in range(count):
        gain = dense @ H[i].T @ np.linalg.inv(H[i] @ dense @ H[i].T + measurements.R[i])
        left = measurements.innovation - H @ (gain @ measurements.innovation[i])
        distances = np.einsum("jk,jk->j", left, left) / 0.5
        agrees = distances <= limit
        agrees[i] = True
        supports.append((agrees.sum(), -distances[agrees].sum(), agrees))
    most = max(support[0] for support in supports)
    possible = [agrees for count_of, _, agrees in supports if count_of == most]
    found = largest_agreement(np.asfortranarray(np.tril(dense)), measurements, measurements.R, limit)
    assert any(np.array_equal(found, agrees) for agrees in possible)
    assert np.array_equal(symmetric.full(np.tril(dense)), dense) or np.allclose(symmetric.full(np.tril(dense)), dense)


def test_it_needs_a_gate() -> None:
    with pytest.raises(ValueError, match="gate must be a probability with consensus=True"):
        StereoEKF(CAMERA, NOISE, consensus=True, gate=None)
