"""An update must be affordable. `benchmarks/filter_speed.py` has the ratios to the linear algebra."""

from __future__ import annotations

import time

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from filters import StereoObservation, make_filter
from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE

LANDMARKS, BUDGET_MS = 100, 25.0


@pytest.mark.parametrize("name", ["inverse-depth", "dual-bearing", "euclidean"])
def test_a_frame_with_100_landmarks_takes_at_most_25_ms(name: str) -> None:
    rng = np.random.default_rng(0)
    uvd = rng.uniform((400, 100, 5), (900, 300, 40), (LANDMARKS, 3))
    slam = make_filter(name, camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE)
    slam.update(StereoObservation(np.arange(LANDMARKS), uvd))
    times = []
    with threadpool_limits(1):
        for _ in range(20):
            observation = StereoObservation(np.arange(LANDMARKS), uvd + rng.standard_normal((LANDMARKS, 3)))
            began = time.perf_counter()
            slam.predict(0.1)
            report = slam.update(observation)
            times.append(1e3 * (time.perf_counter() - began))
            assert len(report.updated) > 0.9 * LANDMARKS
    # The best of twenty: other processes on the machine only ever add.
    assert min(times) <= BUDGET_MS
