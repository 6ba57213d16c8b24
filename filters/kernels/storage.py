"""State of many filters in arrays with room to grow, what a frame brings, and what the kernels work on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.kernels.recipe import MOST_ROWS, MOST_STAGES, Recipe

LANDMARKS, BLOCKS = 0, 1
POINT, OWN, CLONE_POSITION, CLONE_ROTATION = range(4)
"""Kinds of blocks: points of W, a landmark's own numbers, and the two blocks of a clone of the pose."""
USED, BEHIND, GATED, FAILED, STARTED, REJECTED = range(6)
"""Outcome of a measurement: used, behind the camera, gated, no Cholesky factor of S; started a landmark, or not."""


class Storage(NamedTuple):
    """State of B filters, each with room for C blocks.

    Only the upper triangle of the first rows of `P[b]` is valid, that is of the leading rows and of the blocks in use,
    which have no gaps between them.
    """

    P: FloatArray
    """(B, n, n)."""
    x: FloatArray
    """Values of the leading variables, (B, values)."""
    predicted: FloatArray
    """The same before landmarks last corrected them."""
    blocks: FloatArray
    """Values of the blocks, (B, C, v): block c of s rows is at the rows leading + s c of P."""
    first: FloatArray
    """The same when they entered."""
    ids: IntArray
    """Landmarks in ascending order, (B, C)."""
    own: IntArray
    """Parameter block of each, (B, C)."""
    anchor: IntArray
    """Blocks of the position and the orientation of each one's anchor, -1 where there is none, (B, C, 2)."""
    users: IntArray
    """Landmarks that use each block, and one more where it is held, (B, C)."""
    kind: IntArray
    """What each block is, (B, C)."""
    held: IntArray
    """Blocks that stay without a landmark, in the order in which they were held, -1 at the end; (B, C)."""
    counts: IntArray
    """Landmarks and blocks, (B, 2)."""


class FrameArrays(NamedTuple):
    """What a frame brings to B filters: a step, odometry, and M measurements in all; or the numbers of parts."""

    dt: FloatArray
    """(B,) s; zero: no step."""
    fused: BoolArray
    """Whether there is odometry, (B,)."""
    odometry: FloatArray
    """`MotionModel.odometry_numbers`, (B, K, w)."""
    odometry_rows: IntArray
    """Rows of it that there are, (B,)."""
    seen: BoolArray
    """Whether there is an observation, (B,)."""
    offsets: IntArray
    """Measurements of filter b are offsets[b] to offsets[b + 1] - 1; (B + 1,)."""
    ids: IntArray
    """(M,), ascending for each filter."""
    uvd: FloatArray
    """(M, 3)."""
    R: FloatArray
    """(M, 3, 3)."""
    with_right: BoolArray
    """Whether the right row is measured on its own, (B,)."""
    v_right: FloatArray
    """Rows in the right image, (M,), px."""
    fates: IntArray
    """Outcome of each measurement, (M,) uint8: written."""
    nis: FloatArray
    """(B,): written."""
    dof: IntArray
    """(B,): written."""
    dropped: IntArray
    """Ids that left, (B, C): written."""
    outcome: IntArray
    """How many ids left, and the number of blocks that there is no room for (0: all went well), (B, 2): written."""
    moved: FloatArray
    """Leading values after the step by numbers, (B, values)."""
    F: FloatArray
    """Their Jacobian, (B, leading, leading)."""
    Q: FloatArray
    """Their process noise, (B, leading, leading)."""
    measured: IntArray
    """Rows of odometry as a measurement by numbers, (B,)."""
    measured_nu: FloatArray
    """(B, r)."""
    measured_H: FloatArray
    """(B, r, leading)."""
    measured_R: FloatArray
    """(B, r, r)."""
    stages: IntArray
    """Number of stages by numbers without and with a measured right row, (2,)."""
    sizes: IntArray
    """Their rows, (2, stages)."""
    limits: FloatArray
    """Squared distances up to which they are believed, (2, stages)."""
    T: FloatArray
    """Their rows by (u, v, d), (2, stages, 4, 3)."""
    stage_z: FloatArray
    """(stages, M, 4)."""
    stage_R: FloatArray
    """(stages, M, 4, 4)."""


