"""Checks of landmark parametrisations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from filters.checks.conformance import require
from filters.checks.part_contracts.comparison import (
    SCALES,
    SHIFT,
    TOLERANCE,
    TURN,
    assert_close,
    unit_directions,
)
from filters.geometry import derivatives, rotations
from filters.geometry.arrays import FloatArray
from filters.landmarks.landmark_model import LandmarkModel, StartedLandmarks

Started = tuple[FloatArray, FloatArray | None, FloatArray, StartedLandmarks]
"""Position of the camera, anchors, what was seen from the position (M, seen_size), and the landmarks."""


def _started(model: LandmarkModel, moved: bool = True) -> Started:
    """Landmarks with their anchors where the camera was, or `moved` off."""
    rng, count = np.random.default_rng(0), len(SCALES)
    position, vectors = rng.uniform(-5.0, 5.0, 3), rng.standard_normal((count, 3 * model.seen_vectors))
    if model.in_anchor:
        position = np.zeros(3)
    others = np.column_stack([SCALES, 0.1 * rng.standard_normal((count, model.seen_size))])
    seen = np.hstack([vectors, others])[:, : model.seen_size]
    seen = seen[model.can_start(*model.apart(seen))]
    require(len(seen), "no landmark can be started")
    new = model.started(position, *model.apart(seen))
    if model.seen_size != 4:  # what can be seen may have to keep constraints, as the vectors of a line
        here = np.where(new.anchored[:, None], position, np.nan) if model.anchored else None
        seen = model.homogeneous(position, here, new.parameters)
        new = model.started(position, *model.apart(seen))
    anchors = position + moved * rng.uniform(-2.0, 2.0, (len(seen), 3))
    return position, np.where(new.anchored[:, None], anchors, np.nan) if model.anchored else None, seen, new


def check_landmark_start(model: LandmarkModel) -> None:
    """A landmark is seen where it was started, of any number of them, none included."""
    position, anchors, seen, new = _started(model, moved=False)
    require(new.parameters.shape == (len(seen), model.value_size), f"parameters are {new.parameters.shape}")
    assert_close(
        "homogeneous",
        unit_directions(model.homogeneous(position, anchors, new.parameters)),
        unit_directions(seen),
        1e-9,
    )
    require(new.by_seen.shape == (len(seen), model.size, model.seen_size), f"Jacobians are {new.by_seen.shape}")
    none = model.started(position, *model.apart(seen[:0])).parameters
    assert_close(
        "homogeneous of none",
        model.homogeneous(position, None if anchors is None else none[:, :3], none),
        none[:0, :1] @ np.ones((1, model.seen_size)),
    )


def check_landmark_start_jacobians(model: LandmarkModel) -> None:
    """Jacobians of a start are those of differences, and finite wherever a landmark can be started."""
    position, _, seen, new = _started(model)
    J, scale = np.concatenate([new.by_position, new.by_seen], axis=2), 3 * model.seen_vectors
    far, nearer = seen.copy(), seen.copy()
    far[:, scale : scale + 1], nearer[:, scale:] = 1e-9, nearer[:, scale:] - 2.0 * derivatives.STEP
    far = far[model.can_start(*model.apart(far))]
    for by in (J, *vars(model.started(position, *model.apart(far))).values()):
        require(np.isfinite(by).all(), "a Jacobian of a start is not finite")
    at = model.can_start(*model.apart(nearer))
    seen = seen[at]

    def moved(e: FloatArray) -> FloatArray:
        other = model.started(position + e[:3], *model.apart(seen + e[3:]))
        return model.local(new.parameters[at], other.parameters)

    assert_close("the Jacobian of started", J[at], derivatives.jacobian(moved, 3 + model.seen_size))


def check_landmark_jacobians(model: LandmarkModel) -> None:
    """Jacobians of a landmark in the map are those of differences, at infinity and beyond, too."""
    position, anchors, _, new = _started(model)
    x = new.parameters
    claimed = model.relative_to(position, anchors, x)

    def seen(e: FloatArray) -> FloatArray:
        own = model.retract(x, np.broadcast_to(e[6:], (len(x), model.size)))
        return model.homogeneous(position + e[:3], None if anchors is None else anchors + e[3:6], own)

    by_all = np.nan_to_num(derivatives.jacobian(seen, 6 + model.size))
    assert_close("by_position of relative_to", claimed.by_position, by_all[:, :, :3])
    assert_close("by_map of relative_to", claimed.by_map, by_all[:, :, 6 if anchors is None else 3 :])
    turned = derivatives.jacobian(lambda e: model.local(x, model.rotated(anchors, x, rotations.exp(e))), 3)
    assert_close("world_rotation", model.world_rotation(anchors, x), turned)
    theta, correction = np.array([0.1, -0.2, 0.15]), np.full((len(x), model.size), 0.02)

    def carried(e: FloatArray) -> FloatArray:
        return model.turned(anchors, x, theta + e[:3], correction + e[3:])

    uncorrected = model.turned(anchors, x, theta, np.zeros_like(correction))
    assert_close("turned without a correction", uncorrected, model.rotated(anchors, x, rotations.exp(theta)), 1e-9)
    there = carried(np.zeros(3 + model.size))
    by_both = derivatives.jacobian(lambda e: model.local(there, carried(e)), 3 + model.size)
    claimed_both = model.turned_jacobians(anchors, x, theta, correction)
    assert_close("turned_jacobians", np.concatenate(claimed_both[::-1], axis=2), by_both)


def check_landmark_retraction(model: LandmarkModel) -> None:
    """A correction is undone by `local`, and `transport` is its Jacobian."""
    _, anchors, _, new = _started(model)
    x, delta = new.parameters, np.random.default_rng(1).uniform(-0.1, 0.1, (len(new.parameters), model.size))
    there = model.retract(x, delta)
    assert_close("retract of nothing", model.retract(x, np.zeros_like(delta)), x, 1e-12)
    assert_close("local of retract", model.local(x, there), delta, 1e-9 * max(1.0, np.abs(x).max()))
    by_delta = derivatives.jacobian(lambda e: model.local(there, model.retract(x, delta + e)), model.size)
    transport = model.transport(x, delta)
    still = np.broadcast_to(np.eye(model.size), by_delta.shape)
    assert_close(
        "transport", still if transport is None else transport, by_delta, max(TOLERANCE, 1e-11 * np.abs(x).max())
    )

    def without_a_turn(e: FloatArray) -> FloatArray:
        return model.local(x, model.turned(anchors, x, np.zeros(3), np.zeros_like(delta) + e))

    assert_close("turned without a turn", derivatives.jacobian(without_a_turn, model.size), still)


def check_landmark_invariance(model: LandmarkModel) -> None:
    """A landmark is seen the same after the world has been turned or, with its anchor, shifted."""
    position, anchors, _, new = _started(model)
    x = new.parameters
    seen = model.homogeneous(position, anchors, x)
    if model.in_anchor:
        assert_close("rotated of what is in the axes of the anchor", model.rotated(anchors, x, TURN), x, 1e-12)
        return
    turned = model.rotated(anchors, x, TURN)
    again = model.homogeneous(TURN @ position, None if anchors is None else anchors @ TURN.T, turned)
    assert_close("homogeneous in a turned world", again, model.with_axes(TURN, seen), 1e-9)
    if anchors is None and (model.in_world or type(model).shifted is not LandmarkModel.shifted):
        shifted = model.homogeneous(position + SHIFT, None, model.shifted(x, SHIFT))
        assert_close("shifted in a shifted world", unit_directions(shifted), unit_directions(seen), 1e-9)
        by_shift = derivatives.jacobian(lambda e: model.local(x, model.shifted(x, e)), 3)
        assert_close("world_translation", model.world_translation(x), by_shift)
    if anchors is not None:
        free = new.anchored
        shifted = model.homogeneous(position + SHIFT, anchors + SHIFT, x)
        assert_close("homogeneous in a shifted world", shifted[free], seen[free], 1e-9)


CHECKS: tuple[Callable[..., None], ...] = (
    check_landmark_start,
    check_landmark_start_jacobians,
    check_landmark_jacobians,
    check_landmark_retraction,
    check_landmark_invariance,
)
