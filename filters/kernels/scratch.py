"""Working arrays of the kernels: room for one filter's frame at a time."""

from __future__ import annotations

from typing import Any

import numpy as np

from filters.kernels.recipe import MOST_ROWS, Recipe
from filters.kernels.storage import ALIGNED, BYTE, FLAG, INT, REAL, Rows, Storage, allocated, record_of
from filters.motions.motion_model import POSE_SIZE

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
    ("select", INT, "M", "selected measurements"),
    ("entered", INT, "M", "blocks that new landmarks and clones take"),
    ("fates", BYTE, "M", "outcome of each measurement"),
    ("base", INT, "M 3", "first rows of anchor position (or orientation), anchor, and own numbers of each landmark"),
    ("made", INT, "twice", "blocks of new anchors"),
    ("turns", INT, "M", "blocks of the orientations of new anchors, -1: none"),
    ("z", REAL, "M rows", "measurements of a stage"),
    ("R", REAL, "M rows rows", "their noise"),
    ("H", REAL, "M most width", "Jacobian by leading rows, anchor, own rows; of new landmarks by the leading ones"),
    ("nu", REAL, "M rows", "innovations"),
    ("distances", REAL, "M", "squared distances of single measurements"),
    ("ahead", FLAG, "M", "whether a measurement passed the stages before, and can be seen"),
    ("used", FLAG, "M", "whether a chunk had a Cholesky factor"),
    ("support", FLAG, "agree agree", "measurements that agree with each proposal"),
    (
        "HP",
        ALIGNED,
        "chunk n16",
        "H P of a chunk; rows of 512 numbers would fall on the same lines of a cache",
    ),
    ("S", ALIGNED, "chunk chunk8", "innovation covariance and its factor"),
    ("shared", ALIGNED, "width chunk8", "rows of H P that a chunk shares"),
    ("delta", REAL, "n", "correction"),
    ("kept", REAL, "considered considered", "covariance of what is only considered"),
    ("W", REAL, "n 3", "Jacobian by the rotation"),
    ("D", REAL, "blocks size size", "Jacobian of the blocks by themselves"),
    ("copy", REAL, "copied copied", "P of a pass that is not the last one"),
    ("tangents", REAL, "kept_rows rows width1", "H and, in the last column, nu from before a pass"),
    ("leading", INT, "leading", "leading rows"),
    ("state", REAL, "moving", "what the motion moves, before the step"),
    ("after", REAL, "moving", "and after it"),
    ("F_part", REAL, "moved_rows moved_rows", "its Jacobian"),
    ("Q", REAL, "moved_rows moved_rows", "and process noise"),
    ("odometry_nu", REAL, "odometry", "innovation of odometry"),
    ("odometry_H", REAL, "odometry moved_rows", "its Jacobian"),
    ("odometry_R", REAL, "odometry odometry", "and noise"),
    ("taken", INT, "K", "blocks that functions of landmarks work on"),
    ("values_taken", REAL, "K v", "their values"),
    ("values_moved", REAL, "K v", "values after a correction"),
    ("points", REAL, "K seen", "homogeneous points, in W"),
    ("by_own", REAL, "K seen size", "their Jacobians by the own numbers"),
    ("theta", REAL, "3", "rotation vector of the world"),
    ("correction", REAL, "K size", "correction of the own numbers"),
    ("by_correction", REAL, "K size size", "Jacobian by it"),
    ("by_theta", REAL, "K size 3", "Jacobian by theta"),
    ("effect", REAL, "K size 3", "effect of a rotation of the world on the own numbers"),
    ("sensed", REAL, "sensed", "values of what the sensor depends on besides the point"),
    ("points_c", REAL, "M seen", "homogeneous points in the camera frame"),
    ("numbers", REAL, "N numbers", "numbers of the sensor there"),
    ("by_point", REAL, "N numbers seen", "Jacobian by the point"),
    ("by_values", REAL, "N numbers others", "Jacobian by the values"),
    ("in_front", FLAG, "N", "whether the sensor can see it"),
    ("uvd", REAL, "M 3", "measurements that start landmarks"),
    ("by_uvd", REAL, "M seen 3", "Jacobian of their points"),
    ("back_by_values", REAL, "N seen others", "and by the values"),
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
    ("anchored", FLAG, "M", "whether they have an anchor"),
    (
        "by_anchor",
        REAL,
        "anchor_rows measured",
        "Jacobian of a new anchor by the leading rows of measurements",
    ),
    ("door", INT, "2", "number of the thread, and whether a part has failed"),
    ("letters", BYTE, "1", "arguments of LAPACK"),
    ("sizes", np.int32, "3", "arguments of LAPACK"),
)
Scratch: Any = record_of(__name__, "Scratch", ROWS)
"""Room for one filter's frame at a time: one for each thread."""


def scratch(
    recipe: Recipe, storage: Storage, measurements: int, rows: int = 0, columns: int = 0, thread: int = 0
) -> Scratch:
    """Room for a frame of so many measurements, and for one measurement of so many rows by so many errors."""
    plan = recipe.plan
    n, blocks, leading, M = storage.P.shape[1], storage.blocks.shape[1], plan.leading, max(1, measurements)
    keeps = plan.iterations > 1 and plan.relinearise_above > 0.0
    at_once = plan.consensus or plan.iterations > 1
    used = plan.odometry_rows
    rows = max(8, max(rows, used) + MOST_ROWS, M * MOST_ROWS if at_once else min(M * MOST_ROWS, CHUNK_ROWS + MOST_ROWS))
    size, seen = plan.size, recipe.seen_size
    width, others, most = plan.measured + 3 * plan.anchors + size, plan.measured - POSE_SIZE, max(MOST_ROWS, size)
    drawn, lines = (2 * width + 1, M) if len(plan.sigma_points) else (1, 0)
    N, K, v, numbers, moved = (
        max(M, drawn),
        max(M, blocks, drawn),
        recipe.value_size,
        recipe.sensor_size,
        len(plan.moved_rows),
    )
    sizes = {
        **{"n": n, "n16": n + 16, "blocks": blocks, "leading": leading, "M": M, "twice": 2 * M, "N": N, "K": K, "v": v},
        **{"size": size, "seen": seen, "most": most, "width": width, "width1": width + 1, "width8": width + 8},
        **{"numbers": numbers, "others": others, "moved_rows": moved, "moving": len(plan.moved), "odometry": used},
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
        "anchor_rows": 3 * max(1, plan.anchors),
    }
    given = {"leading": np.arange(leading), "door": np.array([thread, 0])}
    return allocated(Scratch, ROWS, sizes, **given, letters=np.array((ord("L"),), dtype=np.uint8))
