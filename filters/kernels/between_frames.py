"""Changes of one filter between its frames: clones, landmarks that leave, and corrections by the caller."""

from __future__ import annotations

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.blas import entry, kernel
from filters.kernels.calls import read_calls, read_plan, read_scratch, read_storage
from filters.kernels.correction import correct_rows
from filters.kernels.covariance import keep_considered, keep_definite, pose_variances, restore_considered
from filters.kernels.landmarks import clone_pose, close_gaps, marginalise
from filters.kernels.retraction import SETTLED, correct_state
from filters.kernels.storage import BLOCKS

CLONE, FORGET, CLOSE_GAPS = range(3)
"""Changes of the map."""


@entry(_nrt=False)
def change(plan_at: int, storage_at: int, scratch_at: int, b: int, what: int) -> None:
    """Clone the pose of filter b, or take the landmarks marked in `gone` or blocks without users out of its map."""
    plan, S, s = read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at)
    if what == CLONE:
        clone_pose(plan, S, b, s)
        return
    if what == FORGET:
        marginalise(S.ids[b], S.own[b], S.anchor[b], S.users[b], S.counts[b], s.gone, s.entered)
    close_gaps(plan, S, b)


@entry(_nrt=False)
def correct_by(
    calls_at: int,
    plan_at: int,
    storage_at: int,
    scratch_at: int,
    b: int,
    rows: IntArray,
    H: FloatArray,
    nu: FloatArray,
    R: FloatArray,
    limit: float,
) -> None:
    """Correct filter b with a measurement that is linear in the errors at these rows; `result` is NIS, and if used."""
    calls, plan, S, s = read_calls(calls_at), read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at)
    P, n = S.P[b], plan.leading + plan.size * S.counts[b, BLOCKS]
    before = pose_variances(P)
    keep_considered(P, plan.considered, s.kept)
    nis = correct_rows(calls, P, n, rows, H, nu, R, limit, s)
    used = 0.0 <= nis <= limit
    if used:
        restore_considered(P, plan.considered, s.kept, s.delta)
        used = correct_state(calls, plan, S, b, s, SETTLED)
        keep_definite(P, before, s.half)
    s.result[0], s.result[1] = nis, 1.0 if used else 0.0


@entry(_nrt=False)
def carry_along(
    storage_at: int,
    b: int,
    rows: IntArray,
    landmarks: IntArray,
    F: FloatArray,
    Q: FloatArray,
    by_landmark: FloatArray,
    by_rows: FloatArray,
    room: FloatArray,
) -> None:
    """P = T P T^T + Q of filter b, T the identity but for some rows and for landmarks, from their first rows on.

    `room` (2, w + 3 N, n) is for the rows of P that change, before and after.
    """
    P, before, after, w = read_storage(storage_at).P[b], room[0], room[1], len(rows)
    changed, n = room.shape[1], room.shape[2]
    for i in range(changed):
        row = _row(rows, landmarks, i)
        for j in range(n):
            before[i, j] = P[row, j] if row <= j else P[j, row]
    for i in range(changed):
        for j in range(n):
            after[i, j] = 0.0
        _add(after[i], before, i, w, F, by_landmark, by_rows)
    for i in range(changed):  # the columns that change: T P T^T from T P
        for j in range(changed):
            total, m = 0.0, (j - w) // 3
            for k in range(w):
                total += after[i, rows[k]] * (F[j, k] if j < w else by_rows[m, (j - w) % 3, k])
            if j >= w:
                for k in range(3):
                    total += after[i, landmarks[m] + k] * by_landmark[m, (j - w) % 3, k]
            before[i, j] = total + Q[i, j] if i < w and j < w else total
    for i in range(changed):
        row = _row(rows, landmarks, i)
        for j in range(n):
            P[min(row, j), max(row, j)] = after[i, j]
    for i in range(changed):
        row = _row(rows, landmarks, i)
        for j in range(i, changed):
            column = _row(rows, landmarks, j)
            P[min(row, column), max(row, column)] = before[i, j]


@kernel
def _row(rows: IntArray, landmarks: IntArray, i: int) -> int:
    """Row of P of the i-th error that changes."""
    place: int = rows[i] if i < len(rows) else landmarks[(i - len(rows)) // 3] + (i - len(rows)) % 3
    return place


@kernel
def _add(
    target: FloatArray,
    before: FloatArray,
    i: int,
    w: int,
    F: FloatArray,
    by_landmark: FloatArray,
    by_rows: FloatArray,
) -> None:
    """Add row i of T P."""
    m, a = (i - w) // 3, (i - w) % 3
    for k in range(w):
        factor = F[i, k] if i < w else by_rows[m, a, k]
        if factor != 0.0:
            for j in range(len(target)):
                target[j] += factor * before[k, j]
    if i >= w:
        for k in range(3):
            for j in range(len(target)):
                target[j] += by_landmark[m, a, k] * before[w + 3 * m + k, j]
