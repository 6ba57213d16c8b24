"""One frame of a filter, and of many filters, in one call. From top to bottom this file is the filter.

In the words of a textbook, with x the state, P its covariance, z, R the measurements of landmarks in the map:

    x, F, G = f(x, dt);  P = F P F^T + G Q G^T                      predict            prediction.py
    h, H = measurement of the landmarks in the map                  linearise          linearisation.py
    keep those with nu^T (H P H^T + R)^-1 nu <= limit, nu = z - h   gate               here: `_gate`; gating.py
    S = H P H^T + R;  K = P H^T S^-1;  delta = K nu                 correct            correction.py
    P = (I - K H) P
    x = x [+] delta, and P in the tangent space there               retract            retraction.py
    landmarks that are not seen: their rows and columns leave P     marginalise        landmarks.py
    new ones: y = g(x, z), P = [P, P G_x^T; G_x P, G_x P G_x^T + G_z R G_z^T]   initialise, augment   landmarks.py

`tests/filters/textbook.py` is that filter in dense NumPy, and the engine is held against it.
"""

from __future__ import annotations

import numpy as np
from numba import types

from filters.geometry.arrays import FloatArray
from filters.kernels.blas import PLAIN, entry, kernel
from filters.kernels.calls import (
    Calls,
    call,
    exists,
    read_calls,
    read_frame,
    read_plan,
    read_scratch,
    read_storage,
    unit,
)
from filters.kernels.covariance import keep_considered, keep_definite, pose_variances, restore_considered
from filters.kernels.gating import reweight
from filters.kernels.landmarks import close_gaps, find, marginalise
from filters.kernels.linearisation import prepare, take_homogeneous
from filters.kernels.recipe import Plan
from filters.kernels.records import (
    BEHIND,
    BLOCKS,
    FAILED,
    GATED,
    LANDMARKS,
    OWN,
    POINT,
    USED,
    VECTOR,
    FrameArrays,
    Scratch,
    Storage,
)
from filters.kernels.retraction import CORRECTED, SETTLED, correct_state


@entry(_nrt=False)
def run_frames(
    calls_at: int, plan_at: int, storage_at: int, scratch_at: int, frame_at: int, first: int, last: int
) -> None:
    """The frames of the filters first to last - 1, in place, from what is `Packed` at these addresses.

    A filter without room says so, and stays as it was.
    """
    calls, plan, S = read_calls(calls_at), read_plan(plan_at), read_storage(storage_at)
    s, frame = read_scratch(scratch_at), read_frame(frame_at)
    for b in range(first, last):
        _frame(calls, plan, S, b, s, frame)


def compile_frame() -> None:
    """Compile `run_frames`, or load it from the disk, before it is called."""
    if not PLAIN:
        run_frames.compile(types.void(*[types.intp] * 5, types.int64, types.int64))


@kernel
def _frame(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays) -> None:
    """The frame of one filter."""
    if not (frame.seen[b] or frame.dt[b] > 0.0):
        return
    first, last = frame.offsets[b], frame.offsets[b + 1]
    counts = S.counts[b]
    place = find(S.ids[b], counts[LANDMARKS], frame.ids[first:last], s.where)
    each = 1 if plan.shares_anchors else 1 + plan.anchors
    needed = counts[BLOCKS] + each * (last - first - place) + (plan.anchors if plan.shares_anchors else 0)
    frame.outcome[b, 1] = 0
    if frame.seen[b] and place < last - first and needed > S.blocks.shape[1]:
        frame.outcome[b, 1] = needed
        return
    P = S.P[b]
    if frame.dt[b] > 0.0:
        _predict(calls, plan, S, b, s, frame)
    if not frame.seen[b]:
        return
    if plan.drop_unseen and place < counts[LANDMARKS]:
        call(calls.drop_unseen, (plan, S, b, s, frame, first, last))
    matched_count = np.int64(0)
    for i in range(last - first):
        if s.where[i] >= 0:
            s.place[matched_count], s.land[matched_count], s.fates[matched_count] = i, s.where[i], USED
            for a in range(3):
                for c in range(3):
                    s.noise[matched_count, a, c] = frame.R[first + i, a, c]
            matched_count += 1
    if matched_count > 0:
        variant, before = 1 if frame.with_right[b] else 0, pose_variances(P)
        for stage in range(plan.stages[variant]):
            prepare(plan, variant, stage, frame.uvd, frame.R, frame.v_right, first, s, matched_count)
            nis, dof = _stage(calls, plan, variant, stage, S, b, s, matched_count)
            frame.nis[b] += nis
            frame.dof[b] += dof
        keep_definite(P, before, s.half)
        for m in range(matched_count):
            frame.fates[first + s.place[m]] = s.fates[m]
    if plan.changes or matched_count < last - first:
        _renew(calls, plan, S, b, s, frame, first, last, matched_count)


