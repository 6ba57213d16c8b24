"""The whole frame of a filter, and of many filters, in one call: predict, update, landmarks that leave and enter."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types

from filters.engine.compiled.blas import ENTRY, KERNEL, ROUTINES, call
from filters.engine.compiled.correction import (
    correct,
    correct_leading,
    correct_rows,
    explained,
    factorise,
    fuse,
    innovation_covariance,
    times_covariance,
)
from filters.engine.compiled.covariance import keep_considered, restore_considered
from filters.engine.compiled.disk_cache import KEPT
from filters.engine.compiled.drift import take_steps
from filters.engine.compiled.gating import largest_agreement, reweight, squared_distances
from filters.engine.compiled.gauge_walk import walk_gauge
from filters.engine.compiled.landmarks import can_start, clone_pose, close_gaps, enter, find, leave
from filters.engine.compiled.prediction import orientation, predict, put, right_jacobian_of, times, transposed
from filters.engine.compiled.projection import linearise, prepare, project, take_numbers
from filters.engine.compiled.recipe import FIRST_ESTIMATES, INVARIANT, RIGHT_INVARIANT, Plan
from filters.engine.compiled.retraction import moved_by, retract, retract_by_numbers, retract_invariant, transport
from filters.engine.compiled.storage import BLOCKS, LANDMARKS, Frame, Scratch, Storage
from filters.engine.compiled.units import (
    ADDRESSES,
    AGREE,
    CORRECT,
    DOORS,
    ENTER,
    FUSE,
    GATE,
    ITERATE,
    LINEARISE,
    MATRIX,
    PLAN,
    PREDICT,
    RETRACT,
    SCRATCH,
    STORAGE,
    TO_CHANGE,
    TO_DRIFT,
    TO_LINEARISE,
    TO_MOVE,
    TO_SELECT,
    TO_START,
    TO_WALK,
    VECTOR,
    WALK,
    Unit,
    read_frame,
    read_plan,
    read_scratch,
    read_storage,
    unit,
)
from filters.validation import FloatArray, IntArray

USED, BEHIND, GATED, FAILED, STARTED, REJECTED = range(6)
"""Outcome of a measurement: used, behind the camera, gated, no Cholesky factor of S; started a landmark, or not."""
FIRST, AGAIN, MOVED = range(3)
"""Where to linearise: at the state for the first time in a stage, there again, or where a correction leads."""


@njit(**KERNEL)
def _ask(routines: tuple[int, ...], door: int, b: int, s: Scratch, what: int, count: int) -> bool:
    """Ask the parts of filter b for numbers; whether they gave them."""
    call(routines[DOORS], (door, b, s.door[0], what, count))
    return s.door[1] == 0


@njit(**KERNEL)
def _linearise(
    routines: tuple[int, ...],
    plan: Plan,
    variant: int,
    stage: int,
    S: Storage,
    b: int,
    x: FloatArray,
    blocks: FloatArray,
    s: Scratch,
    count: int,
    where: int,
) -> bool:
    """Innovation, H and first rows of the selected measurements; whether there were numbers."""
    if plan.by_numbers:
        return _ask(routines, TO_LINEARISE, b, s, (where * 2 + variant) * 8 + stage, count)
    call(routines[LINEARISE], (plan, variant, stage, S, b, x, blocks, s, count))
    return True


@njit(**KERNEL)
def _size(plan: Plan, frame: Frame, variant: int, stage: int) -> int:
    """Rows of a stage."""
    return frame.sizes[variant, stage] if plan.by_numbers else plan.rows[variant, stage, 0]


@njit(**KERNEL)
def _limit(plan: Plan, frame: Frame, variant: int, stage: int) -> float:
    """Squared distance up to which a measurement of a stage is believed."""
    return frame.limits[variant, stage] if plan.by_numbers else plan.limits[variant, stage]


@njit(**KERNEL)
def _steps(
    routines: tuple[int, ...],
    plan: Plan,
    part: int,
    variant: int,
    stage: int,
    S: Storage,
    b: int,
    s: Scratch,
    count: int,
) -> bool:
    """Steps of the selected landmarks before the first stage, by the Jacobian of (u, v, d)."""
    if stage > 0 or not plan.drift[part].any():
        return True
    x, blocks, whole = S.x[b], S.blocks[b], plan.T.shape[1] - 1
    if plan.by_numbers:
        if not _ask(routines, TO_DRIFT, b, s, part, count):
            return False
        return part > 0 or _linearise(routines, plan, variant, stage, S, b, x, blocks, s, count, AGAIN)
    if not plan.joint and not _linearise(routines, plan, variant, whole, S, b, x, blocks, s, count, AGAIN):
        return False
    take_steps(plan, plan.drift[part], S.P[b], s, s.select, count)
    return plan.joint or _linearise(routines, plan, variant, stage, S, b, x, blocks, s, count, AGAIN)


@njit(**KERNEL)
def _retract(routines: tuple[int, ...], plan: Plan, S: Storage, b: int, s: Scratch) -> bool:
    """Move the state by delta and carry P along; whether the parts could."""
    if plan.moves_by_numbers and not _ask(routines, TO_MOVE, b, s, 0, 0):
        return False
    call(routines[RETRACT], (plan, S.P[b], S.x[b], S.blocks[b], S.kind[b], S.counts[b, BLOCKS], s))
    return True


@unit(PLAN, types.int64, types.int64, STORAGE, types.int64, VECTOR, MATRIX, SCRATCH, types.int64)
def linearise_unit(
    plan: Plan, variant: int, stage: int, S: Storage, b: int, x: FloatArray, blocks: FloatArray, s: Scratch, count: int
) -> None:
    """Innovations at a state, H there or at the first estimates."""
    own, anchor = S.own[b], S.anchor[b]
    if plan.error != FIRST_ESTIMATES:
        linearise(plan, variant, stage, x, blocks, anchor, own, s, count)
        return
    point = s.point
    for i in range(len(x)):
        point[i] = S.predicted[b, i] if i < 7 else x[i]
    first, at = S.first[b], s.point_blocks
    for c in range(S.counts[b, BLOCKS]):
        for i in range(3):
            at[c, i] = first[c, i]
    if plan.anchored:
        for i in range(S.counts[b, LANDMARKS]):
            at[own[i], 2] = blocks[own[i], 2]
    linearise(plan, variant, stage, point, at, anchor, own, s, count)
    project(plan, variant, stage, x, blocks, anchor, own, s, count)


@njit(**KERNEL)
def _believable(
    routines: tuple[int, ...], plan: Plan, S: Storage, b: int, s: Scratch, count: int, size: int, limit: float
) -> int:
    """Gate the selected measurements, linearised; those that pass stay selected, their number."""
    kept = 0
    call(routines[GATE], (plan, S.P[b], s, s.select, count, size))
    for i in range(count):
        m = s.select[i]
        if s.distances[m] <= limit:
            s.select[kept] = m
            kept += 1
    return kept


@njit(**KERNEL)
def _by_earlier_errors(plan: Plan, n: int, s: Scratch, count: int, size: int) -> None:
    """`LinearisedMeasurements.by_earlier_errors`, with the transport in W and D of the scratch."""
    measured = plan.measured
    for i in range(count):
        m = s.select[i]
        for k in range(size):
            H = s.H[m, k]
            for a in range(3):
                total = 0.0
                for c in range(measured):
                    total += H[c] * s.W[c, a]
                c = measured
                for which in range(0 if plan.anchored else 1, 2):
                    for j in range(3):
                        total += H[c] * s.W[s.base[m, which] + j, a]
                        c += 1
                s.nu[m, k] += total * s.delta[3 + a]
                s.block[a, 0] = total
            if plan.error == INVARIANT:  # the block-diagonal part
                _times_block(H, 0, s.F)
                c = measured
                for which in range(0 if plan.anchored else 1, 2):
                    _times_block(H, c, s.D[(s.base[m, which] - plan.leading) // 3])
                    c += 3
            for a in range(3):
                H[3 + a] += s.block[a, 0]
            s.nu[m, k] += explained(plan, s, m, k)
            for a in range(3):
                s.nu[m, k] -= s.block[a, 0] * s.delta[3 + a]


@njit(**KERNEL)
def _times_block(H: FloatArray, first: int, D: FloatArray) -> None:
    """H[first:first + 3] <- H[first:first + 3] D."""
    a, b, c = H[first], H[first + 1], H[first + 2]
    for j in range(3):
        H[first + j] = a * D[0, j] + b * D[1, j] + c * D[2, j]


@njit(**KERNEL)
def _propose(
    routines: tuple[int, ...], plan: Plan, S: Storage, b: int, s: Scratch, count: int, size: int, n: int
) -> None:
    """delta of one pass, P as it was: from one batch, or chunk by chunk on a copy where that has no factor."""
    P, rows = S.P[b], count * size
    times_covariance(plan, P, n, s, s.select, 0, count, size)
    if innovation_covariance(plan, s, s.select, 0, count, size) and factorise(routines, s, rows):
        HP, L = s.HP, s.S  # the factor is L^T in rows: L[j, i] for i >= j
        for i in range(rows):
            m = s.select[i // size]
            HP[i, n] = s.nu[m, i % size]
        for i in range(rows):
            HP[i, n] /= L[i, i]
            for j in range(i + 1, rows):
                HP[j, n] -= L[i, j] * HP[i, n]
        for i in range(rows - 1, -1, -1):
            total = HP[i, n]
            for j in range(i + 1, rows):
                total -= L[i, j] * HP[j, n]
            HP[i, n] = total / L[i, i]
        for j in range(n):
            s.delta[j] = 0.0
        for i in range(rows):
            a = HP[i, n]
            for j in range(n):
                s.delta[j] += a * HP[i, j]
        return
    for i in range(n):
        for j in range(i, n):
            s.copy[i, j] = P[i, j]
    call(routines[CORRECT], (routines, plan, s.copy, n, s, s.select, count, size))


@njit(**KERNEL)
def _left_jacobian(x: FloatArray, delta: FloatArray, J: FloatArray) -> None:
    """J_l of the rotation delta in W, (3, 3)."""
    t0, t1, t2 = times(orientation(x), delta[3], delta[4], delta[5])
    put(J, 0, 0, transposed(right_jacobian_of(t0, t1, t2)), 1.0)


@unit(ADDRESSES, PLAN, types.int64, types.int64, STORAGE, types.int64, SCRATCH, types.int64, types.int64)
def iterate(
    routines: tuple[int, ...],
    plan: Plan,
    variant: int,
    stage: int,
    S: Storage,
    b: int,
    s: Scratch,
    count: int,
    size: int,
) -> None:
    """One pass before the last one: the selected measurements, linearised where it would move the state."""
    x, blocks, counts, kind = S.x[b], S.blocks[b], S.counts[b], S.kind[b]
    n = plan.leading + 3 * counts[BLOCKS]
    _propose(routines, plan, S, b, s, count, size, n)
    for i in plan.considered:
        s.delta[i] = 0.0
    if plan.moves_by_numbers:  # the linearisation is carried back where it is made
        if _ask(routines, TO_MOVE, b, s, 0, 0):
            _linearise(routines, plan, variant, stage, S, b, s.moved, s.moved_blocks, s, count, MOVED)
        return
    moved_by(plan, x, blocks, counts[BLOCKS], s.delta, kind, s.moved, s.moved_blocks)
    if not _linearise(routines, plan, variant, stage, S, b, s.moved, s.moved_blocks, s, count, MOVED):
        return
    transport(plan, x, blocks, counts[BLOCKS], s.delta, kind, s.moved, s.moved_blocks, s.W, s.D)
    if plan.error == INVARIANT:
        _left_jacobian(x, s.delta, s.F)
    _by_earlier_errors(plan, n, s, count, size)


@njit(**KERNEL)
def _apply(
    routines: tuple[int, ...],
    plan: Plan,
    variant: int,
    stage: int,
    S: Storage,
    b: int,
    s: Scratch,
    count: int,
    size: int,
) -> tuple[float, int]:
    """Correct with the selected measurements, linearised: moves the state, writes fates; NIS and dof."""
    if count == 0:  # of the second stage of a joint test
        return 0.0, 0
    P, counts = S.P[b], S.counts[b]
    n = plan.leading + 3 * counts[BLOCKS]
    if not _steps(routines, plan, 1, variant, stage, S, b, s, count):
        return 0.0, 0
    if plan.tail_dof < 1e300:
        call(routines[GATE], (plan, P, s, s.select, count, size))
        reweight(plan, s, s.select, count, size)
    for _ in range(plan.iterations - 1):
        call(routines[ITERATE], (routines, plan, variant, stage, S, b, s, count, size))
        if s.door[1] != 0:
            return 0.0, 0
    keep_considered(P, plan.considered, s.kept)
    call(routines[CORRECT], (routines, plan, P, n, s, s.select, count, size))
    nis, dof = s.result[0], 0
    restore_considered(P, plan.considered, s.kept, s.delta)
    for i in range(count):
        m = s.select[i]
        if s.used[m]:
            s.fates[m] = USED
            dof += size
        else:
            s.fates[m] = FAILED
    _retract(routines, plan, S, b, s)
    return nis, dof


@njit(**KERNEL)
def _stage(
    routines: tuple[int, ...],
    plan: Plan,
    variant: int,
    stage: int,
    S: Storage,
    b: int,
    s: Scratch,
    frame: Frame,
    known: int,
) -> tuple[float, int]:
    """One stage of the update, with the measurements whose fate so far is USED; NIS and dof."""
    x, blocks, P = S.x[b], S.blocks[b], S.P[b]
    size, limit = _size(plan, frame, variant, stage), _limit(plan, frame, variant, stage)
    gated = limit < 1e300
    count = np.int64(0)
    for m in range(known):
        s.ahead[m] = False  # of those that an earlier stage has refused
        if s.fates[m] == USED:
            s.select[count] = m
            count += 1
    if not _linearise(routines, plan, variant, stage, S, b, x, blocks, s, count, FIRST):
        return 0.0, 0
    ahead = np.int64(0)  # with a plain 0, Numba compiles what takes it a second time, for that number alone
    for i in range(count):
        m = s.select[i]
        if s.ahead[m]:
            s.select[ahead] = m
            s.fates[m] = GATED
            ahead += 1
        else:
            s.fates[m] = BEHIND
    count = ahead
    if not _steps(routines, plan, 0, variant, stage, S, b, s, count):
        return 0.0, 0
    if gated:
        count = _believable(routines, plan, S, b, s, count, size, limit)
    if not (gated and plan.consensus):
        return _apply(routines, plan, variant, stage, S, b, s, count, size)
    n = plan.leading + 3 * S.counts[b, BLOCKS]
    T = plan.T[variant, stage] if not plan.by_numbers else frame.T[variant, stage]
    call(routines[AGREE], (plan, P, n, s, s.select, count, size, limit, T, stage))
    best = int(s.result[0])
    core = np.int64(0)
    for i in range(count):
        m = s.select[i]
        if s.support[i, best]:
            s.select[core] = m
            core += 1
    for i in range(core):
        s.core[i] = s.select[i]
    nis, dof = _apply(routines, plan, variant, stage, S, b, s, core, size)
    if s.door[1] != 0:
        return 0.0, 0
    count, taken = np.int64(0), 0
    for m in range(known):
        if taken < core and s.core[taken] == m:
            taken += 1
        elif s.fates[m] == GATED and s.ahead[m]:
            s.select[count] = m
            count += 1
    if not _linearise(routines, plan, variant, stage, S, b, x, blocks, s, count, AGAIN):
        return 0.0, 0
    count = _believable(routines, plan, S, b, s, count, size, limit)
    more, rows = _apply(routines, plan, variant, stage, S, b, s, count, size)
    return nis + more, dof + rows


@njit(**KERNEL)
def _candidates(
    routines: tuple[int, ...], plan: Plan, S: Storage, b: int, s: Scratch, frame: Frame, first: int, last: int
) -> int:
    """Measurements that landmarks can start from, in `place`, with their fates; their number."""
    new, x = 0, S.x[b]
    if plan.by_numbers:
        if not _ask(routines, TO_START, b, s, first, last):
            return 0
        return int(s.result[0])
    for i in range(first, last):
        if s.where[i - first] < 0:
            if can_start(plan, x, frame.uvd[i, 0], frame.uvd[i, 1], frame.uvd[i, 2]):
                frame.fates[i] = STARTED
                s.place[new] = i - first
                new += 1
            else:
                frame.fates[i] = REJECTED
    return new


@njit(**KERNEL)
def _renew(
    routines: tuple[int, ...],
    plan: Plan,
    S: Storage,
    b: int,
    s: Scratch,
    frame: Frame,
    first: int,
    last: int,
    found: int,
) -> None:
    """Landmarks that were not seen leave, new ones enter, and some change over to points."""
    landmarks, new, gone = S.counts[b, LANDMARKS], 0, 0
    for i in range(landmarks):
        s.gone[i] = plan.drop_unseen
    for m in range(found):
        s.gone[s.land[m]] = False
    if last - first > found:
        new = _candidates(routines, plan, S, b, s, frame, first, last)
    if 0 < plan.most_landmarks < found + new:
        if not _ask(routines, TO_SELECT, b, s, first, found * 65536 + new):
            return
        new = int(s.result[0])
        if plan.by_numbers and not _ask(routines, TO_START, b, s, first, -new):
            return
    if s.door[1] != 0:
        return
    for i in range(landmarks):
        if s.gone[i]:
            gone += 1
    if gone > 0:
        leave(S.ids[b], S.own[b], S.anchor[b], S.users[b], S.counts[b], s.gone, frame.dropped[b])
    if plan.changes and not _ask(routines, TO_CHANGE, b, s, 0, 0):
        return
    if new > 0:
        call(routines[ENTER], (plan, S, b, s, frame.ids, frame.uvd, frame.R, first, new))
    if gone > 0 or plan.changes:
        close_gaps(plan, S, b)
    frame.outcome[b, 0] = gone


@njit(**KERNEL)
def _predict(routines: tuple[int, ...], plan: Plan, S: Storage, b: int, s: Scratch, frame: Frame, dt: float) -> None:
    """The step of one filter, and odometry as a measurement after it."""
    P, x, row = S.P[b], S.x[b], b if plan.driven_by_numbers else 0
    n = plan.leading + 3 * S.counts[b, BLOCKS]
    odometry, covariance = frame.odometry[b], frame.odometry_covariance[b]
    if plan.gauge_walk > 0.0:
        for i in range(7):
            s.before[i] = x[i]
    moved, F, Q = frame.moved[row], frame.F[row], frame.Q[row]
    call(routines[PREDICT], (plan, P, n, x, S.predicted[b], dt, odometry, covariance, moved, F, Q, s))
    if plan.gauge_walk > 0.0:
        if plan.walks_by_numbers and not _ask(routines, TO_WALK, b, s, 0, 0):
            return
        call(routines[WALK], (plan, S, b, s, s.before))
    if plan.driven_by_numbers:
        rows = frame.measured[b]
        if rows > 0:
            keep_considered(P, plan.considered, s.kept)
            used = correct_leading(
                routines, P, n, frame.measured_H[b, :rows], frame.measured_nu[b], frame.measured_R[b], s
            )
            if used:
                restore_considered(P, plan.considered, s.kept, s.delta)
                _retract(routines, plan, S, b, s)
    elif frame.fused[b] and not plan.velocity_driven:
        call(routines[FUSE], (routines, plan, P, n, x, dt, odometry, covariance, s))
        if s.result[0] > 0.0:
            _retract(routines, plan, S, b, s)


@njit(**KERNEL)
def _advance(routines: tuple[int, ...], plan: Plan, S: Storage, b: int, s: Scratch, frame: Frame) -> None:
    """The frame of one filter."""
    if not (frame.seen[b] or frame.dt[b] > 0.0):
        return
    first, last = frame.offsets[b], frame.offsets[b + 1]
    counts = S.counts[b]
    found = find(S.ids[b], counts[LANDMARKS], frame.ids[first:last], s.where)
    each = 2 if plan.anchored and not plan.shares_anchors else 1
    needed = counts[BLOCKS] + each * (last - first - found) + (1 if plan.shares_anchors else 0)
    frame.outcome[b, 1] = 0
    if frame.seen[b] and found < last - first and needed > S.blocks.shape[1]:
        frame.outcome[b, 1] = needed
        return
    if frame.dt[b] > 0.0:
        _predict(routines, plan, S, b, s, frame, frame.dt[b])
    if s.door[1] != 0 or not frame.seen[b]:
        return
    known = np.int64(0)
    for i in range(last - first):
        if s.where[i] >= 0:
            s.place[known], s.land[known], s.fates[known] = i, s.where[i], USED
            for a in range(3):
                for c in range(3):
                    s.noise[known, a, c] = frame.R[first + i, a, c]
            known += 1
    if known > 0:
        variant = 1 if frame.with_right[b] else 0
        for stage in range(frame.stages[variant] if plan.by_numbers else plan.stages[variant]):
            if plan.by_numbers:
                take_numbers(frame.stage_z[stage], frame.stage_R[stage], first, s, known)
            else:
                prepare(plan, variant, stage, frame.uvd, frame.R, frame.v_right, first, s, known)
            nis, dof = _stage(routines, plan, variant, stage, S, b, s, frame, known)
            if s.door[1] != 0:
                return
            frame.nis[b] += nis
            frame.dof[b] += dof
        for m in range(known):
            frame.fates[first + s.place[m]] = s.fates[m]
    unseen = plan.drop_unseen and known < counts[LANDMARKS]
    if unseen or plan.changes or plan.most_landmarks > 0 or known < last - first:
        _renew(routines, plan, S, b, s, frame, first, last, known)


@njit(types.void(ADDRESSES, *[types.intp] * 4, types.int64, types.int64), _nrt=False, **KEPT, **ENTRY)
def advance(
    routines: tuple[int, ...], plan_at: int, storage_at: int, scratch_at: int, frame_at: int, first: int, last: int
) -> None:
    """The frames of the filters first to last - 1, in place, from what is `Packed` at these addresses.

    A filter without room says so, and stays as it was.
    """
    plan, S, s, frame = read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at), read_frame(frame_at)
    for b in range(first, last):
        _advance(routines, plan, S, b, s, frame)
        if s.door[1] != 0:
            return


CLONE, FORGET, CLOSE_GAPS = range(3)
"""Changes of the map from outside of a frame."""


@njit(_nrt=False, **KEPT, **ENTRY)
def change(routines: tuple[int, ...], plan_at: int, storage_at: int, scratch_at: int, b: int, what: int) -> None:
    """Clone the pose of filter b, or take the landmarks marked in `gone` or blocks without users out of its map."""
    plan, S, s = read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at)
    if what == CLONE:
        clone_pose(plan, S, b, s)
        return
    if what == FORGET:
        leave(S.ids[b], S.own[b], S.anchor[b], S.users[b], S.counts[b], s.gone, s.core)
    close_gaps(plan, S, b)


@njit(_nrt=False, **KEPT, **ENTRY)
def correct_by(
    routines: tuple[int, ...],
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
    plan, S, s = read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at)
    P, n = S.P[b], plan.leading + 3 * S.counts[b, BLOCKS]
    keep_considered(P, plan.considered, s.kept)
    nis = correct_rows(routines, P, n, rows, H, nu, R, limit, s)
    used = 0.0 <= nis <= limit
    if used:
        restore_considered(P, plan.considered, s.kept, s.delta)
        used = _retract(routines, plan, S, b, s)
    s.result[0], s.result[1] = nis, 1.0 if used else 0.0


def kernels(plan: Plan, fuses: bool) -> tuple[Any, ...]:
    """Addresses that `advance` wants, of LAPACK and of the units; zero for those that this plan never calls.

    That of the doors follows.
    """
    gated = plan.by_numbers or bool((plan.limits < np.inf).any())
    by_error = retract if plan.error < RIGHT_INVARIANT else retract_invariant
    needed: dict[int, tuple[Unit, bool]] = {
        PREDICT: (predict, True),
        FUSE: (fuse, fuses),
        LINEARISE: (linearise_unit, not plan.by_numbers),
        GATE: (squared_distances, gated or plan.tail_dof < np.inf),
        AGREE: (largest_agreement, gated and plan.consensus),
        ITERATE: (iterate, plan.iterations > 1),
        CORRECT: (correct, True),
        RETRACT: (retract_by_numbers if plan.moves_by_numbers else by_error, True),
        ENTER: (enter, True),
        WALK: (walk_gauge, plan.gauge_walk > 0.0),
    }
    return (*ROUTINES, *(unit.address if called else 0 for _, (unit, called) in sorted(needed.items())))
