"""Kernels of the error definitions: retractions of the state, and P carried along with them."""

from __future__ import annotations

import math

from numba import njit, types

from filters.engine.compiled.blas import KERNEL
from filters.engine.compiled.covariance import identity, scale_block, scale_blocks, shear_by_rotation, transform_leading
from filters.engine.compiled.prediction import (
    matrix_of,
    multiply,
    orientation,
    product_of,
    put,
    quaternion_of,
    right_jacobian_of,
    skew,
    times,
    transposed,
)
from filters.engine.compiled.recipe import FIRST_ESTIMATES, INVARIANT, QUATERNION, RIGHT_INVARIANT, Plan
from filters.engine.compiled.storage import CLONE_POSITION, CLONE_ROTATION, OWN, POINT, Scratch
from filters.engine.compiled.units import INDEX, MATRIX, PLAN, SCRATCH, VECTOR, unit
from filters.geometry.retractions import additive_transport_of
from filters.validation import FloatArray, IntArray

_additive_transport_of = njit(**KERNEL)(additive_transport_of)


@njit(**KERNEL)
def ray(theta: float, phi: float) -> tuple[float, float, float]:
    """`inverse_depth.ray_direction`."""
    across = math.cos(phi)
    return across * math.sin(theta), -math.sin(phi), across * math.cos(theta)


@njit(**KERNEL)
def angles_jacobian(x: float, y: float, z: float) -> tuple[float, ...]:
    """`inverse_depth.angles_jacobian`, row by row."""
    across_squared = x * x + z * z
    across, length_squared = math.sqrt(across_squared), across_squared + y * y
    below = length_squared * across
    return z / across_squared, 0.0, -x / across_squared, x * y / below, -across / length_squared, z * y / below


@njit(**KERNEL)
def ray_rotation(theta: float, phi: float) -> tuple[float, ...]:
    """Effect of a rotation of the world on (theta, phi): -A [m]x, row by row (2, 3)."""
    x, y, z = ray(theta, phi)
    a = angles_jacobian(x, y, z)
    return (  # -a^T [m]x = (m x a)^T
        y * a[2] - z * a[1],
        z * a[0] - x * a[2],
        x * a[1] - y * a[0],
        y * a[5] - z * a[4],
        z * a[3] - x * a[5],
        x * a[4] - y * a[3],
    )


@njit(**KERNEL)
def left_jacobian_derivative(t0: float, t1: float, t2: float, a0: float, a1: float, a2: float) -> tuple[float, ...]:
    """d (J_l(t) a) / d t, row by row."""
    square = t0 * t0 + t1 * t1 + t2 * t2
    angle = math.sqrt(square)
    if angle < 1e-1:
        b = 0.5 - square / 24.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0))
        c = 1.0 / 6.0 - square / 120.0 * (1.0 - square / 42.0 * (1.0 - square / 72.0))
        # derivatives of b and c by t, over t
        db = -1.0 / 12.0 + square / 180.0 * (1.0 - square * 3.0 / 112.0)
        dc = -1.0 / 60.0 + square / 1260.0 * (1.0 - square / 48.0)
    else:
        sine, cosine = math.sin(angle), math.cos(angle)
        b, c = (1.0 - cosine) / square, (angle - sine) / (square * angle)
        db = (angle * sine - 2.0 * (1.0 - cosine)) / (square * square)
        dc = ((1.0 - cosine) * angle - 3.0 * (angle - sine)) / (square * square * angle)
    x0, x1, x2 = t1 * a2 - t2 * a1, t2 * a0 - t0 * a2, t0 * a1 - t1 * a0
    dot = t0 * a0 + t1 * a1 + t2 * a2
    y0, y1, y2 = t0 * dot - square * a0, t1 * dot - square * a1, t2 * dot - square * a2
    u0, u1, u2 = db * x0 + dc * y0, db * x1 + dc * y1, db * x2 + dc * y2
    return (
        u0 * t0 + c * (dot + t0 * a0 - 2.0 * a0 * t0),
        u0 * t1 + b * a2 + c * (t0 * a1 - 2.0 * a0 * t1),
        u0 * t2 - b * a1 + c * (t0 * a2 - 2.0 * a0 * t2),
        u1 * t0 - b * a2 + c * (t1 * a0 - 2.0 * a1 * t0),
        u1 * t1 + c * (dot + t1 * a1 - 2.0 * a1 * t1),
        u1 * t2 + b * a0 + c * (t1 * a2 - 2.0 * a1 * t2),
        u2 * t0 + b * a1 + c * (t2 * a0 - 2.0 * a2 * t0),
        u2 * t1 - b * a0 + c * (t2 * a1 - 2.0 * a2 * t1),
        u2 * t2 + c * (dot + t2 * a2 - 2.0 * a2 * t2),
    )