@kernel
def _predict(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays) -> None:
    """The step of one filter, and odometry as a measurement after it."""
    P, x = S.P[b], S.x[b]
    n, before = plan.leading + plan.size * S.counts[b, BLOCKS], pose_variances(P)
    if plan.gauge_walk > 0.0:
        for i in range(7):
            s.before[i] = x[i]
    call(calls.predict, (calls, plan, P, n, x, S.predicted[b], frame, b, s))
    for c in range(S.counts[b, BLOCKS]):
        if S.kind[b, c] >= VECTOR:
            for a in range(3):
                row = plan.leading + plan.size * c + a
                P[row, row] += S.walk[b, c, a] * frame.dt[b]
    if plan.gauge_walk > 0.0:
        call(calls.walk_gauge, (calls, plan, S, b, s, s.before))
    if plan.memory < np.inf:
        call(calls.fade, (plan, S, b, s, frame.dt[b]))
    keep_definite(P, before, s.half)
    before = pose_variances(P)
    if frame.fused[b] and plan.odometry_rows > 0:
        keep_considered(P, plan.considered, s.kept)
        call(calls.fuse_odometry, (calls, plan, P, n, x, frame, b, s))
        if s.result[0] > 0.0:
            restore_considered(P, plan.considered, s.kept, s.delta)
            correct_state(calls, plan, S, b, s, SETTLED)
            keep_definite(P, before, s.half)


@kernel
def _stage(
    calls: Calls, plan: Plan, variant: int, stage: int, S: Storage, b: int, s: Scratch, known: int
) -> tuple[float, int]:
    """One stage of the update, with the measurements whose fate so far is USED; NIS and dof."""
    x, blocks, P = S.x[b], S.blocks[b], S.P[b]
    size, limit = plan.rows[variant, stage, 0], plan.limits[variant, stage]
    gated = limit < 1e300
    count = np.int64(0)
    for m in range(known):
        s.ahead[m] = False  # of those that an earlier stage has refused
        if s.fates[m] == USED:
            s.select[count] = m
            count += 1
    call(calls.linearise, (calls, plan, variant, stage, S, b, x, blocks, s, count))
    ahead = np.int64(0)  # with a plain 0, Numba compiles what takes it a second time, for that number alone
    for i in range(count):
        m = s.select[i]
        if s.ahead[m]:
            s.select[ahead] = m
            s.fates[m] = GATED  # what passes the gate is USED or FAILED in the end: `_apply` says so
            ahead += 1
        else:
            s.fates[m] = BEHIND
    count = ahead
    if stage == 0 and exists(calls.drift):
        call(calls.drift, (calls, plan, 0, variant, stage, S, b, s, count))
    if gated:
        count = _gate(calls, plan, S, b, s, count, size, limit)
    if not (gated and plan.consensus):
        return _apply(calls, plan, variant, stage, S, b, s, count, size)
    n = plan.leading + plan.size * S.counts[b, BLOCKS]
    call(calls.agree, (plan, P, n, s, s.select, count, size, limit, plan.T_uvd[variant, stage], stage))
    best = int(s.result[0])
    core = np.int64(0)
    for i in range(count):
        m = s.select[i]
        if s.support[i, best]:
            s.select[core] = m
            core += 1
    nis, dof = _apply(calls, plan, variant, stage, S, b, s, core, size)
    count = np.int64(0)
    for m in range(known):
        if s.fates[m] == GATED and s.ahead[m]:  # not in the core
            s.select[count] = m
            count += 1
    call(calls.linearise, (calls, plan, variant, stage, S, b, x, blocks, s, count))
    count = _gate(calls, plan, S, b, s, count, size, limit)
    more, rows = _apply(calls, plan, variant, stage, S, b, s, count, size)
    return nis + more, dof + rows


