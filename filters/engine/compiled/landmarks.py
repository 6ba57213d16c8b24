"""Kernels of the map: landmarks that are found, that leave, and that enter with their cross-covariances."""

from __future__ import annotations

import math

from numba import njit, types

from filters.engine.compiled.blas import KERNEL, multiply_panel
from filters.engine.compiled.covariance import move_block, take_leading
from filters.engine.compiled.prediction import (
    constrain,
    orientation,
    put,
    right_jacobian_of,
    skew,
    times,
    transposed,
    world_rotation,
)
from filters.engine.compiled.projection import view_of
from filters.engine.compiled.recipe import FIRST_ESTIMATES, Plan
from filters.engine.compiled.retraction import angles_jacobian, ray_rotation
from filters.engine.compiled.storage import BLOCKS, CLONE_POSITION, LANDMARKS, OWN, POINT, Scratch, Storage
from filters.engine.compiled.units import FRAME, PLAN, SCRATCH, STORAGE, unit
from filters.validation import BoolArray, FloatArray, IntArray

NEW_IDS, NEW, NEW_NOISE = (FRAME.kind[FRAME.kind.fields.index(name)] for name in ("ids", "uvd", "R"))
FARTHEST = 1e6
"""No camera measures a pixel or a disparity as large, px; squares of what would come of 1e300 overflow."""
VERTICAL = 1e-6
"""Tangent of the angle to the vertical below which azimuth is undefined in double precision."""


@njit(**KERNEL)
def find(ids: IntArray, landmarks: int, wanted: IntArray, where: IntArray) -> int:
    """Landmark of each of the ascending ids, -1 where it is not in the map; how many are."""
    i, found = 0, 0
    for m in range(len(wanted)):
        while i < landmarks and ids[i] < wanted[m]:
            i += 1
        if i < landmarks and ids[i] == wanted[m]:
            where[m] = i
            found += 1
        else:
            where[m] = -1
    return found


@njit(**KERNEL)
def leave(
    ids: IntArray,
    own: IntArray,
    anchor: IntArray,
    users: IntArray,
    counts: IntArray,
    goes: BoolArray,
    dropped: IntArray,
) -> None:
    """Take the landmarks marked in `goes` out of the map. Their blocks stay."""
    kept, gone = 0, 0
    for i in range(counts[LANDMARKS]):
        if not goes[i]:
            ids[kept], own[kept], anchor[kept] = ids[i], own[i], anchor[i]
            kept += 1
        else:
            dropped[gone] = ids[i]
            gone += 1
            users[own[i]] -= 1
            if anchor[i] >= 0:
                users[anchor[i]] -= 1
    counts[LANDMARKS] = kept


@njit(**KERNEL)
def close_gaps(plan: Plan, S: Storage, b: int) -> None:
    """Move the last blocks into those that nobody uses."""
    users, own, anchor, held = S.users[b], S.own[b], S.anchor[b], S.held[b]
    count = S.counts[b, BLOCKS]
    gap = 0
    while True:
        while count > 0 and users[count - 1] == 0:
            count -= 1
        while gap < count and users[gap] > 0:
            gap += 1
        if gap >= count:
            break
        last = count - 1
        move_block(S.P[b], plan.leading + 3 * last, plan.leading + 3 * gap)
        for i in range(S.blocks.shape[2]):
            S.blocks[b, gap, i], S.first[b, gap, i] = S.blocks[b, last, i], S.first[b, last, i]
        S.kind[b, gap] = S.kind[b, last]
        for i in range(S.counts[b, LANDMARKS]):
            if own[i] == last:
                own[i] = gap
            if anchor[i] == last:
                anchor[i] = gap
        for i in range(len(held)):
            if held[i] < 0:
                break
            if held[i] == last:
                held[i] = gap
        users[gap], users[last] = users[last], 0
    S.counts[b, BLOCKS] = count


