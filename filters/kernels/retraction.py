"""Kernels of the error definitions: corrections of the state, and P carried along with them.

Derivation: docs/derivations/errors.md.
"""

from __future__ import annotations

from filters.geometry.arrays import FloatArray
from filters.geometry.poses import additive_transport_of
from filters.geometry.rotations import (
    Four,
    Nine,
    left_jacobian_derivative_of,
    matrix_of,
    product_of,
    quaternion_of,
    right_jacobian_of,
)
from filters.geometry.vectors import IDENTITY, cross_matrix, multiply, put, times, transposed
from filters.kernels.blas import kernel
from filters.kernels.calls import Calls, call, unit
from filters.kernels.covariance import clear, identity, orientation, scale_block, transform_leading
from filters.kernels.linearisation import clear_all
from filters.kernels.recipe import Plan
from filters.kernels.records import AXES, BLOCKS, CLONE_ROTATION, OWN, PLAIN, POINT, Scratch, Storage

CORRECTED, SETTLED = range(2)
"""What a correction does to first estimates: landmarks leave them, odometry and other measurements move them along."""


@kernel
def _rotated(plan: Plan, q: FloatArray, x: float, y: float, z: float) -> Four:
    """Retraction of an orientation."""
    if plan.additive_quaternion:
        return product_of(q[0], q[1], q[2], q[3], 0.5 * x, 0.5 * y, 0.5 * z, 1.0)
    e0, e1, e2, e3 = quaternion_of(x, y, z)
    return product_of(q[0], q[1], q[2], q[3], e0, e1, e2, e3)


@kernel
def _rotation_transport(plan: Plan, x: float, y: float, z: float) -> Nine:
    """Its `Retraction.transport`, row by row."""
    return additive_transport_of(x, y, z) if plan.additive_quaternion else right_jacobian_of(x, y, z)


@kernel
def _orientation(blocks: FloatArray, k: int) -> Nine:
    """Rotation matrix of a block of a clone, row by row."""
    return matrix_of(blocks[k, 0], blocks[k, 1], blocks[k, 2], blocks[k, 3])


@unit("turn_own")
def turn_own(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch) -> None:
    """The landmarks' own values corrected by delta in `moved_blocks`, and their rows of the Jacobian in D and W.

    Where camera and map turn together that is a turn by `theta` after a correction less what the turn does.
    """
    blocks, kind, delta, theta = S.blocks[b], S.kind[b], s.delta, s.theta
    R, values, count = orientation(S.x[b]), s.values_taken.shape[1], 0
    theta[0], theta[1], theta[2] = 0.0, 0.0, 0.0
    if plan.turns:
        theta[0], theta[1], theta[2] = times(R, delta[3], delta[4], delta[5])
    for k in range(S.counts[b, BLOCKS]):
        if kind[k] == OWN:
            row = plan.leading + plan.size * k
            s.taken[count] = k
            for a in range(values):
                s.values_taken[count, a] = blocks[k, a]
            for a in range(plan.size):
                s.correction[count, a] = delta[row + a]
            count += 1
    if count == 0:
        return
    clear_all(s.effect, count)
    if plan.turns:
        call(calls.rotation, (plan.landmark, s.values_taken[:count], s.effect[:count]))
        for i in range(count):
            for a in range(plan.size):
                for c in range(3):
                    s.correction[i, a] -= s.effect[i, a, c] * theta[c]
    clear_all(s.by_correction, count)
    clear_all(s.by_theta, count)
    clear(s.values_moved[:count])
    arguments = plan.landmark, s.values_taken[:count], theta, s.correction[:count], s.values_moved[:count]
    call(calls.turn, (*arguments, s.by_correction[:count], s.by_theta[:count]))
    for i in range(count):
        for a in range(values):
            s.moved_blocks[s.taken[i], a] = s.values_moved[i, a]
    full = plan.resets or not plan.turns
    if not full:  # the effect of a turn there less that here
        for i in range(count):
            for a in range(plan.size):
                for c in range(3):
                    s.by_theta[i, a, c] = -s.effect[i, a, c]
        clear_all(s.effect, count)
        call(calls.rotation, (plan.landmark, s.values_moved[:count], s.effect[:count]))
    for i in range(count):
        row, J = plan.leading + plan.size * s.taken[i], s.by_correction[i]
        for a in range(plan.size):
            if full:
                for c in range(plan.size):
                    s.D[s.taken[i], a, c] = J[a, c]
            for c in range(3):
                by_turn = s.by_theta[i, a, c]
                if full:
                    for k in range(plan.size):
                        by_turn -= J[a, k] * s.effect[i, k, c]
                else:
                    by_turn += s.effect[i, a, c]
                if plan.turns:
                    for m in range(3):
                        s.W[row + a, m] += by_turn * R[3 * c + m]


