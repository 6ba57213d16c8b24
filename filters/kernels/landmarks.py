"""Kernels of the map: landmarks that are found, that leave, and that enter with their cross-covariances."""

from __future__ import annotations

import math

from filters.geometry.arrays import BoolArray, FloatArray, IntArray
from filters.geometry.vectors import cross_matrix, put, times, transposed
from filters.kernels.blas import kernel, multiply_panel
from filters.kernels.calls import Calls, call, unit
from filters.kernels.covariance import clear, move_block, orientation, take_leading
from filters.kernels.linearisation import by_velocity, clear_all, sense, take_homogeneous, take_variables
from filters.kernels.prediction import constrain, world_rotation
from filters.kernels.recipe import Plan
from filters.kernels.records import (
    BLOCKS,
    CLONE_POSITION,
    LANDMARKS,
    OWN,
    POINT,
    REJECTED,
    STARTED,
    FrameArrays,
    Scratch,
    Storage,
)

FARTHEST = 1e6
"""No camera measures a pixel or a disparity as large, px; squares of what would come of 1e300 overflow."""


@kernel
def find(ids: IntArray, landmarks: int, wanted: IntArray, where: IntArray) -> int:
    """Landmark of each of the ascending ids, -1 where it is not in the map; how many are."""
    i, matches = 0, 0
    for m in range(len(wanted)):
        while i < landmarks and ids[i] < wanted[m]:
            i += 1
        if i < landmarks and ids[i] == wanted[m]:
            where[m] = i
            matches += 1
        else:
            where[m] = -1
    return matches


@kernel
def marginalise(
    ids: IntArray,
    own: IntArray,
    anchor: IntArray,
    users: IntArray,
    counts: IntArray,
    goes: BoolArray,
    dropped: IntArray,
) -> None:
    """Take the landmarks marked in `goes` out of the map. Their blocks stay."""
    kept_count, gone_count = 0, 0
    for i in range(counts[LANDMARKS]):
        if not goes[i]:
            ids[kept_count], own[kept_count] = ids[i], own[i]
            anchor[kept_count] = anchor[i]
            kept_count += 1
        else:
            dropped[gone_count] = ids[i]
            gone_count += 1
            users[own[i]] -= 1
            if anchor[i] >= 0:
                users[anchor[i]] -= 1
    counts[LANDMARKS] = kept_count


@kernel
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
        move_block(S.P[b], plan.leading + plan.size * last, plan.leading + plan.size * gap, plan.size)
        for i in range(S.blocks.shape[2]):
            S.blocks[b, gap, i], S.first[b, gap, i] = S.blocks[b, last, i], S.first[b, last, i]
        S.kind[b, gap] = S.kind[b, last]
        for i in range(3):
            S.walk[b, gap, i] = S.walk[b, last, i]
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


@kernel
def _see_new(calls: Calls, plan: Plan, x: FloatArray, s: Scratch, count: int) -> None:
    """New landmarks, with the values that they start with, in the camera frame (`points`), and the sensor's numbers."""
    take_homogeneous(calls, plan, s, s.values, count)
    R_cw = transposed(orientation(x))
    for i in range(count):
        p, scale = s.points[i], 0.0 if plan.anchors > 0 else s.points[i, 3]
        p[0], p[1], p[2] = times(R_cw, p[0] - scale * x[0], p[1] - scale * x[1], p[2] - scale * x[2])
    sense(calls, plan, s, s.points, count)


@kernel
def _add_prior(plan: Plan, x: FloatArray, s: Scratch, i: int, kept: int) -> None:
    """Add (I - G H) prior (I - G H)^T: what the measurement leaves open, as after an update with gain G.

    G = d numbers / d (u, v, d), of `small[0]`, and H is its inverse.
    """
    G, H, by_open, J, by_own = s.small[0], s.small[1], s.small[2], s.by_point[i], s.by_own[i]
    R, most = orientation(x), plan.size - 3
    for p in range(most):
        column = 3 + p
        scale = 0.0 if plan.anchors > 0 else by_own[3, column]
        w = by_own[:, column]
        c0, c1, c2 = times(transposed(R), w[0] - scale * x[0], w[1] - scale * x[1], w[2] - scale * x[2])
        for q in range(3):
            H[q, p] = J[q, 0] * c0 + J[q, 1] * c1 + J[q, 2] * c2
            for e in range(3, J.shape[1]):
                H[q, p] += J[q, e] * by_own[e, column]
        for a in range(plan.size):
            by_open[a, p] = 1.0 if a == column else 0.0
            for q in range(3):
                by_open[a, p] -= G[a, q] * H[q, p]
    for a in range(plan.size):
        for c in range(a, plan.size):
            for p in range(most):
                for q in range(most):
                    s.values_noise[kept, a, c] += by_open[a, p] * plan.prior[p, q] * by_open[c, q]