@njit(**KERNEL)
def can_start(plan: Plan, x: FloatArray, u: float, v: float, d: float) -> bool:
    """Whether a landmark can start from a measurement (`MapPolicy._can_start`)."""
    if not (abs(u) < FARTHEST and abs(v) < FARTHEST and abs(d) < FARTHEST and d >= plan.min_disparity):
        return False
    view = view_of(plan, x)
    if not plan.anchored:
        return d - view.offset > 0.0
    h0, h1, h2 = times(transposed(view.E), (u - plan.cx) / view.scale_u, (v - plan.cy) / view.scale_v, 1.0)
    w0, w1, w2 = times(view.R, h0, h1, h2)
    return w0 * w0 + w2 * w2 > VERTICAL * VERTICAL * w1 * w1


@njit(**KERNEL)
def initialise(
    plan: Plan, x: FloatArray, u: float, v: float, d: float, block: FloatArray, J: FloatArray, B: FloatArray
) -> None:
    """`LandmarkModel.initialise` with the calibration: block (3,), J by the measured leading rows, B by (u, v, d)."""
    view, measured = view_of(plan, x), plan.measured
    e0, e1 = (u - plan.cx) / view.scale_u, (v - plan.cy) / view.scale_v  # the ray (e0, e1, 1) that is projected
    per_d = 1.0 / view.scale_d
    scale = (d - view.offset) * per_d
    E_back = transposed(view.E)
    h0, h1, h2 = times(E_back, e0, e1, 1.0)
    w0, w1, w2 = times(view.R, h0, h1, h2)
    for i in range(3):
        for c in range(measured):
            J[i, c] = 0.0
    length_squared = e0 * e0 + e1 * e1 + 1.0
    inverse_length = 1.0 / math.sqrt(length_squared)
    if plan.anchored:
        block[0], block[1] = math.atan2(w0, w2), math.atan2(-w1, math.sqrt(w0 * w0 + w2 * w2))
        block[2] = scale * inverse_length
    else:
        block[0], block[1], block[2] = x[0] + w0 / scale, x[1] + w1 / scale, x[2] + w2 / scale
        for i in range(3):
            J[i, i] = 1.0
    A = angles_jacobian(w0, w1, w2)
    left = transposed(right_jacobian_of(*view.misalignment))
    for c in range(12):  # rotation (3), u, v, d, and the six numbers of the calibration
        row = plan.calibration[c - 6] if c >= 6 else c
        if row < 0:
            continue
        d0, d1, d2, ds, along = 0.0, 0.0, 0.0, 0.0, 0.0  # of the ray in the camera frame, of the scale, of e along e
        if c < 3:
            a0, a1, a2 = 1.0 if c == 0 else 0.0, 1.0 if c == 1 else 0.0, 1.0 if c == 2 else 0.0
            d0, d1, d2 = a1 * h2 - a2 * h1, a2 * h0 - a0 * h2, a0 * h1 - a1 * h0
        elif c < 5:
            by0, by1 = (1.0 / view.scale_u, 0.0) if c == 3 else (0.0, 1.0 / view.scale_v)
            d0, d1, d2 = times(E_back, by0, by1, 0.0)
            along = e0 * by0 + e1 * by1
        elif c == 5:
            ds = per_d
        elif c == 6:
            ds = -per_d
        elif c == 7:
            by0, by1 = -e0 / view.focal, -e1 / view.focal
            d0, d1, d2 = times(E_back, by0, by1, 0.0)
            along, ds = e0 * by0 + e1 * by1, -scale / view.focal
        elif c == 8:
            ds = -scale / view.baseline
        else:  # E_back [e]x J_l
            a0, a1, a2 = left[c - 9], left[3 + c - 9], left[6 + c - 9]
            d0, d1, d2 = times(E_back, e1 * a2 - a1, a0 - e0 * a2, e0 * a1 - e1 * a0)
        g0, g1, g2 = times(view.R, d0, d1, d2)
        if plan.anchored:
            by0 = A[0] * g0 + A[1] * g1 + A[2] * g2
            by1 = A[3] * g0 + A[4] * g1 + A[5] * g2
            by2 = inverse_length * (ds - scale * along / length_squared)
        else:
            over = ds / scale
            by0, by1, by2 = (g0 - w0 * over) / scale, (g1 - w1 * over) / scale, (g2 - w2 * over) / scale
        if c < 3:
            J[0, 3 + c], J[1, 3 + c], J[2, 3 + c] = by0, by1, by2
        elif c < 6:
            B[0, c - 3], B[1, c - 3], B[2, c - 3] = by0, by1, by2
        else:
            J[0, row], J[1, row], J[2, row] = by0, by1, by2


