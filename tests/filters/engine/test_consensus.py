"""One-point RANSAC: the largest set of measurements that agree with one of them."""

from __future__ import annotations

import numpy as np
import pytest

from filters import Start, StereoEKF, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from filters.checks.conformance import REFERENCE_NOISE as NOISE
from filters.contract.noise import gate_limit
from filters.geometry import symmetric

from ..dense import linearised

COUNT, DT, SPEED = 30, 0.1, 5.0
VAGUE = np.diag(np.repeat([1e-6, 1e-6, 3.0, 0.3], 3) ** 2)


class Scene:
    """A cloud of points ahead, and a filter that has seen them once and knows its velocity badly."""

    def __init__(self, seed: int, **options: object) -> None:
        self.rng = np.random.default_rng(seed)
        uvd = self.rng.uniform((300, 80, 8), (1000, 320, 40), (COUNT, 3))
        self.points = CAMERA.backproject(uvd)
        self.slam = StereoEKF(CAMERA, NOISE, **options)
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


@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_best_of_all_single_updates_written_out(seed: int) -> None:
    """Which measurements are believed first: against a loop over hypotheses with a dense Kalman update each."""
    scene = Scene(seed, consensus=True, gate=0.99)
    state, observation = scene.slam.state, scene.observe(np.arange(0, COUNT, 2))
    R = observation.covariances(NOISE)
    linear = linearised(Scene(seed, gate=None).slam, observation)
    P, nu, H = symmetric.full(state.P), linear.innovation, linear.H
    limit, inverse_R = gate_limit(0.99, 3), np.linalg.inv(NOISE.R)
    S = H @ P @ H.transpose(0, 2, 1) + R
    believable = np.einsum("mk,mkl,ml->m", nu, np.linalg.inv(S), nu) <= limit
    most = 0
    for i in np.flatnonzero(believable):
        left = nu - H @ (P @ H[i].T @ np.linalg.solve(S[i], nu[i]))
        agrees = believable & (np.einsum("mk,kl,ml->m", left, inverse_R, left) <= limit)
        agrees[i] = True
        most = max(most, agrees.sum())
        if agrees.sum() == most:
            best = agrees
    report = scene.slam.update(observation)
    assert set(observation.ids[best]) <= set(report.updated.tolist())  # those, and whom the corrected state lets in
    assert 3 < most < believable.sum()
