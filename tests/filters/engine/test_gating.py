"""The chi-square gate."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from filters import Start, StereoCamera, StereoNoise, StereoObservation, make_filter
from filters.contract.noise import gate_limit

CAMERA = StereoCamera(fx=700.0, fy=700.0, cx=320.0, cy=240.0, baseline=0.5, width=640, height=480)
NOISE = StereoNoise.independent_pixels(1.0)
NEAR, FAR, BEHIND = 3, 7, 0


@pytest.mark.parametrize(("dof", "limit"), [(2, 9.210), (3, 11.345), (4, 13.277)])
def test_limits_are_the_tabulated_ones(dof: int, limit: float) -> None:
    assert gate_limit(0.99, dof) == pytest.approx(limit, abs=1e-3)


@pytest.mark.parametrize("name", ["inverse-depth", "euclidean", "right-invariant"])
@pytest.mark.parametrize("victim", [NEAR, FAR])
def test_a_measurement_is_gated_exactly_where_its_distance_exceeds_the_limit(name: str, victim: int) -> None:
    """Near and far landmarks, with one behind the camera before them: nu is set by the forecast's own S."""
    near = [[-1.0, 0.5, 4.0], [1.5, -1.0, 8.0], [-2.0, 0.3, 12.0], [0.4, 0.2, 9.0]]
    far = [[5.0, 2.0, 60.0], [-9.0, -3.0, 70.0], [4.0, -6.0, 80.0], [1.0, 1.0, 90.0]]
    ids = np.arange(8)
    slam = make_filter(name, camera=CAMERA, noise=NOISE, gate=0.99, drop_unseen=False)
    slam.reset(Start(linear_velocity=(0.0, 0.0, 5.0), covariance=np.diag(np.repeat(1e-6, 12))))
    slam.update(StereoObservation(ids, CAMERA.project(np.array([*near, *far]))))
    slam.predict(1.0)
    forecast = slam.forecast()
    direction = np.linalg.cholesky(forecast.S[victim]) @ [0.6, -0.64, 0.48]
    for factor, gated in ((0.97, []), (1.03, [victim])):
        uvd = forecast.uvd.copy()
        uvd[victim] += np.sqrt(factor * gate_limit(0.99, 3)) * direction
        report = copy.deepcopy(slam).update(StereoObservation(ids, uvd))
        np.testing.assert_array_equal(report.gated, gated)
        np.testing.assert_array_equal(report.behind_camera, [BEHIND])
