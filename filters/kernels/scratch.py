"""Working arrays of the kernels: room for one filter's frame at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.kernels.recipe import MOST_ROWS, Recipe
from filters.kernels.storage import Storage, aligned
from filters.motions.motion_model import POSE_SIZE

CHUNK_ROWS = 36  # of measurement corrected with at a time: more cost more to factorise, fewer pass over P more often


class Scratch(NamedTuple):
    """Room for one filter's frame at a time: one for each thread."""

    F: FloatArray
    old: FloatArray
    half: FloatArray
    changed: BoolArray
    lead: FloatArray
    """(leading or columns of H, n): whole leading rows of P, and of the blocks of one landmark."""
    G: FloatArray
    """(6, n): factors of a change of rank six, or diagonals of a matrix of blocks."""
    block: FloatArray
    before: FloatArray
    moved: FloatArray
    moved_blocks: FloatArray
    point_blocks: FloatArray
    where: IntArray
    """Landmark of each measurement, -1: not in the map, (M,)."""
    place: IntArray
    land: IntArray
    fates: IntArray
    select: IntArray
    entered: IntArray
    """Blocks that new landmarks and clones take, (M,)."""
    base: IntArray
    """First rows of the landmark of each: of its anchor's position and orientation, where there are such (only the
    position: the second one), and its own; (M, 3)."""
    made: IntArray
    """Blocks of new anchors, (2 M,)."""
    turns: IntArray
    """Blocks of the orientations of new anchors, (M,); -1: none."""
    z: FloatArray
    R: FloatArray
    H: FloatArray
    """(M, 4, measured + 3 anchors + size): by leading rows, anchor, own rows; of new landmarks, (M, size, measured)."""
    nu: FloatArray
    distances: FloatArray
    ahead: BoolArray
    used: BoolArray
    support: BoolArray
    HP: FloatArray
    S: FloatArray
    shared: FloatArray
    delta: FloatArray
    kept: FloatArray
    W: FloatArray
    D: FloatArray
    copy: FloatArray
    tangents: FloatArray
    """H and, in the last column, nu from before a pass, of the measurements that it may leave as they are."""
    leading: IntArray
    """Leading rows, (leading,)."""
    state: FloatArray
    """What the motion moves, before and after the step, and what it says of it."""
    after: FloatArray
    F_part: FloatArray
    Q: FloatArray
    odometry_nu: FloatArray
    odometry_H: FloatArray
    odometry_R: FloatArray
    taken: IntArray
    """Blocks that kernels of landmarks work on, (K,), with all that they take and give."""
    values_taken: FloatArray
    values_moved: FloatArray
    points: FloatArray
    by_own: FloatArray
    theta: FloatArray
    correction: FloatArray
    by_correction: FloatArray
    by_theta: FloatArray
    effect: FloatArray
    sensed: FloatArray
    """What the sensor depends on besides the point, with all that its kernels take and give."""
    points_c: FloatArray
    numbers: FloatArray
    by_point: FloatArray
    by_values: FloatArray
    in_front: BoolArray
    uvd: FloatArray
    by_uvd: FloatArray
    back_by_values: FloatArray
    by_start: FloatArray
    possible: BoolArray
    gate_rows: IntArray
    gate_P: FloatArray
    gate_HP: FloatArray
    inverse_R: FloatArray
    small: FloatArray
    root: FloatArray
    """Cholesky factor of what a measurement depends on, pose first, and what is drawn and fitted along it."""
    sigma_positions: FloatArray
    sigma_rotations: FloatArray
    sigma_z: FloatArray
    sigma_along: FloatArray
    added: FloatArray
    """What sigma points have added to R, (M, 4, 4)."""
    result: FloatArray
    """What a unit gives back, (2,)."""
    noise: FloatArray
    """R of (u, v, d) of each measurement, (M, 3, 3)."""
    gone: BoolArray
    """Landmarks that leave, (C,)."""
    values: FloatArray
    """Of new landmarks, (M, v)."""
    values_noise: FloatArray
    """What the measurement adds to their covariance, and what their prior does, (M, size, size)."""
    anchored: BoolArray
    """Whether they have an anchor, (M,)."""
    by_anchor: FloatArray
    """Jacobian of a new anchor by the leading rows that measurements depend on, (3 anchors, measured)."""
    door: IntArray
    """Number of the thread, and whether a part has failed, (2,)."""
    letters: IntArray
    sizes: IntArray
    """Arguments of LAPACK."""


