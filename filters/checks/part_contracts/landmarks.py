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
    Kernels,
    assert_close,
    assert_same,
    unit_directions,
)
from filters.geometry import differences, rotations
from filters.geometry.arrays import FloatArray
from filters.landmarks.landmark_model import LandmarkModel, StartedLandmarks
from filters.parts import kernels_of

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
    far[:, scale : scale + 1], nearer[:, scale:] = 1e-9, nearer[:, scale:] - 2.0 * differences.STEP
    far = far[model.can_start(*model.apart(far))]
    for by in (J, *vars(model.started(position, *model.apart(far))).values()):
        require(np.isfinite(by).all(), "a Jacobian of a start is not finite")
    at = model.can_start(*model.apart(nearer))
    seen = seen[at]

    def moved(e: FloatArray) -> FloatArray:
        other = model.started(position + e[:3], *model.apart(seen + e[3:]))
        return model.local(new.parameters[at], other.parameters)

    assert_close("the Jacobian of started", J[at], differences.jacobian(moved, 3 + model.seen_size))


def check_landmark_jacobians(model: LandmarkModel) -> None:
    """Jacobians of a landmark in the map are those of differences, at infinity and beyond, too."""
    position, anchors, _, new = _started(model)
    x = new.parameters
    claimed = model.relative_to(position, anchors, x)

    def seen(e: FloatArray) -> FloatArray:
        own = model.retract(x, np.broadcast_to(e[6:], (len(x), model.size)))
        return model.homogeneous(position + e[:3], None if anchors is None else anchors + e[3:6], own)

    by_all = np.nan_to_num(differences.jacobian(seen, 6 + model.size))
    assert_close("by_position of relative_to", claimed.by_position, by_all[:, :, :3])
    assert_close("by_map of relative_to", claimed.by_map, by_all[:, :, 6 if anchors is None else 3 :])
    turned = differences.jacobian(lambda e: model.local(x, model.rotated(anchors, x, rotations.exp(e))), 3)
    assert_close("world_rotation", model.world_rotation(anchors, x), turned)
    theta, correction = np.array([0.1, -0.2, 0.15]), np.full((len(x), model.size), 0.02)

    def carried(e: FloatArray) -> FloatArray:
        turn, spread = rotations.exp(theta + e[:3]), rotations.right_jacobian(-theta - e[:3])
        return model.turned(anchors, x, turn, spread, correction + e[3:])

    turn, spread = rotations.exp(theta), rotations.right_jacobian(-theta)
    uncorrected = model.turned(anchors, x, turn, spread, np.zeros_like(correction))
    assert_close("turned without a correction", uncorrected, model.rotated(anchors, x, turn), 1e-9)
    there = carried(np.zeros(3 + model.size))
    by_both = differences.jacobian(lambda e: model.local(there, carried(e)), 3 + model.size)
    claimed_both = model.turned_jacobians(anchors, x, theta, correction)
    assert_close("turned_jacobians", np.concatenate(claimed_both[::-1], axis=2), by_both)


def check_landmark_retraction(model: LandmarkModel) -> None:
    """A correction is undone by `local`, and `transport` is its Jacobian."""
    _, anchors, _, new = _started(model)
    x, delta = new.parameters, np.random.default_rng(1).uniform(-0.1, 0.1, (len(new.parameters), model.size))
    there = model.retract(x, delta)
    assert_close("retract of nothing", model.retract(x, np.zeros_like(delta)), x, 1e-12)
    assert_close("local of retract", model.local(x, there), delta, 1e-9 * max(1.0, np.abs(x).max()))
    by_delta = differences.jacobian(lambda e: model.local(there, model.retract(x, delta + e)), model.size)
    transport = model.transport(x, delta)
    still = np.broadcast_to(np.eye(model.size), by_delta.shape)
    assert_close(
        "transport", still if transport is None else transport, by_delta, max(TOLERANCE, 1e-11 * np.abs(x).max())
    )

    def without_a_turn(e: FloatArray) -> FloatArray:
        return model.local(x, model.turned(anchors, x, np.eye(3), np.eye(3), np.zeros_like(delta) + e))

    assert_close("turned without a turn", differences.jacobian(without_a_turn, model.size), still)


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
    if anchors is None and type(model).shifted is not LandmarkModel.shifted:
        shifted = model.homogeneous(position + SHIFT, None, model.shifted(x, SHIFT))
        assert_close("shifted in a shifted world", unit_directions(shifted), unit_directions(seen), 1e-9)
        by_shift = differences.jacobian(lambda e: model.local(x, model.shifted(x, e)), 3)
        assert_close("world_translation", model.world_translation(x), by_shift)
    if anchors is not None:
        free = new.anchored
        shifted = model.homogeneous(position + SHIFT, anchors + SHIFT, x)
        assert_close("homogeneous in a shifted world", shifted[free], seen[free], 1e-9)


