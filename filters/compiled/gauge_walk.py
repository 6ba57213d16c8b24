"""Kernel of the gauge walk: `filters.gauge_walk`, at the state or at the first estimates."""

from __future__ import annotations

import math

from numba import njit, types

from filters.compiled.blas import KERNEL, add_square
from filters.compiled.prediction import orientation, skew, transposed
from filters.compiled.recipe import FIRST_ESTIMATES, Plan
from filters.compiled.retraction import mark_rays, ray_rotation
from filters.compiled.storage import BLOCKS, LANDMARKS, Scratch, Storage
from filters.compiled.units import PLAN, SCRATCH, STORAGE, unit
from filters.validation import FloatArray


@njit(**KERNEL)
def _put_columns(B: FloatArray, first: int, column: int, nine: tuple[float, ...], scale: float) -> None:
    """B^T[column:, first:] (3, 3) = scale times nine numbers, row by row; B is stored with its columns as rows."""
    for i, number in enumerate(nine):
        B[first + i % 3, column + i // 3] = scale * number


@unit(PLAN, STORAGE, types.int64, SCRATCH, types.float64)
def walk_gauge(plan: Plan, S: Storage, b: int, s: Scratch, distance: float) -> None:
    """P += B B^T, with B^T in the first six rows of HP."""
    counts, x = S.counts[b], S.x[b]
    P, n, B = S.P[b], plan.leading + 3 * counts[BLOCKS], s.HP
    rotation, translation = plan.gauge_rotation * math.sqrt(distance), plan.gauge_translation * math.sqrt(distance)
    blocks = S.first[b] if plan.error == FIRST_ESTIMATES else S.blocks[b]
    for k in range(6):
        for j in range(n):
            B[k, j] = 0.0
    v, identity = plan.velocity, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    _put_columns(B, 3, 0, identity, translation)
    _put_columns(B, 0, 3, transposed(orientation(x)), rotation)
    _put_columns(B, 0, v, skew(x[v + 1], x[v + 2], x[v + 3]), -rotation)
    mark_rays(plan, S.own[b], counts[LANDMARKS], counts[BLOCKS], s.is_own)
    for c in range(counts[BLOCKS]):
        column = plan.leading + 3 * c
        if s.is_own[c]:
            effect = ray_rotation(blocks[c, 0], blocks[c, 1])
            for a in range(3):
                B[a, column], B[a, column + 1] = rotation * effect[a], rotation * effect[3 + a]
        else:
            away = skew(blocks[c, 0] - x[0], blocks[c, 1] - x[1], blocks[c, 2] - x[2])
            _put_columns(B, 0, column, away, -rotation)
            _put_columns(B, 3, column, identity, translation)
    add_square(P, B, 6, n)
