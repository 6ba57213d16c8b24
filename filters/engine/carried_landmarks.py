"""Landmarks that a step of a variable moves: their values and their part of the Jacobian, in any parametrisation.

Derivation: docs/derivations/rigid_bodies.md.
"""

from __future__ import annotations

import numpy as np

from filters.contract.outputs import MovedLandmarks
from filters.engine.engine import Engine
from filters.engine.options import Options
from filters.geometry import rotations
from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.derivatives import columns_of
from filters.kernels.records import LANDMARKS, POINT


def carried(
    engine: Engine, number: int, options: Options, landmarks: MovedLandmarks
) -> tuple[IntArray, IntArray, FloatArray]:
    """Move landmarks of a filter: their rows (N, 3), other rows that they depend on beside the variable's, T (N, 3, w).

    T is by the variable, then by those rows. With B the Jacobian of a position by a landmark's own numbers, B' that
    after the step, M and V those of the step, the errors become B'^-1 (V x + M B y + (M - 1) a): x of the variable, y
    its own, a of the anchor, which stays.
    """
    S, first_row, size = engine.storage, options.layout.size, options.landmark.size
    blocks, anchor = _blocks_of(engine, number, landmarks.ids)
    positions, B, homogeneous = _points(engine, number, blocks, anchor, S.blocks)
    M, moved = landmarks.by_landmark, [(S.blocks, homogeneous, landmarks.positions)]
    if options.error.first_estimates:  # the step is affine in the position
        first, B, homogeneous = _points(engine, number, blocks, anchor, S.first)
        moved.append((S.first, homogeneous, landmarks.positions + rotations.turned(M, first - positions)))
    for values, seen_by, target in moved:
        points = S.kind[number, blocks] == POINT
        seen_by[:, :3] = target - np.where(anchor[:, None] < 0, 0.0, values[number, anchor, :3])
        seen_by[:, 3] = 1.0
        started = columns_of(options.landmark.start_from, seen_by)
        started[points, :3] = target[points]
        values[number, blocks, : started.shape[1]] = started
    if not options.error.first_estimates:
        S.first[number, blocks] = S.blocks[number, blocks]
    inverse = np.linalg.inv(_points(engine, number, blocks, anchor, S.first)[1])
    rows = first_row + size * blocks[:, None] + np.arange(3)
    by_both = np.concatenate([inverse @ landmarks.by_variable, inverse @ M @ B], axis=2)
    if not options.landmark.anchored:
        return rows, rows, by_both
    anchor_rows = np.where(anchor[:, None] < 0, -1, first_row + size * anchor[:, None] + np.arange(3))
    return rows, np.hstack([rows, anchor_rows]), np.concatenate([by_both, inverse @ (M - np.eye(3))], axis=2)


def landmark_positions(engine: Engine, number: int, ids: IntArray) -> FloatArray:
    """Positions of landmarks in W, (N, 3) m; of a landmark at infinity they are not finite."""
    return _points(engine, number, *_blocks_of(engine, number, ids), engine.storage.blocks)[0]


def _blocks_of(engine: Engine, number: int, ids: IntArray) -> tuple[IntArray, IntArray]:
    """Blocks of landmarks in the map, and of their anchors, -1: none."""
    S = engine.storage
    index = np.searchsorted(S.ids[number, : S.counts[number, LANDMARKS]], ids)
    return S.own[number, index], S.anchor[number, index]


def _points(
    engine: Engine, number: int, blocks: IntArray, anchor: IntArray, values: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions of landmarks in W, Jacobians (N, 3, 3) by the first three own errors, and what they are seen by."""
    recipe = engine.recipe
    shape = len(blocks), recipe.seen_size
    homogeneous, by_own = np.zeros(shape), np.zeros((*shape, recipe.plan.size))
    engine.points(np.ascontiguousarray(values[number, blocks, : recipe.value_size]), homogeneous, by_own)
    with np.errstate(divide="ignore", invalid="ignore"):
        positions = homogeneous[:, :3] / homogeneous[:, 3:4]
        J = (by_own[:, :3, :3] - positions[:, :, None] * by_own[:, 3:4, :3]) / homogeneous[:, 3, None, None]
    positions += np.where(anchor[:, None] < 0, 0.0, values[number, anchor, :3])
    points = engine.storage.kind[number, blocks] == POINT
    positions[points], J[points] = values[number, blocks[points], :3], np.eye(3)
    return positions, J, homogeneous