@kernel
def _gate(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, count: int, size: int, limit: float) -> int:
    """Gate the selected measurements, linearised; those that pass stay selected, their number."""
    kept_count = 0
    call(calls.distances, (plan, S.P[b], s, s.select, count, size))
    for i in range(count):
        m = s.select[i]
        if s.mahalanobis2[m] <= limit:
            s.select[kept_count] = m
            kept_count += 1
    return kept_count


@kernel
def _apply(
    calls: Calls, plan: Plan, variant: int, stage: int, S: Storage, b: int, s: Scratch, count: int, size: int
) -> tuple[float, int]:
    """Correct with the selected measurements, linearised: moves the state, writes fates; NIS and dof."""
    if count == 0:  # of the second stage of a joint test
        return 0.0, 0
    P, counts = S.P[b], S.counts[b]
    n = plan.leading + plan.size * counts[BLOCKS]
    if stage == 0 and exists(calls.drift):
        call(calls.drift, (calls, plan, 1, variant, stage, S, b, s, count))
    if plan.tail_dof < 1e300:
        call(calls.distances, (plan, P, s, s.select, count, size))
        reweight(plan, s, s.select, count, size)
    for _ in range(plan.iterations - 1):
        call(calls.iterate, (calls, plan, variant, stage, S, b, s, count, size))
    keep_considered(P, plan.considered, s.kept)
    call(calls.correct, (calls, plan, P, n, s, s.select, count, size))
    nis, dof = s.result[0], 0
    restore_considered(P, plan.considered, s.kept, s.delta)
    for i in range(count):
        m = s.select[i]
        if s.used[m]:
            s.fates[m] = USED
            dof += size
        else:
            s.fates[m] = FAILED
    correct_state(calls, plan, S, b, s, CORRECTED)
    return nis, dof


@kernel
def _renew(
    calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays, first: int, last: int, found: int
) -> None:
    """Landmarks enter, from measurements of unknown ones that can start one, and some change over to points."""
    new = np.int64(0)
    if last - first > found:
        for i in range(first, last):
            if s.where[i - first] < 0:
                s.place[new] = i - first
                new += 1
        call(calls.initialise, (calls, plan, S, b, s, frame, first, new))
        new = np.int64(s.result[0])
    if plan.changes:
        call(calls.become_points, (calls, plan, S, b, s))
    if new > 0:
        call(calls.augment, (plan, S, b, s, frame, first, new))
    if plan.changes:
        close_gaps(plan, S, b)


