"""Process noise of the map: steps of measured landmarks, numbers that fade, and the gauge walk.

The gauge walk moves camera and map together in the six directions that vision cannot see. It stands for errors that all
tracks of a frame have in common: they show in no innovation, and turn and shift the whole estimate. They grow with the
motion of the image, as the errors of the single tracks do. A measurement says nothing about these directions, so the
walk costs it nothing, provided that the Jacobians know them: those of first-estimates and right-invariant errors do,
other ones take a large variance there for information.
"""

from __future__ import annotations

import math

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.rotations import Nine, matrix_of, product_of
from filters.geometry.vectors import IDENTITY, cross_matrix, transposed
from filters.kernels.blas import add_square, kernel
from filters.kernels.calls import Calls, call, exists, unit
from filters.kernels.covariance import orientation
from filters.kernels.linearisation import clear_all, from_camera, take_points
from filters.kernels.recipe import Plan
from filters.kernels.records import AXES, BLOCKS, LANDMARKS, OWN, POINT, VECTOR, Scratch, Storage

SMALLEST_DETERMINANT = 1e-3
"""Of d(u, v, d) / d(own numbers): below, a landmark is so far that a step in the image has no place in the map."""


@kernel
def step_covariance(part: FloatArray, R: FloatArray, Q: FloatArray) -> None:
    """Covariance of a step in (u, v, d): Q = share^2 R + diag(pixels^2)."""
    for a in range(3):
        for b in range(3):
            Q[a, b] = part[0] * R[a, b]
        Q[a, a] += part[1 + a]


@kernel
def take_steps(plan: Plan, part: FloatArray, P: FloatArray, s: Scratch, select: IntArray, count: int) -> None:
    """P_own += J^-1 Q J^-T of the selected landmarks, linearised, J = d(u, v, d) / d(own numbers)."""
    first = plan.measured + 3 * plan.anchors
    Q, inverse, half = s.small[0], s.small[1], s.small[2]
    for i in range(count):
        m = select[i]
        J, own = s.H[m], s.base[m, 1]
        for a in range(3):  # cofactors
            b, c = (a + 1) % 3, (a + 2) % 3
            for k in range(3):
                p, q = (k + 1) % 3, (k + 2) % 3
                inverse[k, a] = J[b, first + p] * J[c, first + q] - J[b, first + q] * J[c, first + p]
        determinant = 0.0
        for k in range(3):
            determinant += J[0, first + k] * inverse[k, 0]
        if not abs(determinant) >= SMALLEST_DETERMINANT:
            continue
        step_covariance(part, s.noise[m], Q)
        for a in range(3):
            for b in range(3):
                half[a, b] = 0.0
                for k in range(3):
                    half[a, b] += inverse[a, k] * Q[k, b] / determinant
        for a in range(3):
            for b in range(a, 3):
                total = 0.0
                for k in range(3):
                    total += half[a, k] * inverse[b, k]
                P[own + a, own + b] += total / determinant


@unit("fade")
def fade(plan: Plan, S: Storage, b: int, s: Scratch, dt: float) -> None:
    """Numbers of landmarks behind the third go back to zero, their covariance to `prior`, in a step of dt."""
    P, blocks, memory_share = S.P[b], S.blocks[b], math.exp(-dt / plan.memory)
    n, factors = plan.leading + plan.size * S.counts[b, BLOCKS], s.G[0]
    for i in range(n):
        factors[i] = 1.0
    for k in range(S.counts[b, BLOCKS]):
        if S.kind[b, k] == OWN or S.kind[b, k] == POINT:
            for a in range(3, plan.size):
                factors[plan.leading + plan.size * k + a] = memory_share
                blocks[k, a] *= memory_share
    for i in range(n):
        for j in range(i, n):
            P[i, j] *= factors[i] * factors[j]
    for k in range(S.counts[b, BLOCKS]):
        first = plan.leading + plan.size * k
        if factors[first + 3] == memory_share:
            for a in range(3, plan.size):
                for c in range(a, plan.size):
                    P[first + a, first + c] += (1.0 - memory_share * memory_share) * plan.prior[a - 3, c - 3]


@unit("drift")
def drift(
    calls: Calls, plan: Plan, part: int, variant: int, stage: int, S: Storage, b: int, s: Scratch, count: int
) -> None:
    """Steps of the selected landmarks before the first stage, by the Jacobian of (u, v, d)."""
    if not plan.drift[part].any():
        return
    x, blocks, last_row = S.x[b], S.blocks[b], plan.T.shape[1] - 1
    call(calls.linearise, (calls, plan, variant, last_row, S, b, x, blocks, s, count))
    take_steps(plan, plan.drift[part], S.P[b], s, s.select, count)
    call(calls.linearise, (calls, plan, variant, stage, S, b, x, blocks, s, count))


TURN_WEIGHT = 5.0
"""Of the flow that a turn makes. It moves all points in the same direction, and so do the errors that it brings; ahead,
points move away from each other and their errors cancel in part. Measured: docs/covariances.md."""
FARTHEST = 1000.0
"""Mean distance of landmarks, m, beyond which the walk of the position grows no further."""