def scratch(
    recipe: Recipe, storage: Storage, measurements: int, rows: int = 0, columns: int = 0, thread: int = 0
) -> Scratch:
    """Room for a frame of so many measurements, and for one measurement of so many rows by so many errors."""
    plan = recipe.plan
    n, blocks, leading, M = storage.P.shape[1], storage.blocks.shape[1], plan.leading, max(1, measurements)
    keeps = plan.iterations > 1 and plan.relinearise_above > 0.0
    at_once = plan.consensus or plan.iterations > 1
    used = 0 if recipe.motion is None else recipe.motion.rows
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
    integers = {name: np.zeros(M, dtype=np.int64) for name in ("where", "place", "land", "select", "entered")}
    return Scratch(
        F=np.zeros((leading, leading)),
        old=np.zeros((leading, leading)),
        half=np.zeros((leading, leading)),
        changed=np.zeros(leading, dtype=np.bool_),
        lead=aligned(max(leading, width, columns, 2 * size), n),
        G=aligned(max(6, 2 * size - 1), n),
        block=aligned(size, n),
        before=np.zeros(recipe.values),
        moved=np.zeros(recipe.values),
        moved_blocks=np.zeros((blocks, recipe.block_values)),
        point_blocks=np.zeros((blocks, recipe.block_values)),
        **integers,
        fates=np.zeros(M, dtype=np.uint8),
        base=np.zeros((M, 3), dtype=np.int64),
        made=np.zeros(2 * M, dtype=np.int64),
        turns=np.zeros(M, dtype=np.int64),
        z=np.zeros((M, MOST_ROWS)),
        R=np.zeros((M, MOST_ROWS, MOST_ROWS)),
        H=np.zeros((M, most, width)),
        nu=np.zeros((M, MOST_ROWS)),
        distances=np.zeros(M),
        ahead=np.zeros(M, dtype=np.bool_),
        used=np.zeros(M, dtype=np.bool_),
        support=np.zeros((M, M) if plan.consensus else (1, 1), dtype=np.bool_),
        HP=aligned(rows, n + 16),  # rows of 512 numbers, 8 more than 504, would fall on the same lines of a cache
        S=aligned(rows, rows + 8),
        shared=aligned(width, rows + 8),
        delta=np.zeros(n),
        kept=np.zeros((max(1, len(plan.considered)),) * 2),
        W=np.zeros((n, 3)),
        D=np.zeros((blocks, size, size)),
        copy=np.zeros((n, n) if plan.iterations > 1 else (1, 1)),
        tangents=np.zeros((M if keeps else 1, MOST_ROWS, width + 1)),
        leading=np.arange(leading),
        state=np.zeros(len(plan.moved)),
        after=np.zeros(len(plan.moved)),
        F_part=np.zeros((moved, moved)),
        Q=np.zeros((moved, moved)),
        odometry_nu=np.zeros(used),
        odometry_H=np.zeros((used, moved)),
        odometry_R=np.zeros((used, used)),
        taken=np.zeros(K, dtype=np.int64),
        values_taken=np.zeros((K, v)),
        values_moved=np.zeros((K, v)),
        points=np.zeros((K, seen)),
        by_own=np.zeros((K, seen, size)),
        theta=np.zeros(3),
        correction=np.zeros((K, size)),
        by_correction=np.zeros((K, size, size)),
        by_theta=np.zeros((K, size, 3)),
        effect=np.zeros((K, size, 3)),
        sensed=np.zeros(len(plan.sensed) + (6 if plan.measured > plan.velocity else 0)),
        points_c=np.zeros((M, seen)),
        numbers=np.zeros((N, numbers)),
        by_point=np.zeros((N, numbers, seen)),
        by_values=np.zeros((N, numbers, others)),
        in_front=np.zeros(N, dtype=np.bool_),
        uvd=np.zeros((M, 3)),
        by_uvd=np.zeros((M, seen, 3)),
        back_by_values=np.zeros((N, seen, others)),
        by_start=np.zeros((M, size, seen)),
        possible=np.zeros(M, dtype=np.bool_),
        gate_rows=np.zeros(width, dtype=np.int64),
        gate_P=np.zeros((width, width + 8)),
        gate_HP=np.zeros((MOST_ROWS, width + 8)),
        inverse_R=np.zeros((M if plan.consensus else 1, MOST_ROWS, MOST_ROWS)),
        small=np.zeros((3, most, most)),
        root=np.zeros((width, width) if lines else (1, 1)),
        sigma_positions=np.zeros((2 * POSE_SIZE + 1, 3)),
        sigma_rotations=np.zeros((3 * (2 * POSE_SIZE + 1), 3)),
        sigma_z=np.zeros((drawn, MOST_ROWS)),
        sigma_along=np.zeros((MOST_ROWS, width)),
        added=np.zeros((max(1, lines), MOST_ROWS, MOST_ROWS)),
        result=np.zeros(2),
        noise=np.zeros((M, 3, 3)),
        gone=np.zeros(blocks, dtype=np.bool_),
        values=np.zeros((M, recipe.value_size)),
        values_noise=np.zeros((M, size, size)),
        anchored=np.zeros(M, dtype=np.bool_),
        by_anchor=np.zeros((3 * max(1, plan.anchors), plan.measured)),
        door=np.array([thread, 0]),
        letters=np.array((ord("L"),), dtype=np.uint8),
        sizes=np.zeros(3, dtype=np.int32),
    )