@unit("initialise")
def initialise(
    calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays, first: int, count: int
) -> None:
    """Landmarks at the `count` measurements in `place` (Eq. 19-25); those that can start stay, `result` counts them."""
    x, measured = S.x[b], plan.measured
    values_width = s.back_by_values.shape[2]
    for i in range(count):
        for a in range(3):
            s.uvd[i, a] = frame.uvd[first + s.place[i], a]
    take_variables(plan, x, s)
    clear_all(s.by_uvd, count)
    clear_all(s.back_by_values, count)
    clear(s.points_c[:count])
    arguments = plan.sensor, plan.camera, s.uvd[:count], s.sensed
    call(calls.backproject, (*arguments, s.points_c[:count], s.by_uvd[:count], s.back_by_values[:count]))
    R = orientation(x)
    for i in range(count):
        scale = s.points_c[i, 3]
        s.points[i, 0], s.points[i, 1], s.points[i, 2] = times(R, s.points_c[i, 0], s.points_c[i, 1], s.points_c[i, 2])
        for a in range(3, s.points.shape[1]):
            s.points[i, a] = s.points_c[i, a]
        if plan.anchors == 0:
            for a in range(3):
                s.points[i, a] += scale * x[a]
    clear_all(s.by_start, count)
    clear(s.values[:count])
    for i in range(count):
        s.possible[i] = False
    call(calls.start, (plan.landmark, s.points[:count], s.values[:count], s.by_start[:count], s.possible[:count]))
    if plan.size > 3:
        _see_new(calls, plan, x, s, count)
    kept_count = 0
    for i in range(count):
        able = s.possible[i]
        for a in range(3):
            u = s.uvd[i, a]
            able = able and abs(u) < FARTHEST
        for a in range(s.points.shape[1]):
            able = able and math.isfinite(s.points[i, a])
        able = able and s.uvd[i, 2] >= plan.min_disparity
        m = first + s.place[i]
        frame.fates[m] = STARTED if able else REJECTED
        if not able:
            continue
        H, B, h = s.H[kept_count], s.small[0], s.points_c[i]
        for a in range(plan.size):
            J = s.by_start[i, a]
            by_scale = J[3]
            if plan.anchors == 0:
                by_scale += J[0] * x[0] + J[1] * x[1] + J[2] * x[2]
            c0, c1, c2 = times(transposed(R), J[0], J[1], J[2])
            for k in range(3):
                H[a, k] = 0.0 if plan.anchors > 0 else h[3] * J[k]
                by_uvd = s.by_uvd[i]
                B[a, k] = c0 * by_uvd[0, k] + c1 * by_uvd[1, k] + c2 * by_uvd[2, k] + by_scale * by_uvd[3, k]
                for e in range(4, len(J)):
                    B[a, k] += J[e] * by_uvd[e, k]
            H[a, 3], H[a, 4], H[a, 5] = h[1] * c2 - h[2] * c1, h[2] * c0 - h[0] * c2, h[0] * c1 - h[1] * c0
            for j in range(values_width):
                by_other = s.back_by_values[i]
                along = c0 * by_other[0, j] + c1 * by_other[1, j] + c2 * by_other[2, j]
                H[a, 6 + j] = along + by_scale * by_other[3, j]
                for e in range(4, len(J)):
                    H[a, 6 + j] += J[e] * by_other[e, j]
            if plan.sees_velocity:
                by_velocity(plan, x, H[a])
        for a in range(plan.size):
            for c in range(a, plan.size):
                total = 0.0
                for p in range(3):
                    for q in range(3):
                        total += B[a, p] * frame.R[m, p, q] * B[c, q]
                s.values_noise[kept_count, a, c] = total
        if plan.size > 3:
            _add_prior(plan, x, s, i, kept_count)
        for a in range(s.values.shape[1]):
            s.values[kept_count, a] = s.values[i, a]
        s.place[kept_count] = s.place[i]
        kept_count += 1
    if plan.first_estimates:
        source = s.W[: plan.leading]
        world_rotation(plan, S.predicted[b], source)
        clear_all(s.effect, kept_count)
        if not plan.points:
            call(calls.rotation, (plan.landmark, s.values[:kept_count], s.effect[:kept_count]))
        for i in range(kept_count):
            if plan.points:
                put(s.effect[i], 0, 0, cross_matrix(s.values[i, 0], s.values[i, 1], s.values[i, 2]), -1.0)
            constrain(s.H[i], plan.size, measured, s.effect[i], source, orientation(S.predicted[b]))
    J = s.by_anchor
    for a in range(3):
        for k in range(measured):
            J[a, k] = 1.0 if a == k else 0.0
    if plan.first_estimates:
        put(s.block, 0, 0, cross_matrix(x[0], x[1], x[2]), -1.0)
        constrain(J, 3, measured, s.block, source, orientation(S.predicted[b]))
    s.result[0] = kept_count