@kernel
def _put_columns(B: FloatArray, first: int, column: int, nine: Nine, sign: float) -> None:
    """B^T[column:, first:] (3, 3) = a matrix, row by row, up to its sign; B is stored with its columns as rows."""
    for i, number in enumerate(nine):
        B[first + i % 3, column + i // 3] = sign * number


@kernel
def _image_motion(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, before: FloatArray) -> tuple[float, float]:
    """Distance by which landmarks move on the sphere of bearings since the camera was at `before`, and their distance.

    `TURN_WEIGHT` times the turn + mean |step x p| / |p|^2, rad; 1 / mean (1 / |p|), at most `FARTHEST`, m.
    """
    x, blocks, own, anchor = S.x[b], S.blocks[b], S.own[b], S.anchor[b]
    a0, a1, a2, a3 = product_of(-before[3], -before[4], -before[5], before[6], x[3], x[4], x[5], x[6])
    turn = 2.0 * math.atan2(math.sqrt(a0 * a0 + a1 * a1 + a2 * a2), abs(a3))
    s0, s1, s2 = x[0] - before[0], x[1] - before[1], x[2] - before[2]
    count, by_step, inverse = S.counts[b, LANDMARKS], 0.0, 0.0
    if count == 0:
        return 0.0, FARTHEST
    for i in range(count):
        s.taken[i] = own[i]
    take_points(calls, plan, blocks, S.kind[b], s, count)
    for i in range(count):
        h0, h1, h2, scale = s.points[i, 0], s.points[i, 1], s.points[i, 2], s.points[i, 3]
        d0, d1, d2 = from_camera(plan, x, blocks, anchor[i])
        h0, h1, h2 = h0 + scale * d0, h1 + scale * d1, h2 + scale * d2
        squared, scale = h0 * h0 + h1 * h1 + h2 * h2, max(scale, 0.0)
        c0, c1, c2 = s1 * h2 - s2 * h1, s2 * h0 - s0 * h2, s0 * h1 - s1 * h0
        by_step += scale * math.sqrt(c0 * c0 + c1 * c1 + c2 * c2) / squared
        inverse += scale / math.sqrt(squared)
    return TURN_WEIGHT * turn + by_step / count, 1.0 / max(inverse / count, 1.0 / FARTHEST)


@kernel
def _find_directions(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, n: int) -> None:
    """Effects of a rotation of the world about the camera, and of a shift of the world, at the first estimates or now.

    In the first six rows of HP.
    """
    counts, x, B = S.counts[b], S.x[b], s.HP
    blocks = S.first[b] if plan.first_estimates else S.blocks[b]
    for k in range(6):
        for j in range(n):
            B[k, j] = 0.0
    v = plan.velocity
    _put_columns(B, 3, 0, IDENTITY, 1.0)
    _put_columns(B, 0, 3, transposed(orientation(x)), 1.0)
    _put_columns(B, 0, v, cross_matrix(x[v + 1], x[v + 2], x[v + 3]), -1.0)
    for row in plan.in_world:
        _put_columns(B, 0, row, cross_matrix(x[row + 1], x[row + 2], x[row + 3]), -1.0)
    turning = 0
    for c in range(counts[BLOCKS]):
        column = plan.leading + plan.size * c
        if S.kind[b, c] == OWN:
            s.taken[turning] = c
            for a in range(s.values_taken.shape[1]):
                s.values_taken[turning, a] = blocks[c, a]
            turning += 1
        elif S.kind[b, c] == POINT:  # clones stay where the camera was
            away = cross_matrix(blocks[c, 0] - x[0], blocks[c, 1] - x[1], blocks[c, 2] - x[2])
            _put_columns(B, 0, column, away, -1.0)
            _put_columns(B, 3, column, IDENTITY, 1.0)
        elif S.kind[b, c] == AXES:
            turn = matrix_of(blocks[c, 0], blocks[c, 1], blocks[c, 2], blocks[c, 3])
            _put_columns(B, 0, column, transposed(turn), 1.0)
        elif S.kind[b, c] == VECTOR:
            _put_columns(B, 0, column, cross_matrix(blocks[c, 0], blocks[c, 1], blocks[c, 2]), -1.0)
    if turning > 0:
        clear_all(s.effect, turning)
        call(calls.rotation, (plan.landmark, s.values_taken[:turning], s.effect[:turning]))
    for i in range(turning):
        column = plan.leading + plan.size * s.taken[i]
        for k in range(3):
            for a in range(plan.size):
                B[k, column + a] = s.effect[i, a, k]
    if turning > 0 and exists(calls.shift):  # without an anchor, and no points: they have a place of their own
        clear_all(s.effect, turning)
        call(calls.shift, (plan.landmark, s.values_taken[:turning], s.effect[:turning]))
        for i in range(turning):
            column = plan.leading + plan.size * s.taken[i]
            for a in range(plan.size):
                t0, t1, t2 = s.effect[i, a, 0], s.effect[i, a, 1], s.effect[i, a, 2]
                B[3, column + a], B[4, column + a], B[5, column + a] = t0, t1, t2
                B[0, column + a] += t1 * x[2] - t2 * x[1]
                B[1, column + a] += t2 * x[0] - t0 * x[2]
                B[2, column + a] += t0 * x[1] - t1 * x[0]


@unit("walk_gauge")
def walk_gauge(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, before: FloatArray) -> None:
    """P += B B^T for the way from the pose `before`: rotation about the camera, then a shift as large in the image."""
    P, n, B = S.P[b], plan.leading + plan.size * S.counts[b, BLOCKS], s.HP
    motion, distance = _image_motion(calls, plan, S, b, s, before)
    _find_directions(calls, plan, S, b, s, n)
    sigma = plan.gauge_walk * math.sqrt(motion)
    for k in range(6):
        scale = sigma if k < 3 else sigma * distance
        for j in range(n):
            B[k, j] *= scale
    add_square(P, B, 6, n)