@njit(**KERNEL)
def moved_by(
    plan: Plan,
    x: FloatArray,
    blocks: FloatArray,
    count: int,
    delta: FloatArray,
    kind: IntArray,
    moved: FloatArray,
    moved_blocks: FloatArray,
) -> None:
    """The state corrected by delta."""
    q0, q1, q2, v = delta[3], delta[4], delta[5], plan.velocity
    for i in range(3):
        moved[i] = x[i] + delta[i]
    for i in range(6, plan.leading):
        moved[i + 1] = x[i + 1] + delta[i]
    turn = (0.5 * q0, 0.5 * q1, 0.5 * q2, 1.0) if plan.error == QUATERNION else quaternion_of(q0, q1, q2)
    moved[3], moved[4], moved[5], moved[6] = product_of(x[3], x[4], x[5], x[6], turn[0], turn[1], turn[2], turn[3])
    leading = plan.leading
    for c in range(count):
        row = leading + 3 * c
        if kind[c] == CLONE_ROTATION:
            q0, q1, q2 = delta[row], delta[row + 1], delta[row + 2]
            own = (0.5 * q0, 0.5 * q1, 0.5 * q2, 1.0) if plan.error == QUATERNION else quaternion_of(q0, q1, q2)
            q0, q1, q2, q3 = product_of(
                blocks[c, 0], blocks[c, 1], blocks[c, 2], blocks[c, 3], own[0], own[1], own[2], own[3]
            )
            moved_blocks[c, 0], moved_blocks[c, 1], moved_blocks[c, 2], moved_blocks[c, 3] = q0, q1, q2, q3
        else:
            for i in range(3):
                moved_blocks[c, i] = blocks[c, i] + delta[row + i]
    if plan.error < RIGHT_INVARIANT:
        return
    q0, q1, q2 = delta[3], delta[4], delta[5]
    R = orientation(x)
    t0, t1, t2 = times(R, q0, q1, q2)
    J = transposed(right_jacobian_of(t0, t1, t2))
    e = quaternion_of(t0, t1, t2)
    world = matrix_of(e[0], e[1], e[2], e[3])
    for start in (0, v):  # position, linear velocity
        shift = 0 if start == 0 else 1
        a, b, c = times(J, delta[start], delta[start + 1], delta[start + 2])
        moved[start + shift] = x[start + shift] + a
        moved[start + shift + 1] = x[start + shift + 1] + b
        moved[start + shift + 2] = x[start + shift + 2] + c
    for k in range(count):
        d0, d1, d2 = delta[leading + 3 * k], delta[leading + 3 * k + 1], delta[leading + 3 * k + 2]
        if kind[k] == OWN:
            theta, phi = blocks[k, 0], blocks[k, 1]
            g = ray_rotation(theta, phi)
            theta += d0 - (g[0] * t0 + g[1] * t1 + g[2] * t2)
            phi += d1 - (g[3] * t0 + g[4] * t1 + g[5] * t2)
            mx, my, mz = ray(theta, phi)
            mx, my, mz = times(world, mx, my, mz)
            moved_blocks[k, 0] = math.atan2(mx, mz)
            moved_blocks[k, 1] = math.atan2(-my, math.sqrt(mx * mx + mz * mz))
            moved_blocks[k, 2] = blocks[k, 2] + d2
        elif kind[k] == POINT:
            a, b, c = times(J, d0, d1, d2)
            moved_blocks[k, 0], moved_blocks[k, 1] = blocks[k, 0] + a, blocks[k, 1] + b
            moved_blocks[k, 2] = blocks[k, 2] + c