@unit("become_points")
def become_points(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch) -> None:
    """Turn landmarks into points of W where their part asks for it (Eq. 4); an anchor that none uses any more may go.

    The Jacobian is that at the linearisation point.
    """
    x, blocks, before, own, anchor = S.x[b], S.blocks[b], S.first[b], S.own[b], S.anchor[b]
    count, count_chosen = np.int64(0), np.int64(0)
    for i in range(S.counts[b, LANDMARKS]):
        if S.kind[b, own[i]] == OWN:
            s.taken[count] = i
            for a in range(3):
                s.points[count, a] = blocks[anchor[i], a] - x[a]
                row = plan.leading + plan.size * own[i] + a
                s.correction[count, a] = S.P[b, row, row]
            for a in range(s.values_taken.shape[1]):
                s.values_taken[count, a] = blocks[own[i], a]
            s.gone[count] = False
            count += 1
    arguments = s.points[:count], s.values_taken[:count], s.correction[:count]
    call(calls.become, (plan.landmark, *arguments, s.gone[:count]))
    for k in range(count):
        if s.gone[k]:
            i = s.taken[count_chosen] = s.taken[k]
            for a in range(s.values_taken.shape[1]):
                s.values_taken[count_chosen, a] = blocks[own[i], a]
            count_chosen += 1
    if count_chosen == 0:
        return
    take_homogeneous(calls, plan, s, s.values_taken, count_chosen)
    for k in range(count_chosen):
        i, p = s.taken[k], s.points[k]
        for a in range(3):
            place = blocks[anchor[i], a] + p[a] / p[3]
            blocks[own[i], a] = place
            if not plan.first_estimates:
                before[own[i], a] = place
    if plan.first_estimates:
        for k in range(count_chosen):
            i = s.taken[k]
            for a in range(s.values_taken.shape[1]):
                follows = False
                for c in plan.follows:
                    follows = follows or a == c
                if not follows:
                    s.values_taken[k, a] = before[own[i], a]
        take_homogeneous(calls, plan, s, s.values_taken, count_chosen)
        for k in range(count_chosen):
            i, p = s.taken[k], s.points[k]
            for a in range(3):
                before[own[i], a] = before[anchor[i], a] + p[a] / p[3]
    n, J = plan.leading + plan.size * S.counts[b, BLOCKS], s.small[0]
    for k in range(count_chosen):
        i, p, by_own = s.taken[k], s.points[k], s.by_own[k]
        for a in range(3):
            for c in range(3):
                J[a, c] = (by_own[a, c] - p[a] / p[3] * by_own[3, c]) / p[3]
        _carry_to_point(S.P[b], n, plan.leading + 3 * anchor[i], plan.leading + 3 * own[i], J, s.HP, s.block)
        S.users[b, anchor[i]] -= 1
        S.kind[b, own[i]], anchor[i] = POINT, -1


@kernel
def _carry_to_point(
    P: FloatArray, n: int, anchor: int, own: int, J: FloatArray, rows: FloatArray, point: FloatArray
) -> None:
    """P where the numbers at the rows from `own` on become those at `anchor` plus J times themselves."""
    for a in range(3):
        for j in range(n):
            rows[a, j] = P[min(anchor + a, j), max(anchor + a, j)]
            rows[3 + a, j] = P[min(own + a, j), max(own + a, j)]
    for a in range(3):
        for j in range(n):
            point[a, j] = rows[a, j] + J[a, 0] * rows[3, j] + J[a, 1] * rows[4, j] + J[a, 2] * rows[5, j]
    for a in range(3):
        for j in range(n):
            P[min(own + a, j), max(own + a, j)] = point[a, j]
    for a in range(3):
        for c in range(a, 3):
            P[own + a, own + c] = point[a, anchor + c]
            for k in range(3):
                P[own + a, own + c] += point[a, own + k] * J[c, k]


@unit("drop_unseen")
def drop_unseen(plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays, first: int, last: int) -> None:
    """Take landmarks that are not seen out of the map, before the update: it would correct them for nothing."""
    ids, counts = S.ids[b], S.counts[b]
    landmarks = counts[LANDMARKS]
    s.gone[:landmarks] = True
    for i in range(last - first):
        if s.where[i] >= 0:
            s.gone[s.where[i]] = False
    marginalise(ids, S.own[b], S.anchor[b], S.users[b], counts, s.gone, frame.dropped[b])
    close_gaps(plan, S, b)
    find(ids, counts[LANDMARKS], frame.ids[first:last], s.where)
    frame.outcome[b, 0] = landmarks - counts[LANDMARKS]