@kernel
def scales_blocks(plan: Plan) -> bool:
    """Whether the blocks of D matter: where P goes to the new tangent spaces, and these are others."""
    return plan.resets or not (plan.additive or plan.turns or plan.first_estimates)


@kernel
def put_variables(plan: Plan, delta: FloatArray, F: FloatArray) -> None:
    """Jacobians of the retraction of variables that are orientations, in F."""
    for k in range(len(plan.rotations)):
        row = plan.rotations[k, 0]
        put(F, row, row, right_jacobian_of(delta[row], delta[row + 1], delta[row + 2]), 1.0)


@kernel
def move(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch) -> None:
    """The state corrected by delta in `moved` and `moved_blocks`, and the Jacobian D + W E^T that takes errors there.

    E selects the rotation, and W has the whole column of it on its own rows. D is block-diagonal, (C, s, s) for the
    blocks, and the identity for the other leading rows; where it `resets`, leading points turn as the point blocks do.
    """
    x, blocks, kind, count, delta = S.x[b], S.blocks[b], S.kind[b], S.counts[b, BLOCKS], s.delta
    leading, v, moved, moved_blocks, W, D = plan.leading, plan.velocity, s.moved, s.moved_blocks, s.W, s.D
    for i in range(leading + plan.size * count):
        W[i, 0] = W[i, 1] = W[i, 2] = 0.0
    for i in range(3):
        moved[i] = x[i] + delta[i]
    for i in range(6, leading):
        moved[i + 1] = x[i + 1] + delta[i]
    moved[3], moved[4], moved[5], moved[6] = _rotated(plan, x[3:7], delta[3], delta[4], delta[5])
    for k in range(len(plan.rotations)):
        row, at = plan.rotations[k, 0], plan.rotations[k, 1]
        e0, e1, e2, e3 = quaternion_of(delta[row], delta[row + 1], delta[row + 2])
        q0, q1, q2, q3 = product_of(x[at], x[at + 1], x[at + 2], x[at + 3], e0, e1, e2, e3)
        moved[at], moved[at + 1], moved[at + 2], moved[at + 3] = q0, q1, q2, q3
    R = orientation(x)
    t0, t1, t2 = times(R, delta[3], delta[4], delta[5])
    spread = transposed(right_jacobian_of(t0, t1, t2))
    for k in range(count):
        row = leading + plan.size * k
        d0, d1, d2 = delta[row], delta[row + 1], delta[row + 2]
        put(D[k], 0, 0, IDENTITY, 1.0)
        for a in range(3, plan.size):
            for c in range(a):
                D[k, a, c] = D[k, c, a] = 0.0
            D[k, a, a] = 1.0
        if CLONE_ROTATION <= kind[k] <= AXES:
            q0, q1, q2, q3 = _rotated(plan, blocks[k], d0, d1, d2)
            moved_blocks[k, 0], moved_blocks[k, 1], moved_blocks[k, 2], moved_blocks[k, 3] = q0, q1, q2, q3
            put(D[k], 0, 0, _rotation_transport(plan, d0, d1, d2), 1.0)
            continue
        if plan.turns and kind[k] == POINT:
            if plan.resets:
                put(W, row, 0, multiply(left_jacobian_derivative_of(t0, t1, t2, d0, d1, d2), R), 1.0)
                put(D[k], 0, 0, spread, 1.0)
            d0, d1, d2 = times(spread, d0, d1, d2)
        moved_blocks[k, 0], moved_blocks[k, 1], moved_blocks[k, 2] = (
            blocks[k, 0] + d0,
            blocks[k, 1] + d1,
            blocks[k, 2] + d2,
        )
        for a in range(3, blocks.shape[1]):
            moved_blocks[k, a] = blocks[k, a] + (delta[row + a] if a < plan.size else 0.0)
    if plan.turns or not plan.additive:
        call(calls.turn_own, (calls, plan, S, b, s))
    if plan.first_estimates:  # errors stay those of the linearisation point
        return
    if not plan.turns or plan.resets:
        put(W, 3, 0, _rotation_transport(plan, delta[3], delta[4], delta[5]), 1.0)
    if plan.turns:
        for first in (0, v):  # position, linear velocity
            at = first if first == 0 else first + 1
            d0, d1, d2 = delta[first], delta[first + 1], delta[first + 2]
            if plan.resets:
                put(W, first, 0, multiply(left_jacobian_derivative_of(t0, t1, t2, d0, d1, d2), R), 1.0)
            d0, d1, d2 = times(spread, d0, d1, d2)
            moved[at], moved[at + 1], moved[at + 2] = x[at] + d0, x[at + 1] + d1, x[at + 2] + d2
        if not plan.resets:
            call(calls.turn_with_world, (plan, S, b, s))
    for i in range(3):
        W[3 + i, i] -= 1.0