@kernel
def _add_block(plan: Plan, s: Scratch, row: int, J: FloatArray) -> None:
    """Columns of the block at row `row` of the whole leading rows: P J^T; zero behind the rows of J."""
    for i in range(plan.measured):
        for c in range(len(J)):
            total = 0.0
            for k in range(plan.measured):
                total += s.lead[i, k] * J[c, k]
            s.lead[i, row + c] = total
        for c in range(len(J), plan.size):
            s.lead[i, row + c] = 0.0


@kernel
def _write_rows(plan: Plan, P: FloatArray, n: int, row: int, J: FloatArray, s: Scratch) -> None:
    """Rows of the block at row `row` of P: J times the leading rows, whole; zero behind the rows of J."""
    block = s.block
    for top in range(0, len(J), 3):
        multiply_panel(block[top:], 0, J[top:], min(3, len(J) - top), s.lead, 0, 0, plan.measured, n)
    for c in range(len(J), plan.size):
        for j in range(n):
            block[c, j] = 0.0
    for j in range(row):
        for c in range(plan.size):
            P[j, row + c] = block[c, j]
    for c in range(plan.size):
        for j in range(row + c, n):
            P[row + c, j] = block[c, j]


@kernel
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
            all_ids[target], own[target] = all_ids[i], own[i]
            anchor[target] = anchor[i]
            i -= 1
        else:
            all_ids[target], own[target] = new, s.entered[j]
            anchor[target] = s.land[j]
            j -= 1
        target -= 1
    counts[LANDMARKS] += count


@unit("augment")
def augment(plan: Plan, S: Storage, b: int, s: Scratch, frame: FrameArrays, first: int, count: int) -> None:
    """Add the `count` landmarks that have started to the map and to P: rows G_x P, and G_x P G_x^T + G_z R G_z^T."""
    P, x, blocks, users, counts = S.P[b], S.x[b], S.blocks[b], S.users[b], S.counts[b]
    measured, leading = plan.measured, plan.leading
    taken, made_blocks = s.entered, s.made  # parameter block of each, all anchor blocks
    gap, anchors = 0, 0
    for i in range(count):
        s.land[i] = -1
        if plan.anchors > 0:
            if i > 0 and plan.shares_anchors:
                s.land[i] = made_blocks[0]
            else:
                while gap < counts[BLOCKS] and users[gap] > 0:
                    gap += 1
                if gap == counts[BLOCKS]:
                    counts[BLOCKS] += 1
                users[gap], made_blocks[anchors], s.land[i], S.kind[b, gap] = 0, gap, gap, POINT
                anchors += 1
                gap += 1
            users[s.land[i]] += 1
    for i in range(count):
        while gap < counts[BLOCKS] and users[gap] > 0:
            gap += 1
        if gap == counts[BLOCKS]:
            counts[BLOCKS] += 1
        users[gap], taken[i] = 1, gap
        S.kind[b, gap] = POINT if plan.points else OWN
    n = leading + plan.size * counts[BLOCKS]
    take_leading(P, n, measured, s.lead)
    for i in range(anchors):
        for a in range(blocks.shape[1]):
            blocks[made_blocks[i], a] = S.first[b, made_blocks[i], a] = x[a] if a < 3 else 0.0
        _add_block(plan, s, leading + plan.size * made_blocks[i], s.by_anchor)
    for i in range(count):
        for a in range(s.values.shape[1]):
            blocks[taken[i], a] = S.first[b, taken[i], a] = s.values[i, a]
        _add_block(plan, s, leading + plan.size * taken[i], s.H[i, : plan.size])
    for i in range(anchors):
        _write_rows(plan, P, n, leading + plan.size * made_blocks[i], s.by_anchor, s)
    for i in range(count):
        row = leading + plan.size * taken[i]
        _write_rows(plan, P, n, row, s.H[i, : plan.size], s)
        for a in range(plan.size):
            for c in range(a, plan.size):
                P[row + a, row + c] += s.values_noise[i, a, c]
    _merge(S.ids[b], S.own[b], S.anchor[b], counts, s, frame.ids, first, count)


@kernel
def clone_pose(plan: Plan, S: Storage, b: int, s: Scratch) -> None:
    """Keep the present pose as two held blocks; there is room for them."""
    P, x, counts, held = S.P[b], S.x[b], S.counts[b], S.held[b]
    places, gap, end = s.entered, 0, 0
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
    n, J = plan.leading + plan.size * counts[BLOCKS], s.F[:3]
    take_leading(P, n, plan.measured, s.lead)
    for step in range(2):
        for k in range(2):
            row = plan.leading + plan.size * places[k]
            for a in range(3):
                for c in range(plan.measured):
                    J[a, c] = 1.0 if c == 3 * k + a else 0.0
            if step == 0:
                _add_block(plan, s, row, J)
            else:
                _write_rows(plan, P, n, row, J, s)