@njit(**KERNEL)
def _add_block(plan: Plan, S: Storage, b: int, s: Scratch, n: int, row: int, J: FloatArray) -> None:
    """Columns row to row + 2 of the whole leading rows: P J^T."""
    for i in range(plan.measured):
        for c in range(3):
            total = 0.0
            for k in range(plan.measured):
                total += s.lead[i, k] * J[c, k]
            s.lead[i, row + c] = total


@njit(**KERNEL)
def _write_rows(plan: Plan, P: FloatArray, n: int, row: int, J: FloatArray, s: Scratch) -> None:
    """Rows row to row + 2 of P: J times the leading rows, whole."""
    block = s.block
    multiply_panel(block, 0, J, 3, s.lead, 0, 0, plan.measured, n)
    for j in range(row):
        for c in range(3):
            P[j, row + c] = block[c, j]
    for c in range(3):
        for j in range(row + c, n):
            P[row + c, j] = block[c, j]


@njit(**KERNEL)
def _merge(
    all_ids: IntArray,
    own: IntArray,
    anchor: IntArray,
    counts: IntArray,
    s: Scratch,
    ids: IntArray,
    first: int,
    count: int,
) -> None:
    """Put the new landmarks among the others, ids ascending."""
    i, j, target = counts[LANDMARKS] - 1, count - 1, counts[LANDMARKS] + count - 1
    while j >= 0:
        new = ids[first + s.place[j]]
        if i >= 0 and all_ids[i] > new:
            all_ids[target], own[target], anchor[target] = all_ids[i], own[i], anchor[i]
            i -= 1
        else:
            all_ids[target], own[target] = new, s.core[j]
            anchor[target] = s.land[j]
            j -= 1
        target -= 1
    counts[LANDMARKS] += count