@unit("turn_with_world")
def turn_with_world(plan: Plan, S: Storage, b: int, s: Scratch) -> None:
    """(Gamma+ - Gamma) R_wc of all but the landmarks' own rows, in W: what a turn of the world does there and here."""
    x, moved, blocks, moved_blocks, kind, W = S.x[b], s.moved, S.blocks[b], s.moved_blocks, S.kind[b], s.W
    R = orientation(x)
    put(W, 3, 0, multiply(transposed(orientation(moved)), R), 1.0)
    _put_shift(W, 0, x, moved, 0, R)
    _put_shift(W, plan.velocity, x, moved, plan.velocity + 1, R)
    for row in plan.in_world:
        _put_shift(W, row, x, moved, row + 1, R)
    for k in range(S.counts[b, BLOCKS]):
        row = plan.leading + plan.size * k
        if CLONE_ROTATION <= kind[k] <= AXES:
            put(W, row, 0, multiply(transposed(_orientation(moved_blocks, k)), R), 1.0)
            before = multiply(transposed(_orientation(blocks, k)), R)
            for i in range(9):
                W[row + i // 3, i % 3] -= before[i]
        elif kind[k] != OWN and kind[k] != PLAIN:
            _put_shift(W, row, blocks[k], moved_blocks[k], 0, R)


@kernel
def _put_shift(W: FloatArray, row: int, before: FloatArray, after: FloatArray, at: int, R: Nine) -> None:
    """-[after - before]x R_wc of a point."""
    shift = cross_matrix(after[at] - before[at], after[at + 1] - before[at + 1], after[at + 2] - before[at + 2])
    put(W, row, 0, multiply(shift, R), -1.0)


@kernel
def _take_moved(x: FloatArray, blocks: FloatArray, count: int, s: Scratch) -> None:
    """The state becomes the moved one."""
    for i in range(len(x)):
        x[i] = s.moved[i]
    for c in range(count):
        for i in range(blocks.shape[1]):
            blocks[c, i] = s.moved_blocks[c, i]


@unit("retract")
def retract(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch) -> None:
    """Move the state by delta and carry P along."""
    P, count, delta = S.P[b], S.counts[b, BLOCKS], s.delta
    n = plan.leading + plan.size * count
    move(calls, plan, S, b, s)
    if plan.resets:
        t0, t1, t2 = times(orientation(S.x[b]), delta[3], delta[4], delta[5])
        spread = transposed(right_jacobian_of(t0, t1, t2))
        identity(s.F)
        put(s.F, 0, 0, spread, 1.0)
        put(s.F, plan.velocity, plan.velocity, spread, 1.0)
        put_variables(plan, delta, s.F)
        transform_leading(P, n, s)
    elif not plan.first_estimates and not (plan.turns and len(plan.rotations) == 0):
        identity(s.F)
        if not plan.turns:
            put(s.F, 3, 3, _rotation_transport(plan, delta[3], delta[4], delta[5]), 1.0)
        put_variables(plan, delta, s.F)
        transform_leading(P, n, s)
    if scales_blocks(plan):
        call(calls.scale_blocks, (plan, P, n, s))
    elif not (plan.turns or plan.first_estimates):
        for c in range(count):
            if CLONE_ROTATION <= S.kind[b, c] <= AXES:
                row = plan.leading + plan.size * c
                D = _rotation_transport(plan, delta[row], delta[row + 1], delta[row + 2])
                scale_block(P, n, row, D, s.block)
    if plan.turns:
        call(calls.shear, (P, n, s))
    _take_moved(S.x[b], S.blocks[b], count, s)


@kernel
def correct_state(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, what: int) -> None:
    """Move the state by delta and carry P along."""
    call(calls.retract, (calls, plan, S, b, s))
    if what == SETTLED:
        x, predicted = S.x[b], S.predicted[b]
        if plan.first_estimates:
            call(calls.settle, (plan, S.P[b], plan.leading + plan.size * S.counts[b, BLOCKS], x, predicted, s))
        for i in range(len(x)):
            predicted[i] = x[i]