def check_landmark_kernels(model: LandmarkModel) -> None:
    """Compiled functions, where there are any, say what those in NumPy do."""
    if kernels_of(model) is None:
        return
    kernels, (position, anchors, seen, new) = Kernels(model), _started(model, moved=False)
    x, count, v, n, k = new.parameters, len(seen), model.value_size, model.size, model.seen_size
    points, J = kernels.of("point", x, points=(count, k), J=(count, k, n))
    claimed = model.relative_to(position, anchors, x)
    shift = np.zeros(3) if anchors is not None else position
    points[:, :3] -= points[:, 3:4] * shift
    J[:, :3] -= J[:, 3:4] * shift[:, None]
    assert_same("point", points=(points, claimed.homogeneous), J=(J, claimed.by_map[:, :, -n:]))
    from_origin = np.column_stack([seen[:, :3] + seen[:, 3:4] * shift, seen[:, 3:]])
    flags = np.zeros(count, dtype=np.bool_)
    values, J, able = kernels.of("start", from_origin, values=(count, v), J=(count, n, k), possible=flags)
    require(able.all(), "possible of kernel start is false where can_start is true")
    J[:, :, 3] += J[:, :, :3] @ shift
    assert_same("start", values=(values, x), J=(J, new.by_seen))
    if kernels_of(model).turn is None:
        of_points = np.zeros((count, n, 3))
        of_points[:, :3] = -rotations.skew(x[:, :3])
        assert_close("world_rotation of a point of W", model.world_rotation(anchors, x), of_points)
        return
    (effect,) = kernels.of("rotation", x, effect=(count, n, 3))
    assert_same("rotation", effect=(effect, model.world_rotation(anchors, x)))
    theta, correction = np.array([0.1, -0.2, 0.15]), np.full((count, n), 0.02)
    results = {"moved": (count, v), "J": (count, n, n), "J_theta": (count, n, 3)}
    moved, J, by_theta = kernels.of("turn", x, theta, correction, **results)
    turned = model.turned(anchors, x, rotations.exp(theta), rotations.right_jacobian(-theta), correction)
    wanted = model.turned_jacobians(anchors, x, theta, correction)
    assert_same("turn", moved=(moved, turned), J=(J, wanted[0]), J_theta=(by_theta, wanted[1]))
    if kernels_of(model).become is None:
        return
    position, anchors, _, new = _started(model)
    x = new.parameters
    if anchors is None:
        raise AssertionError("only landmarks with an anchor have kernel become")
    for scale in SCALES:  # from landmarks that are hardly known to such as are known well
        variances = np.full(x.shape, 0.1 * scale**2)
        (chosen,) = kernels.of("become", anchors - position, x, variances, becomes=np.zeros(count, dtype=np.bool_))
        require((chosen == model.become_points(position, anchors, x, variances)).all(), "become is not become_points")


CHECKS: tuple[Callable[..., None], ...] = (
    check_landmark_start,
    check_landmark_start_jacobians,
    check_landmark_jacobians,
    check_landmark_retraction,
    check_landmark_invariance,
    check_landmark_kernels,
)