@unit(PLAN, STORAGE, types.int64, SCRATCH, NEW_IDS, NEW, NEW_NOISE, types.int64, types.int64)
def enter(
    plan: Plan, S: Storage, b: int, s: Scratch, ids: IntArray, uvd: FloatArray, R: FloatArray, first: int, count: int
) -> None:
    """Add landmarks from the `count` measurements in `place` (`JointState.augment`); there is room for them."""
    P, x, blocks, users, counts = S.P[b], S.x[b], S.blocks[b], S.users[b], S.counts[b]
    measured, leading = plan.measured, plan.leading
    taken, by_landmark, made = s.core, s.land, s.select  # parameter and anchor block of each, all anchor blocks
    gap, anchors = 0, 0
    for i in range(count):
        by_landmark[i] = -1
        if plan.anchored and (not plan.by_numbers or s.anchored[i]):
            if anchors == 0 or not plan.shares_anchors:
                while gap < counts[BLOCKS] and users[gap] > 0:
                    gap += 1
                if gap == counts[BLOCKS]:
                    counts[BLOCKS] += 1
                users[gap], S.kind[b, gap], made[anchors] = 0, POINT, gap
                anchors += 1
            users[made[anchors - 1]] += 1
            by_landmark[i] = made[anchors - 1]
    for i in range(count):
        while gap < counts[BLOCKS] and users[gap] > 0:
            gap += 1
        if gap == counts[BLOCKS]:
            counts[BLOCKS] += 1
        users[gap], taken[i] = 1, gap
        free = by_landmark[i] < 0 and (plan.changes or not plan.own_landmarks)
        S.kind[b, gap] = POINT if free else OWN
    n = leading + 3 * counts[BLOCKS]
    take_leading(P, n, measured, s.lead)
    source, image = s.W, s.W[leading:]
    R_predicted = orientation(S.predicted[b])
    if plan.error == FIRST_ESTIMATES:
        world_rotation(S.predicted[b], plan.velocity, source[:leading])
    J = s.F[:3]  # of an anchor
    for i in range(anchors):
        for a in range(3):
            blocks[made[i], a] = S.first[b, made[i], a] = x[a]
            for k in range(measured):
                J[a, k] = 1.0 if a == k else 0.0
        if plan.error == FIRST_ESTIMATES:
            put(image, 0, 0, skew(x[0], x[1], x[2]), -1.0)
            constrain(J, 3, 6, image, source, R_predicted)
        _add_block(plan, S, b, s, n, leading + 3 * made[i], J)
    for i in range(count):
        m, block = first + s.place[i], blocks[taken[i]]
        if plan.by_numbers:  # H and noise are there
            for a in range(blocks.shape[1]):
                block[a] = S.first[b, taken[i], a] = s.values[i, a]
        else:
            initialise(plan, x, uvd[m, 0], uvd[m, 1], uvd[m, 2], block, s.H[i, :3], s.R[i])
            for a in range(3):
                S.first[b, taken[i], a] = block[a]
            if plan.error == FIRST_ESTIMATES:
                if plan.anchored:
                    effect = ray_rotation(block[0], block[1])
                    for a in range(3):
                        image[0, a], image[1, a], image[2, a] = effect[a], effect[3 + a], 0.0
                else:
                    put(image, 0, 0, skew(block[0], block[1], block[2]), -1.0)
                constrain(s.H[i, :3], 3, 6, image, source, R_predicted)
        _add_block(plan, S, b, s, n, leading + 3 * taken[i], s.H[i, :3])
    for i in range(anchors):
        _write_rows(plan, P, n, leading + 3 * made[i], J, s)
    for i in range(count):
        m, row = first + s.place[i], leading + 3 * taken[i]
        _write_rows(plan, P, n, row, s.H[i, :3], s)
        noise = R[m]
        for a in range(3):
            for c in range(a, 3):
                if plan.by_numbers:
                    P[row + a, row + c] += s.values_noise[i, a, c]
                    continue
                for p in range(3):
                    for q in range(3):
                        P[row + a, row + c] += s.R[i, a, p] * noise[p, q] * s.R[i, c, q]
    _merge(S.ids[b], S.own[b], S.anchor[b], counts, s, ids, first, count)


@njit(**KERNEL)
def clone_pose(plan: Plan, S: Storage, b: int, s: Scratch) -> None:
    """Keep the present pose as two held blocks; there is room for them."""
    P, x, counts, held = S.P[b], S.x[b], S.counts[b], S.held[b]
    places, gap, end = s.core, 0, 0
    while held[end] >= 0:
        end += 1
    for k in range(2):
        while gap < counts[BLOCKS] and S.users[b, gap] > 0:
            gap += 1
        if gap == counts[BLOCKS]:
            counts[BLOCKS] += 1
        S.users[b, gap], held[end + k], places[k] = 1, gap, gap
        S.kind[b, gap] = CLONE_POSITION + k
        for i in range(3 + k):
            S.blocks[b, gap, i] = S.first[b, gap, i] = x[3 * k + i]
    n, J = plan.leading + 3 * counts[BLOCKS], s.F[:3]
    take_leading(P, n, plan.measured, s.lead)
    for step in range(2):
        for k in range(2):
            row = plan.leading + 3 * places[k]
            for a in range(3):
                for c in range(plan.measured):
                    J[a, c] = 1.0 if c == 3 * k + a else 0.0
            if step == 0:
                _add_block(plan, S, b, s, n, row, J)
            else:
                _write_rows(plan, P, n, row, J, s)
