"""Checks of landmark parametrisations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from filters.checks.conformance import require
from filters.checks.part_contracts.comparison import SCALES, TOLERANCE, TURN, assert_close, unit_directions
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import FloatArray
from filters.geometry.derivatives import columns_of, jacobian_of
from filters.landmarks.landmark_model import LandmarkModel


def _seen(model: LandmarkModel) -> FloatArray:
    """Numbers (M, seen_size) by which landmarks are seen that can start, from their anchors or the origin of W."""
    rng, count = np.random.default_rng(0), len(SCALES)
    others = np.column_stack([SCALES, 0.1 * rng.standard_normal((count, model.seen_size - 4))])
    seen = np.hstack([rng.standard_normal((count, 3)), others])
    if model.seen_size != 4:  # what starts may have to keep numbers of its own at zero
        seen = columns_of(model.point_of, columns_of(model.start_from, _able(model, seen)))
    return _able(model, seen)


def _able(model: LandmarkModel, seen: FloatArray) -> FloatArray:
    able: FloatArray = seen[columns_of(lambda h: (model.can_start_from(h),), seen)[:, 0].astype(bool)]
    require(len(able), "no landmark can be started")
    return able


def _slopes(function: Callable[..., Any], *arrays: FloatArray) -> FloatArray:
    """Jacobian (M, k, n) of a plain function by its first argument, by differences."""
    first, *others = arrays
    return derivatives.jacobian(lambda e: columns_of(function, first + e, *others), first.shape[1])


def _assert_slopes(what: str, function: Callable[..., Any], *arrays: FloatArray) -> None:
    """Raise an `AssertionError` where derivatives by dual numbers are not those of differences."""
    by_duals = jacobian_of(function, *arrays)[1]
    require(np.isfinite(by_duals).all(), f"a derivative of {what} is not finite")
    assert_close(f"the derivative of {what}", by_duals, _slopes(function, *arrays))


def check_landmark_start(model: LandmarkModel) -> None:
    """A landmark is seen where it was started."""
    seen = _seen(model)
    values = columns_of(model.start_from, seen)
    require(values.shape == (len(seen), model.value_size), f"start_from gives {values.shape[1]} numbers")
    again = columns_of(model.point_of, values)
    require(again.shape == seen.shape, f"point_of gives {again.shape[1]} numbers")
    assert_close("point_of start_from", unit_directions(again), unit_directions(seen), 1e-9)
    if model.anchored:
        require(np.isfinite(values).all(), "a value of a landmark that can start is not finite")


def check_landmark_start_jacobians(model: LandmarkModel) -> None:
    """Derivatives of a start are those of differences, and finite wherever a landmark can be started."""
    seen = _seen(model)

    def started(h: Any, y: Any) -> Any:
        return model.local_by(y, model.start_from(h))

    far = seen.copy()
    far[:, 3] = 1e-9
    far = _able(model, far)
    by_seen = jacobian_of(started, far, columns_of(model.start_from, far))[1]
    require(np.isfinite(by_seen).all(), "a Jacobian of a start is not finite")
    nearer = seen - 2.0 * derivatives.STEP * (np.arange(seen.shape[1]) == 3)
    seen = seen[columns_of(lambda h: (model.can_start_from(h),), nearer)[:, 0].astype(bool)]
    _assert_slopes("start_from", started, seen, columns_of(model.start_from, seen))


def check_landmark_jacobians(model: LandmarkModel) -> None:
    """Derivatives of a landmark in the map are those of differences, at infinity and beyond, too."""
    values = columns_of(model.start_from, _seen(model))
    still, theta = np.zeros((len(values), model.size)), np.array([[0.1, -0.2, 0.15]])
    _assert_slopes("point_of", lambda e, y: model.point_of(model.retract_by(y, e)), still, values)
    if model.in_world:
        return
    both = np.hstack([still + 0.02, np.broadcast_to(theta, (len(values), 3))])

    def carried(x: Any, y: Any) -> Any:
        return model.turned_by(y, x[model.size :], x[: model.size])

    there = columns_of(carried, both, values)
    _assert_slopes("turned_by", lambda x, y, end: model.local_by(end, carried(x, y)), both, values, there)
    turned = columns_of(lambda y: model.turned_by(y, tuple(theta[0]), (0.0,) * model.size), values)
    seen, again = columns_of(model.point_of, values), columns_of(model.point_of, turned)
    seen[:, :3] = seen[:, :3] @ rotations.exp(theta[0]).T
    assert_close("turned_by without a correction", unit_directions(again), unit_directions(seen), 1e-9)


def check_landmark_retraction(model: LandmarkModel) -> None:
    """A correction is undone by `local_by`, and nothing is changed by none."""
    values = columns_of(model.start_from, _seen(model))
    delta = np.random.default_rng(1).uniform(-0.1, 0.1, (len(values), model.size))
    there, least = columns_of(model.retract_by, values, delta), max(1.0, np.abs(values).max())
    assert_close("retract_by nothing", columns_of(model.retract_by, values, 0.0 * delta), values, 1e-12)
    assert_close("local_by of retract_by", columns_of(model.local_by, values, there), delta, 1e-9 * least)
    slopes = jacobian_of(lambda c, y, end: model.local_by(end, model.retract_by(y, c)), delta, values, there)[1]
    differences = _slopes(lambda c, y, end: model.local_by(end, model.retract_by(y, c)), delta, values, there)
    assert_close("the derivative of retract_by", slopes, differences, max(TOLERANCE, 1e-11 * np.abs(values).max()))

    def without_a_turn(c: Any, y: Any) -> Any:
        return model.local_by(y, model.turned_by(y, (0.0, 0.0, 0.0), c))

    if not model.in_world:
        still = np.broadcast_to(np.eye(model.size), slopes.shape)
        assert_close("turned_by without a turn", _slopes(without_a_turn, 0.0 * delta, values), still)


def check_landmark_invariance(model: LandmarkModel) -> None:
    """In a world that is turned, a landmark starts where the turned one is."""
    seen = _seen(model)
    turned = np.hstack([seen[:, :3] @ TURN.T, seen[:, 3:]])
    able = columns_of(lambda h: (model.can_start_from(h),), turned)[:, 0].astype(bool)
    again = columns_of(model.point_of, columns_of(model.start_from, turned[able]))
    assert_close("a start in a turned world", unit_directions(again), unit_directions(turned[able]), 1e-9)


CHECKS: tuple[Callable[..., None], ...] = (
    check_landmark_start,
    check_landmark_start_jacobians,
    check_landmark_jacobians,
    check_landmark_retraction,
    check_landmark_invariance,
)
