"""Kernel of the gauge walk: `filters.engine.gauge_walk`, at the state or at the first estimates."""

from __future__ import annotations

import math

from numba import njit, types

from filters.engine.compiled.blas import KERNEL, Routines, add_square, call
from filters.engine.compiled.linearisation import clear_all, from_camera, take_points
from filters.engine.compiled.prediction import orientation
from filters.engine.compiled.recipe import Plan
from filters.engine.compiled.scratch import Scratch
from filters.engine.compiled.storage import BLOCKS, LANDMARKS, OWN, POINT, Storage
from filters.engine.compiled.units import ADDRESSES, EFFECT, PLAN, SCRATCH, STORAGE, VECTOR, unit
from filters.engine.gauge_walk import FARTHEST, TURN_WEIGHT
from filters.geometry.rotations import Nine, product_of
from filters.geometry.three_by_three import IDENTITY, cross_matrix, transposed
from filters.validation import FloatArray


@njit(**KERNEL)
def _put_columns(B: FloatArray, first: int, column: int, nine: Nine, scale: float) -> None:
    """B^T[column:, first:] (3, 3) = scale times nine numbers, row by row; B is stored with its columns as rows."""
    for i, number in enumerate(nine):
        B[first + i % 3, column + i // 3] = scale * number


@njit(**KERNEL)
def _image_motion(
    routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch, before: FloatArray
) -> tuple[float, float]:
    """`filters.engine.gauge_walk.image_motion` since the camera was at `before`."""
    x, blocks, own, anchor = S.x[b], S.blocks[b], S.own[b], S.anchor[b]
    a0, a1, a2, a3 = product_of(-before[3], -before[4], -before[5], before[6], x[3], x[4], x[5], x[6])
    turn = 2.0 * math.atan2(math.sqrt(a0 * a0 + a1 * a1 + a2 * a2), abs(a3))
    s0, s1, s2 = x[0] - before[0], x[1] - before[1], x[2] - before[2]
    count, by_step, inverse = S.counts[b, LANDMARKS], 0.0, 0.0
    if count == 0:
        return 0.0, FARTHEST
    for i in range(count):
        s.taken[i] = own[i]
    take_points(routines, plan, blocks, S.kind[b], s, count)
    for i in range(count):
        scale = s.points[i, 3]
        d0, d1, d2 = from_camera(plan, x, blocks, anchor[i, 0])
        h0, h1, h2 = s.points[i, 0] + scale * d0, s.points[i, 1] + scale * d1, s.points[i, 2] + scale * d2
        squared, scale = h0 * h0 + h1 * h1 + h2 * h2, max(scale, 0.0)
        c0, c1, c2 = s1 * h2 - s2 * h1, s2 * h0 - s0 * h2, s0 * h1 - s1 * h0
        by_step += scale * math.sqrt(c0 * c0 + c1 * c1 + c2 * c2) / squared
        inverse += scale / math.sqrt(squared)
    return TURN_WEIGHT * turn + by_step / count, 1.0 / max(inverse / count, 1.0 / FARTHEST)


@unit(ADDRESSES, PLAN, STORAGE, types.int64, SCRATCH, VECTOR)
def walk_gauge(routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch, before: FloatArray) -> None:
    """P += B B^T for the way from the pose `before`, with B^T in the first six rows of HP."""
    counts, x = S.counts[b], S.x[b]
    P, n, B = S.P[b], plan.leading + plan.size * counts[BLOCKS], s.HP
    if plan.walks_by_numbers:  # the door has written B^T
        add_square(P, B, 6, n)
        return
    motion, distance = _image_motion(routines, plan, S, b, s, before)
    rotation = plan.gauge_walk * math.sqrt(motion)
    translation = rotation * distance
    blocks = S.first[b] if plan.first_estimates else S.blocks[b]
    for k in range(6):
        for j in range(n):
            B[k, j] = 0.0
    v = plan.velocity
    _put_columns(B, 3, 0, IDENTITY, translation)
    _put_columns(B, 0, 3, transposed(orientation(x)), rotation)
    _put_columns(B, 0, v, cross_matrix(x[v + 1], x[v + 2], x[v + 3]), -rotation)
    for row in plan.in_world:
        _put_columns(B, 0, row, cross_matrix(x[row + 1], x[row + 2], x[row + 3]), -rotation)
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
            _put_columns(B, 0, column, away, -rotation)
            _put_columns(B, 3, column, IDENTITY, translation)
    if turning > 0:
        clear_all(s.effect, turning)
        call(routines[EFFECT], (plan.landmark, s.values_taken[:turning], s.effect[:turning]))
    for i in range(turning):
        column = plan.leading + plan.size * s.taken[i]
        for k in range(3):
            for a in range(plan.size):
                B[k, column + a] = rotation * s.effect[i, a, k]
    add_square(P, B, 6, n)