@njit(**KERNEL)
def transport(
    plan: Plan,
    x: FloatArray,
    blocks: FloatArray,
    count: int,
    delta: FloatArray,
    kind: IntArray,
    moved: FloatArray,
    moved_blocks: FloatArray,
    W: FloatArray,
    D: FloatArray,
) -> None:
    """Jacobian D + W E^T that takes errors at the state to errors where delta has moved it; E selects the rotation.

    D is block-diagonal: (C, 3, 3) for the blocks, only for clones unless the error is `INVARIANT`. There W has the
    whole column of the rotation on its own rows, and D the identity; the leading points turn as the point blocks do.
    """
    leading, v = plan.leading, plan.velocity
    q0, q1, q2 = delta[3], delta[4], delta[5]
    for i in range(leading + 3 * count):
        for a in range(3):
            W[i, a] = 0.0
    if plan.error == FIRST_ESTIMATES:
        return
    R = orientation(x)
    if plan.error < RIGHT_INVARIANT or plan.error == INVARIANT:
        if plan.error == QUATERNION:
            put(W, 3, 0, _additive_transport_of(q0, q1, q2), 1.0)
        else:
            put(W, 3, 0, right_jacobian_of(q0, q1, q2), 1.0)
        for i in range(3):
            W[3 + i, i] -= 1.0
        for k in range(count):
            if kind[k] >= CLONE_POSITION:
                put(D[k], 0, 0, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), 1.0)
                if kind[k] == CLONE_ROTATION:
                    row = leading + 3 * k
                    put(D[k], 0, 0, _turned(plan, delta[row], delta[row + 1], delta[row + 2]), 1.0)
        if plan.error < RIGHT_INVARIANT:
            return
        t0, t1, t2 = times(R, q0, q1, q2)
        J = transposed(right_jacobian_of(t0, t1, t2))
        e = quaternion_of(t0, t1, t2)
        world = matrix_of(e[0], e[1], e[2], e[3])
        put(W, 0, 0, multiply(left_jacobian_derivative(t0, t1, t2, delta[0], delta[1], delta[2]), R), 1.0)
        put(W, v, 0, multiply(left_jacobian_derivative(t0, t1, t2, delta[v], delta[v + 1], delta[v + 2]), R), 1.0)
        for k in range(count):
            row = leading + 3 * k
            d0, d1, d2 = delta[row], delta[row + 1], delta[row + 2]
            if kind[k] == OWN:
                _transport_ray(blocks, moved_blocks, k, row, d0, d1, t0, t1, t2, world, J, R, W, D)
            elif kind[k] == POINT:
                put(W, row, 0, multiply(left_jacobian_derivative(t0, t1, t2, d0, d1, d2), R), 1.0)
                put(D[k], 0, 0, J, 1.0)
        return
    # right-invariant: (Gamma+ - Gamma) R_wc
    put(W, 0, 0, multiply(skew(moved[0] - x[0], moved[1] - x[1], moved[2] - x[2]), R), -1.0)
    put(
        W,
        v,
        0,
        multiply(skew(moved[v + 1] - x[v + 1], moved[v + 2] - x[v + 2], moved[v + 3] - x[v + 3]), R),
        -1.0,
    )
    put(W, 3, 0, multiply(transposed(orientation(moved)), R), 1.0)
    for i in range(3):
        W[3 + i, i] -= 1.0
    for k in range(count):
        row = leading + 3 * k
        if kind[k] == CLONE_ROTATION:  # (R+^T - R^T) R_wc
            before, after = transposed(_orientation(blocks, k)), transposed(_orientation(moved_blocks, k))
            put(W, row, 0, multiply(after, R), 1.0)
            minus = multiply(before, R)
            for i in range(9):
                W[row + i // 3, i % 3] -= minus[i]
        elif kind[k] == OWN:
            after = ray_rotation(moved_blocks[k, 0], moved_blocks[k, 1])
            before = ray_rotation(blocks[k, 0], blocks[k, 1])
            for i in range(2):
                g0, g1, g2 = (
                    after[3 * i] - before[3 * i],
                    after[3 * i + 1] - before[3 * i + 1],
                    after[3 * i + 2] - before[3 * i + 2],
                )
                for a in range(3):
                    W[row + i, a] = g0 * R[a] + g1 * R[3 + a] + g2 * R[6 + a]
        else:
            d0, d1, d2 = (
                moved_blocks[k, 0] - blocks[k, 0],
                moved_blocks[k, 1] - blocks[k, 1],
                moved_blocks[k, 2] - blocks[k, 2],
            )
            put(W, row, 0, multiply(skew(d0, d1, d2), R), -1.0)


@njit(**KERNEL)
def _turned(plan: Plan, x: float, y: float, z: float) -> tuple[float, ...]:
    """`Retraction.transport` of an orientation, row by row."""
    return _additive_transport_of(x, y, z) if plan.error == QUATERNION else right_jacobian_of(x, y, z)


@njit(**KERNEL)
def _orientation(blocks: FloatArray, k: int) -> tuple[float, ...]:
    """Rotation matrix of a block of a clone, row by row."""
    return matrix_of(blocks[k, 0], blocks[k, 1], blocks[k, 2], blocks[k, 3])


@njit(**KERNEL)
def _transport_ray(
    blocks: FloatArray,
    moved_blocks: FloatArray,
    k: int,
    row: int,
    d0: float,
    d1: float,
    t0: float,
    t1: float,
    t2: float,
    world: tuple[float, ...],
    J: tuple[float, ...],
    R: tuple[float, ...],
    W: FloatArray,
    D: FloatArray,
) -> None:
    """Rows of a direction of `transport`, `INVARIANT`: a+ = angles(Exp(theta) m(a + da - Gamma theta))."""
    g = ray_rotation(blocks[k, 0], blocks[k, 1])
    theta = blocks[k, 0] + d0 - (g[0] * t0 + g[1] * t1 + g[2] * t2)
    phi = blocks[k, 1] + d1 - (g[3] * t0 + g[4] * t1 + g[5] * t2)
    sin_theta, cos_theta, sin_phi, cos_phi = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    mx, my, mz = times(world, cos_phi * sin_theta, -sin_phi, cos_phi * cos_theta)
    A = angles_jacobian(mx, my, mz)
    u0, u1, u2 = times(world, cos_phi * cos_theta, 0.0, -cos_phi * sin_theta)
    w0, w1, w2 = times(world, -sin_phi * sin_theta, -cos_phi, -sin_phi * cos_theta)
    D[k, 0, 2] = D[k, 1, 2] = D[k, 2, 0] = D[k, 2, 1] = 0.0
    D[k, 2, 2] = 1.0
    for i in range(2):
        a0, a1, a2 = A[3 * i], A[3 * i + 1], A[3 * i + 2]
        by_theta, by_phi = a0 * u0 + a1 * u1 + a2 * u2, a0 * w0 + a1 * w1 + a2 * w2
        D[k, i, 0], D[k, i, 1] = by_theta, by_phi
        # by theta of the world: -a^T [m+]x J_l - (by the angles) Gamma
        x0, x1, x2 = my * a2 - mz * a1, mz * a0 - mx * a2, mx * a1 - my * a0
        r0 = x0 * J[0] + x1 * J[3] + x2 * J[6] - by_theta * g[0] - by_phi * g[3]
        r1 = x0 * J[1] + x1 * J[4] + x2 * J[7] - by_theta * g[1] - by_phi * g[4]
        r2 = x0 * J[2] + x1 * J[5] + x2 * J[8] - by_theta * g[2] - by_phi * g[5]
        for a in range(3):
            W[row + i, a] = r0 * R[a] + r1 * R[3 + a] + r2 * R[6 + a]


@njit(**KERNEL)
def _scale(plan: Plan, P: FloatArray, n: int, x: FloatArray, delta: FloatArray, s: Scratch) -> None:
    """The block-diagonal part of `transport` on P: `shear_by_rotation` follows, with W over what it leaves of D."""
    v = plan.velocity
    t0, t1, t2 = times(orientation(x), delta[3], delta[4], delta[5])
    J = transposed(right_jacobian_of(t0, t1, t2))
    identity(s.F)
    put(s.F, 0, 0, J, 1.0)
    put(s.F, v, v, J, 1.0)
    transform_leading(P, n, s)
    scale_blocks(P, n, plan.leading, s.D, s)


@njit(**KERNEL)
def _take_moved(x: FloatArray, blocks: FloatArray, count: int, s: Scratch) -> None:
    """The state becomes the moved one."""
    for i in range(len(x)):
        x[i] = s.moved[i]
    for c in range(count):
        for i in range(blocks.shape[1]):
            blocks[c, i] = s.moved_blocks[c, i]


@unit(PLAN, MATRIX, VECTOR, MATRIX, INDEX, types.int64, SCRATCH)
def retract(
    plan: Plan, P: FloatArray, x: FloatArray, blocks: FloatArray, kind: IntArray, count: int, s: Scratch
) -> None:
    """Move the state by delta and carry P along, the errors of landmarks being additive."""
    leading, delta = plan.leading, s.delta
    n = leading + 3 * count
    if plan.error < FIRST_ESTIMATES:
        identity(s.F)
        put(s.F, 3, 3, _turned(plan, delta[3], delta[4], delta[5]), 1.0)
        transform_leading(P, n, s)
        for c in range(count):
            row = leading + 3 * c
            if kind[c] == CLONE_ROTATION:
                scale_block(P, n, row, _turned(plan, delta[row], delta[row + 1], delta[row + 2]), s.block)
    moved_by(plan, x, blocks, count, delta, kind, s.moved, s.moved_blocks)
    _take_moved(x, blocks, count, s)


@unit(PLAN, MATRIX, VECTOR, MATRIX, INDEX, types.int64, SCRATCH)
def retract_invariant(
    plan: Plan, P: FloatArray, x: FloatArray, blocks: FloatArray, kind: IntArray, count: int, s: Scratch
) -> None:
    """The same where they turn with the world."""
    delta, n = s.delta, plan.leading + 3 * count
    moved_by(plan, x, blocks, count, delta, kind, s.moved, s.moved_blocks)
    transport(plan, x, blocks, count, delta, kind, s.moved, s.moved_blocks, s.W, s.D)
    if plan.error == INVARIANT:
        _scale(plan, P, n, x, delta, s)
    shear_by_rotation(P, n, s.W, s)
    _take_moved(x, blocks, count, s)


@unit(PLAN, MATRIX, VECTOR, MATRIX, INDEX, types.int64, SCRATCH)
def retract_by_numbers(
    plan: Plan, P: FloatArray, x: FloatArray, blocks: FloatArray, kind: IntArray, count: int, s: Scratch
) -> None:
    """The same by what the door has written: F, and D and W where `result` says so."""
    n = plan.leading + 3 * count
    transform_leading(P, n, s)
    if s.result[0] > 0.0:
        scale_blocks(P, n, plan.leading, s.D, s)
    if s.result[1] > 0.0:
        shear_by_rotation(P, n, s.W, s)
    _take_moved(x, blocks, count, s)
