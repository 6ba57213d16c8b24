"""Kernel of the gauge walk: `filters.engine.gauge_walk`, at the state or at the first estimates."""

from __future__ import annotations

import math

from numba import njit, types

from filters.engine.compiled.blas import KERNEL, add_square
from filters.engine.compiled.prediction import orientation, product_of, skew, transposed
from filters.engine.compiled.projection import seen_from
from filters.engine.compiled.recipe import FIRST_ESTIMATES, Plan
from filters.engine.compiled.retraction import ray_rotation
from filters.engine.compiled.storage import BLOCKS, LANDMARKS, OWN, POINT, Scratch, Storage
from filters.engine.compiled.units import PLAN, SCRATCH, STORAGE, VECTOR, unit
from filters.engine.gauge_walk import FARTHEST, TURN_WEIGHT
from filters.validation import FloatArray


@njit(**KERNEL)
def _put_columns(B: FloatArray, first: int, column: int, nine: tuple[float, ...], scale: float) -> None:
    """B^T[column:, first:] (3, 3) = scale times nine numbers, row by row; B is stored with its columns as rows."""
    for i, number in enumerate(nine):
        B[first + i % 3, column + i // 3] = scale * number


@njit(**KERNEL)
def _image_motion(plan: Plan, S: Storage, b: int, before: FloatArray) -> tuple[float, float]:
    """`filters.engine.gauge_walk.image_motion` since the camera was at `before`."""
    x, blocks, own, anchor = S.x[b], S.blocks[b], S.own[b], S.anchor[b]
    a0, a1, a2, a3 = product_of(-before[3], -before[4], -before[5], before[6], x[3], x[4], x[5], x[6])
    turn = 2.0 * math.atan2(math.sqrt(a0 * a0 + a1 * a1 + a2 * a2), abs(a3))
    s0, s1, s2 = x[0] - before[0], x[1] - before[1], x[2] - before[2]
    count, by_step, inverse = S.counts[b, LANDMARKS], 0.0, 0.0
    if count == 0:
        return 0.0, FARTHEST
    for i in range(count):
        h0, h1, h2, scale = seen_from(plan.anchored, x, blocks, anchor[i], own[i])
        squared, scale = h0 * h0 + h1 * h1 + h2 * h2, max(scale, 0.0)
        c0, c1, c2 = s1 * h2 - s2 * h1, s2 * h0 - s0 * h2, s0 * h1 - s1 * h0
        by_step += scale * math.sqrt(c0 * c0 + c1 * c1 + c2 * c2) / squared
        inverse += scale / math.sqrt(squared)
    return TURN_WEIGHT * turn + by_step / count, 1.0 / max(inverse / count, 1.0 / FARTHEST)


@unit(PLAN, STORAGE, types.int64, SCRATCH, VECTOR)
def walk_gauge(plan: Plan, S: Storage, b: int, s: Scratch, before: FloatArray) -> None:
    """P += B B^T for the way from the pose `before`, with B^T in the first six rows of HP."""
    counts, x = S.counts[b], S.x[b]
    P, n, B = S.P[b], plan.leading + 3 * counts[BLOCKS], s.HP
    if plan.walks_by_numbers:  # the door has written B^T
        add_square(P, B, 6, n)
        return
    motion, distance = _image_motion(plan, S, b, before)
    rotation = plan.gauge_walk * math.sqrt(motion)
    translation = rotation * distance
    blocks = S.first[b] if plan.error == FIRST_ESTIMATES else S.blocks[b]
    for k in range(6):
        for j in range(n):
            B[k, j] = 0.0
    v, identity = plan.velocity, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    _put_columns(B, 3, 0, identity, translation)
    _put_columns(B, 0, 3, transposed(orientation(x)), rotation)
    _put_columns(B, 0, v, skew(x[v + 1], x[v + 2], x[v + 3]), -rotation)
    for c in range(counts[BLOCKS]):
        column = plan.leading + 3 * c
        if S.kind[b, c] == OWN:
            effect = ray_rotation(blocks[c, 0], blocks[c, 1])
            for a in range(3):
                B[a, column], B[a, column + 1] = rotation * effect[a], rotation * effect[3 + a]
        elif S.kind[b, c] == POINT:  # clones stay where the camera was
            away = skew(blocks[c, 0] - x[0], blocks[c, 1] - x[1], blocks[c, 2] - x[2])
            _put_columns(B, 0, column, away, -rotation)
            _put_columns(B, 3, column, identity, translation)
    add_square(P, B, 6, n)
