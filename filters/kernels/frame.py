"""The whole frame of a filter, and of many filters, in one call: predict, update, landmarks that leave and enter."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numba import njit, types

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.rotations import right_jacobian_of
from filters.geometry.three_by_three import put, times, transposed
from filters.kernels.blas import ENTRY, KERNEL, PLAIN, ROUTINES, Routines, call
from filters.kernels.correction import (
    correct,
    correct_rows,
    explained,
    factorise,
    innovation_covariance,
    times_covariance,
)
from filters.kernels.covariance import (
    keep_considered,
    keep_definite,
    pose_variances,
    restore_considered,
)
from filters.kernels.disk_cache import KEPT
from filters.kernels.gating import largest_agreement, reweight, squared_distances
from filters.kernels.gauge_walk import walk_gauge
from filters.kernels.landmarks import clone_pose, close_gaps, enter, find, leave, start
from filters.kernels.linearisation import linearise, prepare, take_numbers
from filters.kernels.prediction import fade, fuse, orientation, predict, settle, take_steps
from filters.kernels.progress import counted
from filters.kernels.recipe import Plan, Recipe
from filters.kernels.retraction import move, retract, retract_by_numbers, scales_blocks
from filters.kernels.scratch import Scratch
from filters.kernels.sigma_points import fit
from filters.kernels.storage import BEHIND, BLOCKS, FAILED, GATED, LANDMARKS, OWN, USED, FrameArrays, Storage
from filters.kernels.units import (
    ADDRESSES,
    AGREE,
    BECOME,
    BEGIN,
    CORRECT,
    DOORS,
    ENTER,
    FUSE,
    GATE,
    ITERATE,
    LINEARISE,
    OF_PARTS,
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
    WALK,
    Unit,
    of_part,
    read_frame,
    read_plan,
    read_scratch,
    read_storage,
    unit,
)

FIRST, AGAIN, MOVED = range(3)
"""Where to linearise: at the state for the first time in a stage, there again, or where a correction leads."""
CORRECTED, SETTLED = range(2)
"""What a correction does to first estimates: landmarks leave them, odometry and other measurements move them along."""


@njit(**KERNEL)
def _ask(routines: Routines, door: int, b: int, s: Scratch, what: int, count: int) -> bool:
    """Ask the parts of filter b for numbers; whether they gave them."""
    call(routines[DOORS], (door, b, s.door[0], what, count))
    return s.door[1] == 0


@njit(**KERNEL)
def _linearise(
    routines: Routines,
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
    call(routines[LINEARISE], (routines, plan, variant, stage, S, b, x, blocks, s, count))
    return True


@njit(**KERNEL)
def _size(plan: Plan, frame: FrameArrays, variant: int, stage: int) -> int:
    """Rows of a stage."""
    return frame.sizes[variant, stage] if plan.by_numbers else plan.rows[variant, stage, 0]


@njit(**KERNEL)
def _limit(plan: Plan, frame: FrameArrays, variant: int, stage: int) -> float:
    """Squared distance up to which a measurement of a stage is believed."""
    return frame.limits[variant, stage] if plan.by_numbers else plan.limits[variant, stage]


@njit(**KERNEL)
def _steps(
    routines: Routines, plan: Plan, part: int, variant: int, stage: int, S: Storage, b: int, s: Scratch, count: int
) -> bool:
    """Steps of the selected landmarks before the first stage, by the Jacobian of (u, v, d)."""
    if stage > 0 or not plan.drift[part].any():
        return True
    x, blocks, whole = S.x[b], S.blocks[b], plan.T.shape[1] - 1
    if plan.by_numbers:
        if not _ask(routines, TO_DRIFT, b, s, part, count):
            return False
    else:
        _linearise(routines, plan, variant, whole, S, b, x, blocks, s, count, AGAIN)
    take_steps(plan, plan.drift[part], S.P[b], s, s.select, count)
    return _linearise(routines, plan, variant, stage, S, b, x, blocks, s, count, AGAIN)


@njit(**KERNEL)
def _retract(routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch, what: int) -> bool:
    """Move the state by delta and carry P along; whether the parts could."""
    if plan.moves_by_numbers and not _ask(routines, TO_MOVE, b, s, what, 0):
        return False
    call(routines[RETRACT], (routines, plan, S, b, s))
    if what == SETTLED:
        settle(plan, S.P[b], plan.leading + plan.size * S.counts[b, BLOCKS], S.x[b], S.predicted[b], s)
    return True


@njit(**KERNEL)
def _believable(
    routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch, count: int, size: int, limit: float
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
                for which in range(2 - plan.anchors, 3):
                    for j in range(3 if which < 2 else plan.size):
                        total += H[c] * s.W[s.base[m, which] + j, a]
                        c += 1
                s.nu[m, k] += total * s.delta[3 + a]
                s.block[a, 0] = total
            if plan.resets:  # leading points turn
                _times_block(H, 0, 3, s.F, s.G[0])
                if plan.sees_velocity:
                    _times_block(H, plan.velocity, 3, s.F, s.G[0])
            if scales_blocks(plan):
                c = measured
                for which in range(2 - plan.anchors, 3):
                    width = 3 if which < 2 else plan.size
                    _times_block(H, c, width, s.D[(s.base[m, which] - plan.leading) // plan.size], s.G[0])
                    c += width
            for a in range(3):
                H[3 + a] += s.block[a, 0]
            s.nu[m, k] += explained(plan, s, m, k)
            for a in range(3):
                s.nu[m, k] -= s.block[a, 0] * s.delta[3 + a]


@njit(**KERNEL)
def _times_block(H: FloatArray, first: int, width: int, D: FloatArray, before: FloatArray) -> None:
    """H[first:first + width] <- H[first:first + width] D, of D its first rows and columns."""
    for j in range(width):
        before[j] = H[first + j]
    for j in range(width):
        H[first + j] = 0.0
        for k in range(width):
            H[first + j] += before[k] * D[k, j]


@njit(**KERNEL)
def _propose(routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch, count: int, size: int, n: int) -> None:
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


@njit(**KERNEL)
def _keep_tangents(s: Scratch, count: int, size: int) -> None:
    """Copy H and nu of the selected measurements."""
    width = s.H.shape[2]
    for i in range(count):
        m = s.select[i]
        for k in range(size):
            for c in range(width):
                s.tangents[m, k, c] = s.H[m, k, c]
            s.tangents[m, k, width] = s.nu[m, k]


@njit(**KERNEL)
def _restore_straight(plan: Plan, s: Scratch, count: int, size: int) -> None:
    """Give measurements back the tangent from before the pass where it misses the result by little, or none is had.

    The miss is z - h(x1) - (nu - H delta), with h at the result x1, and nu and H from before.
    """
    for i in range(count):
        m = s.select[i]
        miss = 0.0
        for k in range(size):
            left = s.nu[m, k] - explained(plan, s, m, k)
            _exchange_tangent(s, m, k)
            left -= s.nu[m, k] - explained(plan, s, m, k)
            miss += left * left / s.R[m, k, k]
        if miss >= plan.relinearise_above:
            for k in range(size):
                _exchange_tangent(s, m, k)


@njit(**KERNEL)
def _exchange_tangent(s: Scratch, m: int, k: int) -> None:
    """Exchange a row of H and its nu with those that were kept."""
    width = s.H.shape[2]
    for c in range(width):
        s.H[m, k, c], s.tangents[m, k, c] = s.tangents[m, k, c], s.H[m, k, c]
    s.nu[m, k], s.tangents[m, k, width] = s.tangents[m, k, width], s.nu[m, k]


@unit(ADDRESSES, PLAN, types.int64, types.int64, STORAGE, types.int64, SCRATCH, types.int64, types.int64)
def iterate(
    routines: Routines, plan: Plan, variant: int, stage: int, S: Storage, b: int, s: Scratch, count: int, size: int
) -> None:
    """One pass before the last one: the selected measurements, linearised where it would move the state."""
    n = plan.leading + plan.size * S.counts[b, BLOCKS]
    _propose(routines, plan, S, b, s, count, size, n)
    for i in plan.considered:
        s.delta[i] = 0.0
    keeps = plan.relinearise_above > 0.0
    if keeps:
        _keep_tangents(s, count, size)
    if plan.moves_by_numbers:  # the linearisation is carried back where it is made
        if (
            _ask(routines, TO_MOVE, b, s, CORRECTED, 0)
            and _linearise(routines, plan, variant, stage, S, b, s.moved, s.moved_blocks, s, count, MOVED)
            and keeps
        ):
            _restore_straight(plan, s, count, size)
        return
    move(routines, plan, S, b, s)
    if not _linearise(routines, plan, variant, stage, S, b, s.moved, s.moved_blocks, s, count, MOVED):
        return
    if plan.resets:
        _left_jacobian(S.x[b], s.delta, s.F)
    _by_earlier_errors(plan, n, s, count, size)
    if keeps:
        _restore_straight(plan, s, count, size)


@njit(**KERNEL)
def _apply(
    routines: Routines, plan: Plan, variant: int, stage: int, S: Storage, b: int, s: Scratch, count: int, size: int
) -> tuple[float, int]:
    """Correct with the selected measurements, linearised: moves the state, writes fates; NIS and dof."""
    if count == 0:  # of the second stage of a joint test
        return 0.0, 0
    P, counts = S.P[b], S.counts[b]
    n = plan.leading + plan.size * counts[BLOCKS]
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
    _retract(routines, plan, S, b, s, CORRECTED)
    return nis, dof


@njit(**KERNEL)
def _stage(
    routines: Routines,
    plan: Plan,
    variant: int,
    stage: int,
    S: Storage,
    b: int,
    s: Scratch,
    frame: FrameArrays,
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
    n = plan.leading + plan.size * S.counts[b, BLOCKS]
    T = plan.T_uvd[variant, stage] if not plan.by_numbers else frame.T[variant, stage]
    call(routines[AGREE], (plan, P, n, s, s.select, count, size, limit, T, stage))
    best = int(s.result[0])
    core = np.int64(0)
    for i in range(count):
        m = s.select[i]
        if s.support[i, best]:
            s.select[core] = m
            core += 1
    nis, dof = _apply(routines, plan, variant, stage, S, b, s, core, size)
    if s.door[1] != 0:
        return 0.0, 0
    count = np.int64(0)
    for m in range(known):
        if s.fates[m] == GATED and s.ahead[m]:  # not in the core
            s.select[count] = m
            count += 1
    if not _linearise(routines, plan, variant, stage, S, b, x, blocks, s, count, AGAIN):
        return 0.0, 0
    count = _believable(routines, plan, S, b, s, count, size, limit)
    more, rows = _apply(routines, plan, variant, stage, S, b, s, count, size)
    return nis + more, dof + rows


@njit(**KERNEL)
def _candidates(
    routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays, first: int, last: int
) -> int:
    """Landmarks that start from measurements of unknown ones, in `place`, with their fates; their number."""
    if plan.by_numbers:
        if not _ask(routines, TO_START, b, s, first, last):
            return 0
        return int(s.result[0])
    new = np.int64(0)
    for i in range(first, last):
        if s.where[i - first] < 0:
            s.place[new] = i - first
            new += 1
    call(routines[BEGIN], (routines, plan, S, b, s, frame, first, new))
    return int(s.result[0])


@njit(**KERNEL)
def _may_change(routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch) -> bool:
    """Whether a landmark is to become a point, as far as kernels can say."""
    if routines[BECOME] == 0:
        return True
    x, P, blocks, count = S.x[b], S.P[b], S.blocks[b], 0
    for i in range(S.counts[b, LANDMARKS]):
        own, anchor = S.own[b, i], S.anchor[b, i, 0]
        if S.kind[b, own] == OWN:
            for a in range(3):
                s.points[count, a] = blocks[anchor, a] - x[a]
            for a in range(s.values_taken.shape[1]):
                s.values_taken[count, a] = blocks[own, a]
            for a in range(plan.size):
                row = plan.leading + plan.size * own + a
                s.correction[count, a] = P[row, row]
            s.gone[count] = False
            count += 1
    given = s.points[:count], s.values_taken[:count], s.correction[:count]
    call(routines[BECOME], (plan.landmark, *given, s.gone[:count]))
    return bool(s.gone[:count].any())


@njit(**KERNEL)
def _drop_unseen(plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays, first: int, last: int) -> None:
    """Take landmarks that are not seen out of the map, before the update: it would correct them for nothing."""
    ids, counts = S.ids[b], S.counts[b]
    landmarks = counts[LANDMARKS]
    s.gone[:landmarks] = True
    for i in range(last - first):
        if s.where[i] >= 0:
            s.gone[s.where[i]] = False
    leave(ids, S.own[b], S.anchor[b], S.users[b], counts, s.gone, frame.dropped[b])
    close_gaps(plan, S, b)
    find(ids, counts[LANDMARKS], frame.ids[first:last], s.where)
    frame.outcome[b, 0] = landmarks - counts[LANDMARKS]


@njit(**KERNEL)
def _renew(
    routines: Routines,
    plan: Plan,
    S: Storage,
    b: int,
    s: Scratch,
    frame: FrameArrays,
    first: int,
    last: int,
    found: int,
) -> None:
    """Landmarks enter, the least informative leave where there is a limit, and some change over to points."""
    landmarks, new, gone = S.counts[b, LANDMARKS], 0, 0
    s.gone[:landmarks] = False
    if last - first > found:
        new = _candidates(routines, plan, S, b, s, frame, first, last)
    if 0 < plan.most_landmarks < found + new:
        if not _ask(routines, TO_SELECT, b, s, first, found * 65536 + new):
            return
        new = int(s.result[0])
        if not plan.by_numbers:
            call(routines[BEGIN], (routines, plan, S, b, s, frame, first, new))
        elif not _ask(routines, TO_START, b, s, first, -new):
            return
    if s.door[1] != 0:
        return
    for i in range(landmarks):
        if s.gone[i]:
            gone += 1
    if gone > 0:
        leave(S.ids[b], S.own[b], S.anchor[b], S.users[b], S.counts[b], s.gone, frame.dropped[b, frame.outcome[b, 0] :])
    if plan.changes and _may_change(routines, plan, S, b, s) and not _ask(routines, TO_CHANGE, b, s, 0, 0):
        return
    if new > 0:
        call(routines[ENTER], (plan, S, b, s, frame, first, new))
    if gone > 0 or plan.changes:
        close_gaps(plan, S, b)
    frame.outcome[b, 0] += gone


@njit(**KERNEL)
def _predict(routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays) -> None:
    """The step of one filter, and odometry as a measurement after it."""
    P, x = S.P[b], S.x[b]
    n, before = plan.leading + plan.size * S.counts[b, BLOCKS], pose_variances(P)
    if plan.gauge_walk > 0.0:
        for i in range(7):
            s.before[i] = x[i]
    call(routines[PREDICT], (routines, plan, P, n, x, S.predicted[b], frame, b, s))
    if plan.gauge_walk > 0.0:
        if plan.walks_by_numbers and not _ask(routines, TO_WALK, b, s, 0, 0):
            return
        call(routines[WALK], (routines, plan, S, b, s, s.before))
    if plan.memory < np.inf:
        fade(plan, S, b, s, frame.dt[b])
    keep_definite(P, before, s.half)
    before = pose_variances(P)
    if frame.measured[b] > 0 if plan.driven_by_numbers else frame.fused[b] and plan.odometry_rows > 0:
        keep_considered(P, plan.considered, s.kept)
        call(routines[FUSE], (routines, plan, P, n, x, frame, b, s))
        if s.result[0] > 0.0:
            restore_considered(P, plan.considered, s.kept, s.delta)
            _retract(routines, plan, S, b, s, SETTLED)
            keep_definite(P, before, s.half)


@njit(**KERNEL)
def _advance(routines: Routines, plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays) -> None:
    """The frame of one filter."""
    if not (frame.seen[b] or frame.dt[b] > 0.0):
        return
    first, last = frame.offsets[b], frame.offsets[b + 1]
    counts = S.counts[b]
    found = find(S.ids[b], counts[LANDMARKS], frame.ids[first:last], s.where)
    each = 1 if plan.shares_anchors else 1 + plan.anchors
    needed = counts[BLOCKS] + each * (last - first - found) + (plan.anchors if plan.shares_anchors else 0)
    frame.outcome[b, 1] = 0
    if frame.seen[b] and found < last - first and needed > S.blocks.shape[1]:
        frame.outcome[b, 1] = needed
        return
    P = S.P[b]
    if frame.dt[b] > 0.0:
        _predict(routines, plan, S, b, s, frame)
    if s.door[1] != 0 or not frame.seen[b]:
        return
    if plan.drop_unseen and found < counts[LANDMARKS]:
        _drop_unseen(plan, S, b, s, frame, first, last)
    known = np.int64(0)
    for i in range(last - first):
        if s.where[i] >= 0:
            s.place[known], s.land[known], s.fates[known] = i, s.where[i], USED
            for a in range(3):
                for c in range(3):
                    s.noise[known, a, c] = frame.R[first + i, a, c]
            known += 1
    if known > 0:
        variant, before = 1 if frame.with_right[b] else 0, pose_variances(P)
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
        keep_definite(P, before, s.half)
        for m in range(known):
            frame.fates[first + s.place[m]] = s.fates[m]
    if plan.changes or plan.most_landmarks > 0 or known < last - first:
        _renew(routines, plan, S, b, s, frame, first, last, known)


@njit(_nrt=False, **KEPT, **ENTRY)
def advance(
    routines: Routines, plan_at: int, storage_at: int, scratch_at: int, frame_at: int, first: int, last: int
) -> None:
    """The frames of the filters first to last - 1, in place, from what is `Packed` at these addresses.

    A filter without room says so, and stays as it was.
    """
    plan, S, s, frame = read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at), read_frame(frame_at)
    for b in range(first, last):
        _advance(routines, plan, S, b, s, frame)
        if s.door[1] != 0:
            return


def compile_frame() -> None:
    """Compile `advance`, or load it from the disk, before it is called."""
    if not PLAIN:
        advance.compile(types.void(ADDRESSES, *[types.intp] * 4, types.int64, types.int64))


CLONE, FORGET, CLOSE_GAPS = range(3)
"""Changes of the map from outside of a frame."""


@njit(_nrt=False, **KEPT, **ENTRY)
def change(routines: Routines, plan_at: int, storage_at: int, scratch_at: int, b: int, what: int) -> None:
    """Clone the pose of filter b, or take the landmarks marked in `gone` or blocks without users out of its map."""
    plan, S, s = read_plan(plan_at), read_storage(storage_at), read_scratch(scratch_at)
    if what == CLONE:
        clone_pose(plan, S, b, s)
        return
    if what == FORGET:
        leave(S.ids[b], S.own[b], S.anchor[b], S.users[b], S.counts[b], s.gone, s.entered)
    close_gaps(plan, S, b)


@njit(_nrt=False, **KEPT, **ENTRY)
def correct_by(
    routines: Routines,
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
    P, n = S.P[b], plan.leading + plan.size * S.counts[b, BLOCKS]
    before = pose_variances(P)
    keep_considered(P, plan.considered, s.kept)
    nis = correct_rows(routines, P, n, rows, H, nu, R, limit, s)
    used = 0.0 <= nis <= limit
    if used:
        restore_considered(P, plan.considered, s.kept, s.delta)
        used = _retract(routines, plan, S, b, s, SETTLED)
        keep_definite(P, before, s.half)
    s.result[0], s.result[1] = nis, 1.0 if used else 0.0


def kernels(recipe: Recipe, fuses: bool) -> tuple[Any, ...]:
    """Compile `advance`, the units and the kernels of parts that this recipe calls; their addresses, zero for others.

    LAPACK's come first; that of the doors follows.
    """
    plan = recipe.plan
    gated = plan.by_numbers or bool((plan.limits < np.inf).any())
    needed: dict[int, tuple[Unit, bool]] = {
        PREDICT: (predict, True),
        FUSE: (fuse, fuses),
        LINEARISE: (fit if len(plan.sigma_points) else linearise, not plan.by_numbers),
        GATE: (squared_distances, gated or plan.tail_dof < np.inf),
        AGREE: (largest_agreement, gated and plan.consensus),
        ITERATE: (iterate, plan.iterations > 1),
        CORRECT: (correct, True),
        RETRACT: (retract_by_numbers if plan.moves_by_numbers else retract, True),
        BEGIN: (start, not plan.by_numbers),
        ENTER: (enter, True),
        WALK: (walk_gauge, plan.gauge_walk > 0.0),
    }
    turns = plan.turns or not plan.additive
    parts = (
        *((recipe.landmark, name, not plan.by_numbers or plan.gauge_walk > 0.0) for name in ("point", "start")),
        *(
            (recipe.landmark, name, turns or plan.first_estimates or plan.gauge_walk > 0.0)
            for name in ("turn", "rotation")
        ),
        (recipe.landmark, "become", plan.changes),
        *((recipe.sensor, name, not plan.by_numbers) for name in ("predict", "backproject")),
        (recipe.motion, "step", True),
        (recipe.motion, "measure", fuses),
    )
    assert len(parts) == len(OF_PARTS)
    asked: list[Callable[[], Any] | None] = [
        partial(getattr, unit, "address") if called else None for _, (unit, called) in sorted(needed.items())
    ]
    asked += [partial(of_part, part, name) if part and called else None for part, name, called in parts]
    addresses = [0] * len(asked)
    with counted(1 + sum(ask is not None for ask in asked)) as count:
        compile_frame()
        count()
        for place, ask in enumerate(asked):
            if ask is not None:
                addresses[place] = ask()
                count()
    return (*ROUTINES, *addresses)
