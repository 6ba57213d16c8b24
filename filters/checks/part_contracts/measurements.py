"""Checks of measurement models."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from filters.checks.conformance import REFERENCE_CAMERA, REFERENCE_NOISE, require
from filters.checks.part_contracts.comparison import SCALES, assert_close, unit_directions
from filters.contract.inputs import StereoObservation
from filters.contract.variables import VELOCITY
from filters.geometry import derivatives
from filters.geometry.arrays import FloatArray
from filters.measurements.measurement_model import MeasurementModel, Values


def _points(sensor: MeasurementModel) -> tuple[FloatArray, Values]:
    """Points, or other landmarks, that the sensor can see, and values of its variables near their start."""
    rng, c = np.random.default_rng(0), REFERENCE_CAMERA
    points_c = np.column_stack([rng.uniform(-0.4, 0.4, (len(SCALES), 2)), np.ones(len(SCALES)), SCALES])
    near = {v.name: v.retraction.retract(v.value, 1e-3 * rng.standard_normal(v.size)) for v in sensor.variables}
    if sensor.sees_velocity:
        near[VELOCITY] = np.array([0.4, -0.2, 5.0, 0.02, 0.3, -0.1])
    if sensor.seen_size != 4:  # whatever is measured there
        points_c = sensor.backproject(c, c.project_scaled(points_c[:, :3], points_c[:, 3]), near)
    seen = sensor.in_front(points_c)
    require(seen.shape == seen[:, None].squeeze(1).shape == (len(points_c),), f"in_front has shape {seen.shape}")
    require(seen.any(), "in_front is true of no point")
    return points_c[seen], near


def check_measurement_shapes(sensor: MeasurementModel) -> None:
    """Numbers have the documented shapes, of none and of a grid of points, and are finite where `in_front`."""
    points_c, values = _points(sensor)
    numbers = sensor.predict(REFERENCE_CAMERA, points_c, values)
    require(np.isfinite(numbers).all(), "a number of a point in front is not finite")
    require(numbers.shape == (len(points_c), sensor.size), f"predict returned {numbers.shape}")
    grid = sensor.predict(REFERENCE_CAMERA, np.stack([points_c, points_c]), values)
    assert_close("predict of a grid", grid, np.stack([numbers, numbers]), 1e-12)
    if sensor.seen_size == 4:
        longer = sensor.predict(REFERENCE_CAMERA, 2.5 * points_c, values)
        assert_close("predict of longer directions", longer, numbers, 1e-9)
    assert_close("predict of none", sensor.predict(REFERENCE_CAMERA, points_c[:0], values), numbers[:0])
    assert_close("backproject of none", sensor.backproject(REFERENCE_CAMERA, numbers[:0, :3], values), points_c[:0])


def check_measurement_inverse(sensor: MeasurementModel) -> None:
    """A point is backprojected to where it is."""
    points_c, values = _points(sensor)
    numbers = sensor.predict(REFERENCE_CAMERA, points_c, values)
    back = sensor.backproject(REFERENCE_CAMERA, numbers[:, :3], values)
    assert_close("backproject of predict", unit_directions(back), unit_directions(points_c), 1e-9)


def check_measurement_jacobians(sensor: MeasurementModel) -> None:
    """Derivatives of numbers and backprojection are those of differences, by the variables, too."""
    points_c, values = _points(sensor)
    nearer = points_c - 2.0 * derivatives.STEP * (np.arange(points_c.shape[1]) == 3)
    points_c = points_c[sensor.in_front(nearer)]
    uvd = sensor.predict(REFERENCE_CAMERA, points_c, values)[:, :3]
    for what, claimed, function, start in (
        ("project", sensor.jacobians, sensor.predict, points_c),
        ("unproject", sensor.backprojection_jacobians, sensor.backproject, uvd),
    ):
        J = claimed(REFERENCE_CAMERA, start, values)
        by_point = derivatives.jacobian(partial(_of_moved, function, start, values), start.shape[1])
        assert_close(f"the derivative of {what}", J.by_point, by_point)
        for name in sensor.value_names:
            by_variable = derivatives.jacobian(partial(_of_changed, function, start, values, name), len(values[name]))
            assert_close(f"the derivative of {what} by {name}", J.by_variable[name], by_variable)


def _of_moved(function: Any, start: FloatArray, values: Values, e: FloatArray) -> Any:
    return function(REFERENCE_CAMERA, start + e, values)


def _of_changed(function: Any, start: FloatArray, values: Values, name: str, e: FloatArray) -> Any:
    return function(REFERENCE_CAMERA, start, {**values, name: values[name] + e})


def check_measurement_stages(sensor: MeasurementModel) -> None:
    """Stages use the numbers of the sensor, each with a definite noise."""
    points_c, values = _points(sensor)
    numbers = sensor.predict(REFERENCE_CAMERA, points_c, values)
    for rows in (slice(None), slice(0)):
        some = numbers[rows]
        R = np.broadcast_to(REFERENCE_NOISE.R, (len(some), 3, 3))
        for v_right in (None, some[:, 3]) if sensor.size == 4 else (None,):
            for stage in sensor.stages(StereoObservation(np.arange(len(some)), some[:, :3], v_right), R):
                assert_close("z of a stage", stage.z, some @ stage.T.T, 1e-12)
                require(stage.R.shape == (len(some), *2 * stage.z.shape[1:]), f"R of a stage is {stage.R.shape}")
                require((np.linalg.eigvalsh(stage.R) > 0.0).all(), "R of a stage is not positive definite")


CHECKS: tuple[Callable[..., None], ...] = (
    check_measurement_shapes,
    check_measurement_inverse,
    check_measurement_jacobians,
    check_measurement_stages,
)
