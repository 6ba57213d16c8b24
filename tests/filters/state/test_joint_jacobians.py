"""H of an update, and what starts a landmark, against finite differences of the whole state, for all parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filters import Start, StereoEKF, StereoNoise, StereoObservation
from filters.geometry import symmetric
from filters.geometry.derivatives import columns_of
from filters.landmarks.landmark_model import LandmarkModel
from filters.measurements.measurement_model import MeasurementModel

from ..dense import linearised, measured, plus, started
from ..jacobians import (
    CAMERA,
    COUNT,
    MODELS,
    SENSORS,
    Case,
    Cases,
    Situation,
    assert_jacobian,
    situations_of,
    values_in,
    visible,
)
from ..numeric import numeric_jacobian
from ..slots import ERRORS
from ..stranger.late_clock import OFFSET, LateClock

CASES = Cases()
R = np.diag([1.0, 2.0, 3.0])
SINGLE = {name: sensor for name, sensor in SENSORS.items() if len(sensor.rows(sensor.size == 4)) == 1}
SINGLE["late clock"] = LateClock((replace(OFFSET, value=[0.05]),))
"""Sensors of one stage: the scratch has the last one alone."""


def sight(sensor: MeasurementModel, s: Situation) -> StereoObservation:
    """The landmarks of the situation as the sensor measures them."""
    z = sensor.predict(CAMERA, s.rays_c, values_in(sensor, s))
    return StereoObservation(np.arange(COUNT), z[:, :3], v_right=z[:, 3] if sensor.size == 4 else None)


def filter_at(model: LandmarkModel, sensor: MeasurementModel, error: str, s: Situation) -> StereoEKF:
    """A filter with nothing in the map, at the pose of the situation."""
    options = {"landmark": model, "measurement": sensor, "error": error}
    slam = StereoEKF(CAMERA, StereoNoise(R), gate=None, drop_unseen=False, **options)
    at = s.camera
    slam.reset(Start(at.position, at.orientation, at.linear_velocity, at.angular_velocity, np.eye(12)))
    return slam


for _i, (_landmark, _model) in enumerate(MODELS.items()):
    for _j, (_measurement, _sensor) in enumerate(SINGLE.items()):
        _situations = visible(_sensor, situations_of(_model))
        _error = list(ERRORS)[(_i + _j) % len(ERRORS)]
        if not _situations:
            continue

        @CASES.case(f"new landmarks: {_landmark}, {_measurement}", _situations, seeds=1)
        def _(s: Situation, model=_model, sensor=_sensor, error=_error):
            slam, uvd = filter_at(model, sensor, "so3", s), sight(sensor, s).uvd
            before = slam.state
            slam.update(sight(sensor, s))
            state, leading = slam.state, before.layout.errors
            P = symmetric.full(state.P)
            cross = P[state.own_rows()][:, :, :leading]
            values = started(slam, before, uvd)

            def function(e: np.ndarray) -> np.ndarray:
                moved = plus(before, np.concatenate([e, np.zeros(len(before.P) - leading)]))
                return columns_of(model.local_by, values, started(slam, moved, uvd))

            return function, cross @ np.linalg.inv(P[:leading, :leading])

        @CASES.case(f"H: {_landmark}, {_measurement}, {_error}", _situations, seeds=1)
        def _(s: Situation, model=_model, sensor=_sensor, error=_error):
            slam, seen = filter_at(model, sensor, error, s), sight(sensor, s)
            slam.update(seen)
            state = slam.state
            moved = replace(state.camera, position=state.camera.position + 0.01 * s.anchor_offset[0])
            slam.state = state = replace(state, camera=moved, predicted=moved)
            with_right = seen.v_right is not None
            T = np.array(sensor.rows(with_right)[0].T)
            return lambda e: measured(slam, plus(state, e)) @ T.T, linearised(slam, seen).H


@pytest.mark.parametrize("named", CASES, ids=lambda named: named.name)
def test_jacobian_of_the_joint_state_equals_finite_differences(named: Case) -> None:
    assert_jacobian(named)


@pytest.mark.parametrize("sensor", SINGLE.values(), ids=SINGLE)
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_the_noise_of_a_new_landmark_is_that_of_its_measurement(model: LandmarkModel, sensor: MeasurementModel) -> None:
    """J R J^T, with the J of finite differences."""
    for situation in visible(sensor, situations_of(model)):
        s = situation(np.random.default_rng(0))
        slam = filter_at(model, sensor, "so3", s)
        before, uvd = slam.state, sight(sensor, s).uvd
        slam.update(sight(sensor, s))
        state = slam.state
        P, rows, leading = symmetric.full(state.P), state.own_rows(), before.layout.errors
        cross, lead = P[rows][:, :, :leading], P[:leading, :leading]
        noise = P[rows[:, :, None], rows[:, None, :]] - cross @ np.linalg.inv(lead) @ cross.transpose(0, 2, 1)
        values = started(slam, before, uvd)
        J = numeric_jacobian(
            lambda e, values=values, slam=slam, before=before, uvd=uvd: columns_of(
                model.local_by, values, started(slam, before, uvd + e)
            ),
            3,
            s.step,
        )
        expected = J @ R @ J.transpose(0, 2, 1)
        whole = np.sqrt(np.einsum("mii->mi", P[rows[:, :, None], rows[:, None, :]]))
        scale = whole[:, :, None] * whole[:, None]
        np.testing.assert_allclose(noise / scale, expected / scale, rtol=0, atol=1e-6)
