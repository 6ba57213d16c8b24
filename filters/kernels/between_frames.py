"""Changes of one filter between its frames: clones, landmarks that leave, and corrections by the caller."""

from __future__ import annotations

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.blas import entry
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
