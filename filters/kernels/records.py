"""Records of arrays, a table each: the state of many filters, what a frame brings, and room for a frame."""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.recipe import MOST_ROWS, Recipe
from filters.motions.motion_model import POSE_SIZE

ALIGNED = "aligned"
"""Numbers whose first one begins a line of the cache: vectors of eight do not lie across two of them."""
REAL, INT, FLAG, BYTE = np.float64, np.int64, np.bool_, np.uint8
Rows = Sequence[tuple[str, Any, str, str]]
"""Name, type, names of the sizes of its axes, and meaning of each array."""


def record_of(module: str, name: str, rows: Rows) -> Any:
    """Type of a record."""
    return namedtuple(name, [row[0] for row in rows], module=module)


def allocated(record: Any, rows: Rows, sizes: Mapping[str, int], **given: Any) -> Any:
    """Record of arrays of these sizes, zero but for the given ones."""
    arrays = {}
    for name, kind, axes, _ in rows:
        shape = tuple(sizes[axis] if axis in sizes else int(axis) for axis in axes.split())
        if name not in given:
            arrays[name] = aligned(*shape) if kind == ALIGNED else np.zeros(shape, dtype=kind)
    return record(**arrays, **given)


def aligned(*shape: int) -> FloatArray:
    """Zeros from the start of a line of the cache on."""
    size = math.prod(shape)
    room = np.zeros(size + 7)
    first = -(room.ctypes.data // 8) % 8
    return room[first : first + size].reshape(shape)


LANDMARKS, BLOCKS = 0, 1
POINT, OWN, CLONE_POSITION, CLONE_ROTATION, AXES, VECTOR, PLAIN = range(7)
"""Kinds of blocks: points of W, a landmark's own numbers, the two blocks of a clone of the pose, axes that move in W
(beside a point: those of a body), and those of a variable that was added: a vector in W, or numbers that do not turn
with the world."""
USED, BEHIND, GATED, FAILED, STARTED, REJECTED = range(6)
"""Outcome of a measurement: used, behind the camera, gated, no Cholesky factor of S; started a landmark, or not."""


_STORAGE: Rows = (
    ("P", ALIGNED, "filters rows rows", "covariance; the upper triangle of leading rows and blocks in use is valid"),
    ("x", REAL, "filters values", "values of the leading variables"),
    ("predicted", REAL, "filters values", "the same before landmarks last corrected them"),
    ("blocks", REAL, "filters blocks block_values", "values of the blocks; block c is at the rows leading + size c"),
    ("first", REAL, "filters blocks block_values", "the same when they entered"),
    ("ids", INT, "filters blocks", "landmarks in ascending order"),
    ("own", INT, "filters blocks", "parameter block of each"),
    ("anchor", INT, "filters blocks", "block of its anchor, -1: none"),
    ("users", INT, "filters blocks", "landmarks that use each block, and one more where it is held"),
    ("kind", INT, "filters blocks", "what each block is"),
    ("walk", REAL, "filters blocks 3", "variance that numbers of an added variable gain in a second"),
    ("held", INT, "filters blocks", "blocks that stay without a landmark, in the order of holding, -1 at the end"),
    ("counts", INT, "filters 2", "landmarks and blocks"),
)
_FRAME: Rows = (
    ("dt", REAL, "filters", "step, s; zero: none"),
    ("fused", FLAG, "filters", "whether there is odometry"),
    ("odometry", REAL, "filters K w", "`MotionModel.odometry_numbers`"),
    ("odometry_rows", INT, "filters", "rows of it that there are"),
    ("seen", FLAG, "filters", "whether there is an observation"),
    ("offsets", INT, "ends", "measurements of filter b are offsets[b] to offsets[b + 1] - 1"),
    ("ids", INT, "M", "of the measurements, ascending for each filter"),
    ("uvd", REAL, "M 3", "measurements"),
    ("R", REAL, "M 3 3", "their noise"),
    ("with_right", FLAG, "filters", "whether the right row is measured on its own"),
    ("v_right", REAL, "M", "rows in the right image, px"),
    ("fates", BYTE, "M", "outcome of each measurement: written"),
    ("nis", REAL, "filters", "normalised innovation squared: written"),
    ("dof", INT, "filters", "its degrees of freedom: written"),
    ("dropped", INT, "filters blocks", "ids that left: written"),
    ("outcome", INT, "filters 2", "how many ids left, and blocks without room (0: all went well): written"),
)
Storage: Any = record_of(__name__, "Storage", _STORAGE)
"""State of B filters, each with room for C blocks, which have no gaps between them."""
FrameArrays: Any = record_of(__name__, "FrameArrays", _FRAME)
"""What a frame brings to B filters: a step, odometry, and M measurements in all."""


def empty_storage(recipe: Recipe, filters: int, blocks: int) -> Storage:
    """Storage of filters without a map, with room for so many blocks."""
    rows = padded(recipe.plan.leading + recipe.plan.size * blocks)
    sizes = {"filters": filters, "rows": rows, "blocks": blocks, "values": recipe.values}
    held = np.full((filters, blocks), -1)
    return allocated(Storage, _STORAGE, {**sizes, "block_values": recipe.block_values}, held=held)


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
    walk: FloatArray
    """(C, 3): variance that numbers of added variables gain in a second."""
    ids: IntArray
    """(N,): landmarks in ascending order."""
    own: IntArray
    """(N,): their parameter blocks."""
    anchor: IntArray
    """(N,): blocks of their anchors, -1: none."""
    held: IntArray
    """(H,): blocks that stay without a landmark."""


def empty_frame(
    recipe: Recipe, filters: int, blocks: int, measurements: int, odometry: tuple[int, int] = (1, 1)
) -> FrameArrays:
    """A frame that brings nothing, with room for odometry (K, w)."""
    (K, w), M = odometry, measurements
    sizes = {"filters": filters, "blocks": blocks, "ends": filters + 1, "M": M, "K": K, "w": w}
    return allocated(FrameArrays, _FRAME, sizes)


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
        walk=storage.walk[b, :blocks].copy(),
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
    storage.kind[b, :blocks], storage.walk[b, :blocks] = state.kind, state.walk
    order = np.argsort(state.ids)
    storage.ids[b, :landmarks] = state.ids[order]
    storage.own[b, :landmarks], storage.anchor[b, :landmarks] = state.own[order], state.anchor[order]
    users = np.bincount(state.own, minlength=blocks) + np.bincount(state.anchor[state.anchor >= 0], minlength=blocks)
    users[state.held] += 1
    storage.users[b, :blocks] = users
    storage.held[b] = -1
    storage.held[b, : len(state.held)] = state.held
    storage.counts[b] = landmarks, blocks


CHUNK_ROWS = 36  # of measurement corrected with at a time: more cost more to factorise, fewer pass over P more often


ROWS: Rows = (
    ("F", REAL, "leading leading", "Jacobian of the leading variables"),
    ("old", REAL, "leading leading", "leading block of P before a transform"),
    ("half", REAL, "leading leading", "half of a product of three matrices"),
    ("changed", FLAG, "leading", "leading rows that a transform changes"),
    ("lead", ALIGNED, "lead n", "whole leading rows of P, and of the blocks of one landmark"),
    ("G", ALIGNED, "factors n", "factors of a change of rank six, or diagonals of a matrix of blocks"),
    ("block", ALIGNED, "size n", "whole rows of one block of P"),
    ("before", REAL, "values", "leading values before a step"),
    ("moved", REAL, "values", "leading values after a correction"),
    ("moved_blocks", REAL, "blocks block_values", "values of the blocks after a correction"),
    ("point_blocks", REAL, "blocks block_values", "values of the blocks at the linearisation point"),
    ("where", INT, "M", "landmark of each measurement, -1: not in the map"),
    ("place", INT, "M", "place of each selected measurement among those of the frame"),
    ("land", INT, "M", "landmark of each measurement of a known one"),
    ("select", INT, "I", "measurements m that are worked on; what a stage refuses is taken out"),
    ("entered", INT, "M", "blocks that new landmarks and clones take"),
    ("fates", BYTE, "M", "outcome of each measurement"),
    ("base", INT, "M 2", "first rows of anchor and own numbers of each landmark"),
    ("made", INT, "M", "blocks of new anchors"),
    ("z", REAL, "M rows", "measurements of a stage"),
    ("R", REAL, "M rows rows", "their noise"),
    ("H", REAL, "M most width", "Jacobian by leading rows, anchor, own rows; of new landmarks by the leading ones"),
    ("nu", REAL, "M rows", "innovations"),
    ("mahalanobis2", REAL, "M", "squared Mahalanobis distances nu^T S^-1 nu, each on its own"),
    ("ahead", FLAG, "M", "whether the sensor can see it; false of what an earlier stage refused"),
    ("used", FLAG, "M", "whether a chunk had a Cholesky factor"),
    ("support", FLAG, "agree agree", "measurements that agree with each proposal"),
    ("HP", ALIGNED, "chunk n16", "H P of a chunk; rows of 512 numbers would fall on the same lines of a cache"),
    ("S", ALIGNED, "chunk chunk8", "innovation covariance and its factor"),
    ("shared", ALIGNED, "width chunk8", "rows of H P that a chunk shares"),
    ("delta", REAL, "n", "correction"),
    ("kept", REAL, "considered considered", "covariance of what is only considered"),
    ("W", REAL, "n 3", "Jacobian by the rotation"),
    ("D", REAL, "blocks size size", "Jacobian of the blocks by themselves"),
    ("copy", REAL, "copied copied", "P of a pass that is not the last one"),
    ("tangents", REAL, "kept_rows rows width1", "H and, in the last column, nu from before a pass"),
    ("state", REAL, "moving", "what the motion moves, before the step"),
    ("after", REAL, "moving", "and after it"),
    ("F_part", REAL, "moved_rows moved_rows", "its Jacobian"),
    ("Q", REAL, "moved_rows moved_rows", "and process noise"),
    ("odometry_nu", REAL, "odometry", "innovation of odometry"),
    ("odometry_H", REAL, "odometry moved_rows", "its Jacobian"),
    ("odometry_R", REAL, "odometry odometry", "and noise"),
    ("taken", INT, "I", "blocks that functions of landmarks work on"),
    ("values_taken", REAL, "I v", "their values"),
    ("values_moved", REAL, "I v", "values after a correction"),
    ("points", REAL, "I seen", "homogeneous points, from the anchor (or the origin of W), in the axes of W"),
    ("by_own", REAL, "I seen size", "their Jacobians by the own numbers"),
    ("theta", REAL, "3", "rotation vector of the world"),
    ("correction", REAL, "I size", "correction of the own numbers"),
    ("by_correction", REAL, "I size size", "Jacobian by it"),
    ("by_theta", REAL, "I size 3", "Jacobian by theta"),
    ("effect", REAL, "I size 3", "effect of a rotation of the world on the own numbers"),
    ("sensed", REAL, "sensed", "values of what the sensor depends on besides the point"),
    ("points_c", REAL, "I seen", "homogeneous points in the camera frame"),
    ("numbers", REAL, "I numbers", "numbers of the sensor there"),
    ("by_point", REAL, "I numbers seen", "Jacobian by the point"),
    ("by_values", REAL, "I numbers others", "Jacobian by the values"),
    ("in_front", FLAG, "I", "whether the sensor can see it"),
    ("uvd", REAL, "I 3", "measurements that start landmarks"),
    ("by_uvd", REAL, "I seen 3", "Jacobian of their points"),
    ("back_by_values", REAL, "I seen others", "and by the values"),
    ("by_start", REAL, "M size seen", "Jacobian of the values by the point"),
    ("possible", FLAG, "M", "whether a landmark can start"),
    ("gate_rows", INT, "width", "rows of P that one measurement depends on"),
    ("gate_P", REAL, "width width8", "P there"),
    ("gate_HP", REAL, "rows width8", "H P there"),
    ("inverse_R", REAL, "agree rows rows", "inverse noise of a stage"),
    ("small", REAL, "3 most most", "three small matrices"),
    ("root", REAL, "root root", "Cholesky factor of what a measurement depends on, pose first"),
    ("sigma_positions", REAL, "poses 3", "positions of sigma points"),
    ("sigma_rotations", REAL, "rotations 3", "and rotations"),
    ("sigma_z", REAL, "drawn rows", "measurements of sigma points"),
    ("sigma_along", REAL, "rows width", "their covariance with the drawn numbers"),
    ("added", REAL, "added rows rows", "what sigma points have added to R"),
    ("result", REAL, "2", "what a unit gives back"),
    ("noise", REAL, "M 3 3", "R of (u, v, d) of each measurement"),
    ("gone", FLAG, "blocks", "landmarks that leave"),
    ("values", REAL, "M v", "values of new landmarks"),
    ("values_noise", REAL, "M size size", "what the measurement, and the prior, add to their covariance"),
    ("by_anchor", REAL, "3 measured", "Jacobian of a new anchor by the leading rows of measurements"),
    ("letters", BYTE, "1", "arguments of LAPACK"),
    ("sizes", np.int32, "3", "arguments of LAPACK"),
)
Scratch: Any = record_of(__name__, "Scratch", ROWS)
"""Room for one filter's frame at a time: one for each thread.

Axis M is the number of a measurement among those of the frame, axis I a place in a selection of them: row i of
`points_c` or `numbers` belongs to measurement select[i] as `select` was when they were written, by `linearise`. What is
by M stays valid when the gate takes measurements out of `select`; what is by I does not.
"""


def scratch(recipe: Recipe, storage: Storage, measurements: int, rows: int = 0, columns: int = 0) -> Scratch:
    """Room for a frame of so many measurements, and for one measurement of so many rows by so many errors."""
    plan = recipe.plan
    n, blocks, leading, M = storage.P.shape[1], storage.blocks.shape[1], plan.leading, max(1, measurements)
    keeps = plan.iterations > 1 and plan.relinearise_above > 0.0
    at_once = plan.consensus or plan.iterations > 1
    used = plan.odometry_rows
    rows = max(8, max(rows, used) + MOST_ROWS, M * MOST_ROWS if at_once else min(M * MOST_ROWS, CHUNK_ROWS + MOST_ROWS))
    size, seen_size = plan.size, recipe.seen_size
    width, other_size, most = plan.measured + 3 * plan.anchors + size, plan.measured - POSE_SIZE, max(MOST_ROWS, size)
    drawn, lines = (2 * width + 1, M) if len(plan.sigma_points) else (1, 0)
    places, v, numbers, moved = max(M, blocks, drawn), recipe.value_size, recipe.sensor_size, len(plan.moved_rows)
    sizes = {
        **{"n": n, "n16": n + 16, "blocks": blocks, "leading": leading, "M": M, "I": places, "v": v},
        **{"size": size, "seen": seen_size, "most": most, "width": width, "width1": width + 1, "width8": width + 8},
        **{"numbers": numbers, "others": other_size, "moved_rows": moved, "moving": len(plan.moved), "odometry": used},
        **{"rows": MOST_ROWS, "chunk": rows, "chunk8": rows + 8, "factors": max(6, 2 * size - 1), "drawn": drawn},
        **{"values": recipe.values, "block_values": recipe.block_values, "measured": plan.measured},
        "lead": max(leading, width, columns, 2 * size),
        "agree": M if plan.consensus else 1,
        "considered": max(1, len(plan.considered)),
        "copied": n if plan.iterations > 1 else 1,
        "kept_rows": M if keeps else 1,
        "sensed": len(plan.sensed) + (6 if plan.measured > plan.velocity else 0),
        "root": width if lines else 1,
        "poses": 2 * POSE_SIZE + 1,
        "rotations": 3 * (2 * POSE_SIZE + 1),
        "added": max(1, lines),
    }
    return allocated(Scratch, ROWS, sizes, letters=np.array((ord("L"),), dtype=np.uint8))
