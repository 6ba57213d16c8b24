"""Checks of landmark parametrisations."""

from __future__ import annotations

import numpy as np

from filters.checks.part_contracts.comparison import SCALES, SHIFT, TOLERANCE, TURN, assert_close, unit_directions
from filters.geometry import differences, rotations
from filters.landmarks.model import LandmarkModel, StartedLandmarks
from filters.validation import FloatArray

Started = tuple[FloatArray, FloatArray | None, FloatArray, StartedLandmarks]
"""Position of the camera, anchors, homogeneous points (M, 4) that were seen from the position, and the landmarks."""


def _started(model: LandmarkModel, moved: bool = True) -> Started:
    """Landmarks with their anchors where the camera was, or `moved` off."""
    rng = np.random.default_rng(0)
    position, h_w = rng.uniform(-5.0, 5.0, 3), rng.standard_normal((len(SCALES), 3))
    seen = np.column_stack([h_w, SCALES])[model.can_start(h_w, SCALES)]
    assert len(seen), "no landmark can be started"
    new = model.started(position, seen[:, :3], seen[:, 3])
    anchors = position + moved * rng.uniform(-2.0, 2.0, (len(seen), 3))
    return position, np.where(new.anchored[:, None], anchors, np.nan) if model.anchored else None, seen, new


def check_landmark_start(model: LandmarkModel) -> None:
    """A landmark is seen where it was started, of any number of them, none included."""
    position, anchors, seen, new = _started(model, moved=False)
    assert new.parameters.shape == (len(seen), model.value_size), f"parameters are {new.parameters.shape}"
    assert_close(
        "homogeneous",
        unit_directions(model.homogeneous(position, anchors, new.parameters)),
        unit_directions(seen),
        1e-9,
    )
    none = model.started(position, np.zeros((0, 3)), np.zeros(0)).parameters
    assert_close(
        "homogeneous of none",
        model.homogeneous(position, None if anchors is None else none[:, :3], none),
        none[:0, :1] @ np.ones((1, 4)),
    )


def check_landmark_start_jacobians(model: LandmarkModel) -> None:
    """Jacobians of a start are those of differences, and finite wherever a landmark can be started."""
    position, _, seen, new = _started(model)
    J = np.concatenate([new.by_position, new.by_direction, new.by_scale[:, :, None]], axis=2)
    far = seen[model.can_start(seen[:, :3], np.full(len(seen), 1e-9))]
    for by in (J, *vars(model.started(position, far[:, :3], np.full(len(far), 1e-9))).values()):
        assert np.isfinite(by).all(), "a Jacobian of a start is not finite"
    at = model.can_start(seen[:, :3], seen[:, 3] - 2.0 * differences.STEP)
    seen = seen[at]

    def moved(e: FloatArray) -> FloatArray:
        other = model.started(position + e[:3], seen[:, :3] + e[3:6], seen[:, 3] + e[6])
        return model.local(new.parameters[at], other.parameters)

    assert_close("the Jacobian of started", J[at], differences.jacobian(moved, 7))


def check_landmark_jacobians(model: LandmarkModel) -> None:
    """Jacobians of a landmark in the map are those of differences, at infinity and beyond, too."""
    position, anchors, _, new = _started(model)
    x = new.parameters
    claimed = model.relative_to(position, anchors, x)

    def seen(e: FloatArray) -> FloatArray:
        own = model.retract(x, np.broadcast_to(e[6:], (len(x), 3)))
        return model.homogeneous(position + e[:3], None if anchors is None else anchors + e[3:6], own)

    by_all = np.nan_to_num(differences.jacobian(seen, 9))
    assert_close("by_position of relative_to", claimed.by_position, by_all[:, :, :3])
    assert_close("by_map of relative_to", claimed.by_map, by_all[:, :, 6 if anchors is None else 3 :])
    turned = differences.jacobian(lambda e: model.local(x, model.rotated(anchors, x, rotations.exp(e))), 3)
    assert_close("world_rotation", model.world_rotation(anchors, x), turned)
    theta, correction = np.array([0.1, -0.2, 0.15]), np.full((len(x), 3), 0.02)

    def carried(e: FloatArray) -> FloatArray:
        turn, spread = rotations.exp(theta + e[3:]), rotations.right_jacobian(-theta - e[3:])
        return model.turned(anchors, x, turn, spread, correction + e[:3])

    there = carried(np.zeros(6))
    by_both = differences.jacobian(lambda e: model.local(there, carried(e)), 6)
    assert_close(
        "turned_jacobians", np.concatenate(model.turned_jacobians(anchors, x, theta, correction), axis=2), by_both
    )


def check_landmark_retraction(model: LandmarkModel) -> None:
    """A correction is undone by `local`, and `transport` is its Jacobian."""
    _, anchors, _, new = _started(model)
    x, delta = new.parameters, np.random.default_rng(1).uniform(-0.1, 0.1, (len(new.parameters), 3))
    there = model.retract(x, delta)
    assert_close("retract of nothing", model.retract(x, np.zeros_like(delta)), x, 1e-12)
    assert_close("local of retract", model.local(x, there), delta, 1e-9 * max(1.0, np.abs(x).max()))
    by_delta = differences.jacobian(lambda e: model.local(there, model.retract(x, delta + e)), 3)
    transport = model.transport(x, delta)
    still = np.broadcast_to(np.eye(3), by_delta.shape)
    assert_close(
        "transport", still if transport is None else transport, by_delta, max(TOLERANCE, 1e-11 * np.abs(x).max())
    )
    assert_close("turned without a turn", model.turned(anchors, x, np.eye(3), np.eye(3), delta), there, 1e-9)


def check_landmark_invariance(model: LandmarkModel) -> None:
    """A landmark is seen the same after the world has been turned or, with its anchor, shifted."""
    position, anchors, _, new = _started(model)
    x = new.parameters
    seen = model.homogeneous(position, anchors, x)
    turned = model.rotated(anchors, x, TURN)
    again = model.homogeneous(TURN @ position, None if anchors is None else anchors @ TURN.T, turned)
    assert_close("homogeneous in a turned world", again, np.column_stack([seen[:, :3] @ TURN.T, seen[:, 3]]), 1e-9)
    if anchors is not None:
        free = new.anchored
        shifted = model.homogeneous(position + SHIFT, anchors + SHIFT, x)
        assert_close("homogeneous in a shifted world", shifted[free], seen[free], 1e-9)


CHECKS = (
    check_landmark_start,
    check_landmark_start_jacobians,
    check_landmark_jacobians,
    check_landmark_retraction,
    check_landmark_invariance,
)