def aligned(*shape: int) -> FloatArray:
    """Zeros from the start of a line of the cache on: vectors of eight numbers do not lie across two of them."""
    size = math.prod(shape)
    room = np.zeros(size + 7)
    first = -(room.ctypes.data // 8) % 8
    return room[first : first + size].reshape(shape)


def empty_storage(recipe: Recipe, filters: int, blocks: int) -> Storage:
    """Storage of filters without a map, with room for so many blocks."""
    rows = padded(recipe.plan.leading + recipe.plan.size * blocks)
    return Storage(
        P=aligned(filters, rows, rows),
        x=np.zeros((filters, recipe.values)),
        predicted=np.zeros((filters, recipe.values)),
        blocks=np.zeros((filters, blocks, recipe.block_values)),
        first=np.zeros((filters, blocks, recipe.block_values)),
        ids=np.zeros((filters, blocks), dtype=np.int64),
        own=np.zeros((filters, blocks), dtype=np.int64),
        anchor=np.zeros((filters, blocks, 2), dtype=np.int64),
        users=np.zeros((filters, blocks), dtype=np.int64),
        kind=np.zeros((filters, blocks), dtype=np.int64),
        held=np.full((filters, blocks), -1),
        counts=np.zeros((filters, 2), dtype=np.int64),
    )


def grown(storage: Storage, recipe: Recipe, blocks: int) -> Storage:
    """The same with room for more blocks."""
    larger = empty_storage(recipe, len(storage.x), blocks)
    for old, new in zip(storage, larger, strict=True):
        new[tuple(slice(0, size) for size in old.shape)] = old
    return larger


def padded(rows: int) -> int:
    """Rows of P with a distance between them that does not fall on the same lines of a cache."""
    return -(-rows // 16) * 16 + 8


@dataclass(frozen=True, eq=False)
class FilterState:
    """State of one filter, in plain arrays."""

    x: FloatArray
    """(values,): leading variables: position, orientation xyzw, calibration, velocities, others, padding."""
    predicted: FloatArray
    """The same before landmarks last corrected them."""
    P: FloatArray
    """(n, n): covariance of the leading rows and of the blocks; the upper triangle counts."""
    blocks: FloatArray
    """(C, v): values of the blocks,"""
    first: FloatArray
    """and when they entered."""
    kind: IntArray
    """(C,): what each block is."""
    ids: IntArray
    """(N,): landmarks in ascending order."""
    own: IntArray
    """(N,): their parameter blocks."""
    anchor: IntArray
    """(N, 2): blocks of their anchors' positions and orientations, -1: none."""
    held: IntArray
    """(H,): blocks that stay without a landmark."""


def empty_frame(
    recipe: Recipe, filters: int, blocks: int, measurements: int, rows: int = 1, odometry: tuple[int, int] = (1, 1)
) -> FrameArrays:
    """A frame that brings nothing, with room for odometry (K, w), and for so many rows of it by numbers."""
    M, leading = measurements, recipe.plan.leading
    driven = filters if recipe.motion is None else 1
    stages, numbers = (MOST_STAGES, M) if recipe.plan.by_numbers else (1, 1)
    return FrameArrays(
        dt=np.zeros(filters),
        fused=np.zeros(filters, dtype=np.bool_),
        odometry=np.zeros((filters, *odometry)),
        odometry_rows=np.zeros(filters, dtype=np.int64),
        seen=np.zeros(filters, dtype=np.bool_),
        offsets=np.zeros(filters + 1, dtype=np.int64),
        ids=np.zeros(M, dtype=np.int64),
        uvd=np.zeros((M, 3)),
        R=np.zeros((M, 3, 3)),
        with_right=np.zeros(filters, dtype=np.bool_),
        v_right=np.zeros(M),
        fates=np.zeros(M, dtype=np.uint8),
        nis=np.zeros(filters),
        dof=np.zeros(filters, dtype=np.int64),
        dropped=np.zeros((filters, blocks), dtype=np.int64),
        outcome=np.zeros((filters, 2), dtype=np.int64),
        moved=np.zeros((driven, recipe.values)),
        F=np.zeros((driven, leading, leading)),
        Q=np.zeros((driven, leading, leading)),
        measured=np.zeros(driven, dtype=np.int64),
        measured_nu=np.zeros((driven, rows)),
        measured_H=np.zeros((driven, rows, leading)),
        measured_R=np.zeros((driven, rows, rows)),
        stages=np.zeros(2, dtype=np.int64),
        sizes=np.zeros((2, stages), dtype=np.int64),
        limits=np.full((2, stages), np.inf),
        T=np.zeros((2, stages, MOST_ROWS, 3)),
        stage_z=np.zeros((stages, numbers, MOST_ROWS)),
        stage_R=np.zeros((stages, numbers, MOST_ROWS, MOST_ROWS)),
    )


def exported(storage: Storage, recipe: Recipe, filter_index: int) -> FilterState:
    """A copy of the state of one filter."""
    b, (landmarks, blocks) = filter_index, storage.counts[filter_index]
    n = recipe.plan.leading + recipe.plan.size * blocks
    held = storage.held[b]
    return FilterState(
        x=storage.x[b].copy(),
        predicted=storage.predicted[b].copy(),
        P=storage.P[b, :n, :n].copy(),
        blocks=storage.blocks[b, :blocks].copy(),
        first=storage.first[b, :blocks].copy(),
        kind=storage.kind[b, :blocks].copy(),
        ids=storage.ids[b, :landmarks].copy(),
        own=storage.own[b, :landmarks].copy(),
        anchor=storage.anchor[b, :landmarks].copy(),
        held=held[held >= 0],
    )


def load(storage: Storage, filter_index: int, state: FilterState) -> None:
    """Put the state of one filter there; there must be room for it."""
    b, n, landmarks, blocks = filter_index, len(state.P), len(state.ids), len(state.blocks)
    storage.P[b, :n, :n] = state.P
    storage.x[b], storage.predicted[b] = state.x, state.predicted
    storage.blocks[b, :blocks], storage.first[b, :blocks] = state.blocks, state.first
    storage.kind[b, :blocks] = state.kind
    order = np.argsort(state.ids)
    storage.ids[b, :landmarks] = state.ids[order]
    storage.own[b, :landmarks], storage.anchor[b, :landmarks] = state.own[order], state.anchor[order]
    users = np.bincount(state.own, minlength=blocks) + np.bincount(state.anchor[state.anchor >= 0], minlength=blocks)
    users[state.held] += 1
    storage.users[b, :blocks] = users
    storage.held[b] = -1
    storage.held[b, : len(state.held)] = state.held
    storage.counts[b] = landmarks, blocks
