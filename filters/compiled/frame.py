"""Kernels of a whole frame, for one filter and for a range of filters: `StereoEKF.predict` and `update`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from filters.compiled import prediction
from filters.compiled.covariance import add_block, move_block
from filters.compiled.geometry import (
    CALIBRATION,
    CALIBRATIONS,
    CX,
    CY,
    ENTRY,
    FB,
    FX,
    FY,
    MIN_DISPARITY,
    OPTIONS,
    ORIENTATION,
    POSITION,
    PREDICTED,
    TAIL_DOF,
    angles_jacobian,
    copy,
    copy_matrix,
    exponential,
    misaligned,
    multiply,
    right_jacobian,
    rotation,
    skew,
)
from filters.compiled.retraction import FIRST_ESTIMATES, pull_back, retract, transport
from filters.compiled.update import correct, largest_agreement, linearise, predict_points, squared_distances
from filters.validation import BoolArray, FloatArray, IntArray

USED, BEHIND, GATED, FAILED, STARTED, REJECTED = range(6)
"""Outcome of a measurement; the first four as in `engine.gating`."""
INVERSE_DEPTH, SHARED_ANCHOR, EUCLIDEAN = range(3)
LANDMARK, ERROR, CONSENSUS, ITERATIONS, DROP_UNSEEN, LEAD, MEASURED, VELOCITY, STAGES, MOTION = range(10)
"""Choices of a recipe; MEASURED is a multiple of three."""
ID, OWN, ANCHOR = range(3)
"""Columns of the table of landmarks."""
_FARTHEST = 1e6
_VERTICAL = 1e-6


@njit(**OPTIONS)
def _retract(
    choices: IntArray,
    columns: IntArray,
    P: FloatArray,
    n: int,
    values: FloatArray,
    blocks: FloatArray,
    landmarks: IntArray,
    count: int,
    delta: FloatArray,
) -> None:
    """`StereoEKF._retract`: values, blocks and P in place."""
    lead = choices[LEAD]
    new_values, new_blocks = np.empty_like(values), np.empty_like(blocks)
    leading, own, by_rotation = np.empty((lead, lead)), np.empty((len(blocks), 3, 3)), np.empty((3, n))
    retract(
        choices[ERROR],
        lead,
        choices[VELOCITY],
        columns,
        values,
        blocks,
        landmarks,
        count,
        delta,
        new_values,
        new_blocks,
        leading,
        own,
        by_rotation,
    )
    transport(P, n, choices[ERROR], lead, leading, own, by_rotation)
    copy(new_values, values)
    copy_matrix(new_blocks, blocks)


@njit(**OPTIONS)
def _linearise(
    choices: IntArray,
    numbers: FloatArray,
    columns: IntArray,
    values: FloatArray,
    blocks: FloatArray,
    first_blocks: FloatArray,
    landmarks: IntArray,
    index: IntArray,
    T: FloatArray,
    z: FloatArray,
    innovation: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
) -> None:
    """`StereoEKF._linearise`: at the state, or at the first estimates."""
    size = innovation.shape[1]
    if choices[ERROR] != FIRST_ESTIMATES:
        linearise(
            numbers,
            columns,
            choices[LEAD],
            values,
            blocks,
            landmarks,
            index,
            T,
            innovation,
            by_leading,
            by_map,
            map_rows,
        )
    else:
        at = np.empty_like(first_blocks)
        copy_matrix(first_blocks, at)
        if choices[LANDMARK] != EUCLIDEAN:
            for i in range(len(index)):
                own = landmarks[index[i], OWN]
                at[own, 2] = blocks[own, 2]
        linearise(
            numbers,
            columns,
            choices[LEAD],
            values[PREDICTED:],
            at,
            landmarks,
            index,
            T,
            innovation,
            by_leading,
            by_map,
            map_rows,
        )
        uvd, ahead = np.empty((len(index), 3)), np.empty(len(index), np.bool_)
        predict_points(numbers, values, blocks, landmarks, index, uvd, ahead)
        for m in range(len(index)):
            for a in range(size):
                innovation[m, a] = T[a, 0] * uvd[m, 0] + T[a, 1] * uvd[m, 1] + T[a, 2] * uvd[m, 2]
    for m in range(len(index)):
        for a in range(size):
            innovation[m, a] = z[m, a] - innovation[m, a]


@njit(**OPTIONS)
def _select(
    chosen: BoolArray,
    index: IntArray,
    place: IntArray,
    z: FloatArray,
    innovation: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
) -> int:
    """Move the chosen measurements to the front, in place; their number."""
    kept = 0
    for m in range(len(chosen)):
        if chosen[m]:
            if kept < m:
                index[kept], place[kept] = index[m], place[m]
                copy(z[m], z[kept])
                copy(innovation[m], innovation[kept])
                copy(map_rows[m], map_rows[kept])
                copy_matrix(R[m], R[kept])
                copy_matrix(by_leading[m], by_leading[kept])
                copy_matrix(by_map[m], by_map[kept])
            kept += 1
    return kept


@njit(**OPTIONS)
def _apply(
    routines: tuple[int, ...],
    choices: IntArray,
    numbers: FloatArray,
    columns: IntArray,
    considered: IntArray,
    P: FloatArray,
    n: int,
    values: FloatArray,
    blocks: FloatArray,
    first_blocks: FloatArray,
    landmarks: IntArray,
    count: int,
    index: IntArray,
    T: FloatArray,
    z: FloatArray,
    innovation: FloatArray,
    by_leading: FloatArray,
    by_map: FloatArray,
    map_rows: IntArray,
    R: FloatArray,
    used: BoolArray,
) -> float:
    """`StereoEKF._apply`: one pass of the update, or Gauss-Newton passes with the prior held; the NIS."""
    measured, size = innovation.shape
    if measured == 0:
        return 0.0
    delta, lead = np.empty(n), choices[LEAD]
    if numbers[TAIL_DOF] < math.inf:
        distances = np.empty(measured)
        squared_distances(P, innovation, by_leading, by_map, map_rows, R, distances)
        for m in range(measured):
            weight = min(1.0, (numbers[TAIL_DOF] + size) / (numbers[TAIL_DOF] + distances[m]))
            for a in range(size):
                for b in range(size):
                    R[m, a, b] /= weight
    for _ in range(choices[ITERATIONS] - 1):
        trial = np.empty((n, P.shape[1]))
        copy_matrix(P, trial)
        correct(routines, trial, n, considered, innovation, by_leading, by_map, map_rows, R, delta, used)
        new_values, new_blocks = np.empty_like(values), np.empty_like(blocks)
        leading, own, by_rotation = np.empty((lead, lead)), np.empty((len(blocks), 3, 3)), np.empty((3, n))
        retract(
            choices[ERROR],
            lead,
            choices[VELOCITY],
            columns,
            values,
            blocks,
            landmarks,
            count,
            delta,
            new_values,
            new_blocks,
            leading,
            own,
            by_rotation,
        )
        _linearise(
            choices,
            numbers,
            columns,
            new_values,
            new_blocks,
            first_blocks,
            landmarks,
            index,
            T,
            z,
            innovation,
            by_leading,
            by_map,
            map_rows,
        )
        pull_back(choices[ERROR], lead, leading, own, by_rotation, delta, innovation, by_leading, by_map, map_rows)
    nis = correct(routines, P, n, considered, innovation, by_leading, by_map, map_rows, R, delta, used)
    _retract(choices, columns, P, n, values, blocks, landmarks, count, delta)
    return nis


@njit(**OPTIONS)
def _stage(
    routines: tuple[int, ...],
    choices: IntArray,
    numbers: FloatArray,
    columns: IntArray,
    considered: IntArray,
    P: FloatArray,
    n: int,
    values: FloatArray,
    blocks: FloatArray,
    first_blocks: FloatArray,
    landmarks: IntArray,
    count: int,
    known: IntArray,
    T: FloatArray,
    all_z: FloatArray,
    all_R: FloatArray,
    limit: float,
    fates: IntArray,
    result: FloatArray,
) -> None:
    """`StereoEKF._correct_stage`: result (2,) gains the NIS and its degrees of freedom.

    known (M,) is the landmark of each measurement, -1 where it is new.
    """
    size = len(T)
    most, width = 0, 3 if choices[LANDMARK] == EUCLIDEAN else 6
    index, place = np.empty(len(known), np.int64), np.empty(len(known), np.int64)
    for i in range(len(known)):
        if known[i] >= 0 and fates[i] == USED:
            index[most], place[most] = known[i], i
            most += 1
    uvd, ahead = np.empty((most, 3)), np.empty(most, np.bool_)
    predict_points(numbers, values, blocks, landmarks, index[:most], uvd, ahead)
    measured = 0
    for m in range(most):
        if ahead[m]:
            index[measured], place[measured] = index[m], place[m]
            fates[place[m]] = GATED
            measured += 1
        else:
            fates[place[m]] = BEHIND
    z, R = np.empty((measured, size)), np.empty((measured, size, size))
    innovation, map_rows = np.empty((measured, size)), np.empty((measured, width // 3), np.int64)
    by_leading, by_map = np.empty((measured, size, choices[MEASURED])), np.empty((measured, size, width))
    used, chosen, distances = np.empty(measured, np.bool_), np.empty(measured, np.bool_), np.empty(measured)
    passes = 2 if choices[CONSENSUS] else 1
    for turn in range(passes):
        for m in range(measured):
            copy(all_z[place[m]], z[m])
            copy_matrix(all_R[place[m]], R[m])
        _linearise(
            choices,
            numbers,
            columns,
            values,
            blocks,
            first_blocks,
            landmarks,
            index[:measured],
            T,
            z[:measured],
            innovation[:measured],
            by_leading[:measured],
            by_map[:measured],
            map_rows[:measured],
        )
        kept = measured
        rest_index, rest_place, rest = index[:0], place[:0], 0
        if limit < math.inf:
            squared_distances(
                P,
                innovation[:measured],
                by_leading[:measured],
                by_map[:measured],
                map_rows[:measured],
                R[:measured],
                distances[:measured],
            )
            for m in range(measured):
                chosen[m] = distances[m] <= limit
            if passes == 2 and turn == 0:
                rest_index, rest_place = index[:measured].copy(), place[:measured].copy()
                rest = measured
            kept = _select(chosen[:measured], index, place, z, innovation, by_leading, by_map, map_rows, R)
            if passes == 2 and turn == 0:
                largest_agreement(
                    P,
                    n,
                    innovation[:kept],
                    by_leading[:kept],
                    by_map[:kept],
                    map_rows[:kept],
                    R[:kept],
                    limit,
                    chosen[:kept],
                )
                kept = _select(chosen[:kept], index, place, z, innovation, by_leading, by_map, map_rows, R)
        result[0] += _apply(
            routines,
            choices,
            numbers,
            columns,
            considered,
            P,
            n,
            values,
            blocks,
            first_blocks,
            landmarks,
            count,
            index[:kept],
            T,
            z[:kept],
            innovation[:kept],
            by_leading[:kept],
            by_map[:kept],
            map_rows[:kept],
            R[:kept],
            used[:kept],
        )
        for m in range(kept):
            fates[place[m]] = USED if used[m] else FAILED
            if used[m]:
                result[1] += size
        if passes == 2 and turn == 0:
            # what is not in the core, which is in ascending order, is tried again at the corrected state
            measured, core, taken = 0, 0, place[:kept].copy()
            for m in range(rest):
                if core < kept and rest_place[m] == taken[core]:
                    core += 1
                else:
                    index[measured], place[measured] = rest_index[m], rest_place[m]
                    measured += 1


@njit(**OPTIONS)
def _remove(
    P: FloatArray,
    lead: int,
    blocks: FloatArray,
    first_blocks: FloatArray,
    landmarks: IntArray,
    users: IntArray,
    counts: IntArray,
    gone: BoolArray,
    dropped: IntArray,
) -> int:
    """Take landmarks out of the table; blocks without users stay as holes. The number of `dropped` ids."""
    kept, out = 0, 0
    for k in range(counts[0]):
        if gone[k]:
            dropped[out] = landmarks[k, ID]
            out += 1
            users[landmarks[k, OWN]] -= 1
            if landmarks[k, ANCHOR] >= 0:
                users[landmarks[k, ANCHOR]] -= 1
        else:
            if kept < k:
                for c in range(3):
                    landmarks[kept, c] = landmarks[k, c]
            kept += 1
    counts[0] = kept
    return out


@njit(**OPTIONS)
def _close_holes(
    P: FloatArray,
    lead: int,
    blocks: FloatArray,
    first_blocks: FloatArray,
    landmarks: IntArray,
    users: IntArray,
    counts: IntArray,
    held: IntArray,
) -> None:
    """Move the last blocks into the holes, so that all rows below are in use."""
    hole = 0
    rows = np.empty((3, lead + 3 * counts[1]))
    while True:
        while counts[1] > 0 and users[counts[1] - 1] == 0:
            counts[1] -= 1
        while hole < counts[1] and users[hole] > 0:
            hole += 1
        if hole >= counts[1]:
            return
        last = counts[1] - 1
        move_block(P, lead + 3 * last, lead + 3 * hole, lead + 3 * counts[1], rows)
        copy(blocks[last], blocks[hole])
        copy(first_blocks[last], first_blocks[hole])
        users[hole], users[last] = users[last], 0
        for k in range(counts[0]):
            for c in range(OWN, ANCHOR + 1):
                if landmarks[k, c] == last:
                    landmarks[k, c] = hole
        for k in range(len(held)):
            if held[k] == last:
                held[k] = hole


@njit(**OPTIONS)
def _take_block(users: IntArray, counts: IntArray, hole: int) -> int:
    """The first hole from `hole` on, or a block at the end."""
    while hole < counts[1] and users[hole] > 0:
        hole += 1
    if hole == counts[1]:
        counts[1] += 1
        users[hole] = 0
    return hole


@njit(**OPTIONS)
def _constrained(J: FloatArray, effect: FloatArray, source: FloatArray, R: FloatArray, defect: FloatArray) -> None:
    """`FirstEstimates.constrained` of the Jacobian (3, c) of one block, in place."""
    for i in range(3):
        for j in range(3):
            defect[i, j] = effect[i, j]
            for k in range(6):
                defect[i, j] -= J[i, k] * source[k, j]
    for i in range(3):
        for j in range(3):
            J[i, 3 + j] += defect[i, 0] * R[0, j] + defect[i, 1] * R[1, j] + defect[i, 2] * R[2, j]


@njit(**OPTIONS)
def _start(
    choices: IntArray,
    numbers: FloatArray,
    columns: IntArray,
    P: FloatArray,
    values: FloatArray,
    blocks: FloatArray,
    first_blocks: FloatArray,
    landmarks: IntArray,
    users: IntArray,
    counts: IntArray,
    ids: IntArray,
    uvd: FloatArray,
    R: FloatArray,
    known: IntArray,
    fates: IntArray,
) -> None:
    """`MapPolicy.start`: landmarks at new measurements (Eq. 19-25)."""
    lead, measured, euclidean = choices[LEAD], choices[MEASURED], choices[LANDMARK] == EUCLIDEAN
    calibration = values[CALIBRATION : CALIBRATION + CALIBRATIONS]
    focal, scale = 1.0 + calibration[1], 1.0 + calibration[2]
    R_wc, X, R_ws, A = np.empty((3, 3)), np.eye(3), np.empty((3, 3)), np.empty((3, 3))
    J_left, R_predicted = np.eye(3), np.empty((3, 3))
    rotation(values[ORIENTATION:], R_wc)
    tilted = misaligned(calibration)
    if tilted:
        exponential(calibration[3:6], X)
        right_jacobian(calibration[3:6], -1.0, J_left)
    multiply(R_wc, X.T.copy(), R_ws)  # from the sensor, which is turned by X against the body
    constrains = choices[ERROR] == FIRST_ESTIMATES
    source, effect, defect = np.zeros((6, 3)), np.empty((3, 3)), np.empty((3, 3))
    if constrains:
        rotation(values[PREDICTED + ORIENTATION :], R_predicted)
        skew(values[PREDICTED + POSITION :], -1.0, source[:3])
        source[3:6] = R_predicted.T
    most = 0
    for i in range(len(ids)):
        most += known[i] < 0
    rows = np.empty((3, lead + 3 * (counts[1] + 2 * most)))
    J, noise, by_uvd = np.empty((3, measured)), np.empty((3, 3)), np.empty((3, 3))
    by_w, by_c, angles = np.empty((3, 3)), np.empty((3, 3)), np.empty((2, 3))
    h, h_b, h_w, by_s = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    anchor, hole, old = -1, 0, counts[0]
    for i in range(len(ids)):
        if known[i] >= 0:
            continue
        fates[i] = REJECTED
        if not (abs(uvd[i, 0]) < _FARTHEST and abs(uvd[i, 1]) < _FARTHEST and abs(uvd[i, 2]) < _FARTHEST):
            continue
        if uvd[i, 2] < numbers[MIN_DISPARITY]:
            continue
        u0, v0 = (uvd[i, 0] - numbers[CX]) / focal, (uvd[i, 1] - numbers[CY]) / focal
        d0 = (uvd[i, 2] - calibration[0]) / (focal * scale)
        h[0], h[1], h[2], s = u0 / numbers[FX], v0 / numbers[FY], 1.0, d0 / numbers[FB]
        for j in range(3):
            h_b[j] = X[0, j] * h[0] + X[1, j] * h[1] + X[2, j] * h[2]
        for j in range(3):
            h_w[j] = R_wc[j, 0] * h_b[0] + R_wc[j, 1] * h_b[1] + R_wc[j, 2] * h_b[2]
        square = h_w[0] ** 2 + h_w[1] ** 2 + h_w[2] ** 2
        if euclidean:
            if not s > 0.0:
                continue
        elif not h_w[0] ** 2 + h_w[2] ** 2 > _VERTICAL**2 * h_w[1] ** 2:
            continue
        fates[i] = STARTED
        if not euclidean and (anchor < 0 or choices[LANDMARK] == INVERSE_DEPTH):
            anchor = _take_block(users, counts, hole)
            hole = anchor + 1
            J[:] = 0.0
            J[0, 0] = J[1, 1] = J[2, 2] = 1.0
            noise[:] = 0.0
            if constrains:
                skew(values[POSITION:], -1.0, effect)
                _constrained(J, effect, source, R_predicted, defect)
            add_block(P, lead + 3 * anchor, lead + 3 * counts[1], J, noise, measured, rows)
            for j in range(3):
                blocks[anchor, j] = first_blocks[anchor, j] = values[POSITION + j]
        own = _take_block(users, counts, hole)
        hole = own + 1
        users[own] = 1
        J[:] = 0.0
        by_w[:] = 0.0
        if euclidean:
            for j in range(3):
                blocks[own, j] = values[POSITION + j] + h_w[j] / s
                J[j, j] = 1.0
                by_w[j, j] = 1.0 / s
                by_s[j] = -h_w[j] / s**2
        else:
            length = math.sqrt(square)
            blocks[own, 0] = math.atan2(h_w[0], h_w[2])
            blocks[own, 1] = math.atan2(-h_w[1], math.hypot(h_w[0], h_w[2]))
            blocks[own, 2] = s / length
            angles_jacobian(h_w[0], h_w[1], h_w[2], angles)
            for j in range(3):
                by_w[0, j], by_w[1, j] = angles[0, j], angles[1, j]
                by_w[2, j] = -blocks[own, 2] / square * h_w[j]
            by_s[0], by_s[1], by_s[2] = 0.0, 0.0, 1.0 / length
            users[anchor] += 1
        for j in range(3):
            first_blocks[own, j] = blocks[own, j]
        multiply(by_w, R_wc, by_c)
        for a in range(3):
            # -g^T [h]x = (h x g)^T
            J[a, 3] = h_b[1] * by_c[a, 2] - h_b[2] * by_c[a, 1]
            J[a, 4] = h_b[2] * by_c[a, 0] - h_b[0] * by_c[a, 2]
            J[a, 5] = h_b[0] * by_c[a, 1] - h_b[1] * by_c[a, 0]
        multiply(by_w, R_ws, A)  # by the ray of the sensor
        for a in range(3):
            by_uvd[a, 0] = A[a, 0] / (focal * numbers[FX])
            by_uvd[a, 1] = A[a, 1] / (focal * numbers[FY])
            by_uvd[a, 2] = by_s[a] / (focal * scale * numbers[FB])
            if columns[0] >= 0:
                J[a, columns[0]] = -by_uvd[a, 2]
            if columns[1] >= 0:
                J[a, columns[1]] = -(A[a, 0] * h[0] + A[a, 1] * h[1] + by_s[a] * s) / focal
            if columns[2] >= 0:
                J[a, columns[2]] = -by_s[a] * s / scale
            # h_b = Exp(-X) h: d h_b / dX = [h_b]x J_r(-X)... = Exp(-X) [h]x J_l(X)
            t0 = h[2] * A[a, 1] - h[1] * A[a, 2]
            t1 = h[0] * A[a, 2] - h[2] * A[a, 0]
            t2 = h[1] * A[a, 0] - h[0] * A[a, 1]
            for j in range(3):
                if columns[3 + j] >= 0:
                    J[a, columns[3 + j]] = t0 * J_left[0, j] + t1 * J_left[1, j] + t2 * J_left[2, j]
        noise_of = R[i] if len(R) > 1 else R[0]
        for a in range(3):
            for b in range(3):
                noise[a, b] = 0.0
                for c in range(3):
                    for e in range(3):
                        noise[a, b] += by_uvd[a, c] * noise_of[c, e] * by_uvd[b, e]
        if constrains:
            effect[:] = 0.0
            if euclidean:
                skew(blocks[own], -1.0, effect)
            else:
                length = math.sqrt(square)
                m0, m1, m2 = h_w[0] / length, h_w[1] / length, h_w[2] / length
                for a in range(2):
                    # d angles / d m is of the unit ray
                    g0, g1, g2 = angles[a, 0] * length, angles[a, 1] * length, angles[a, 2] * length
                    effect[a, 0], effect[a, 1], effect[a, 2] = m1 * g2 - m2 * g1, m2 * g0 - m0 * g2, m0 * g1 - m1 * g0
            _constrained(J, effect, source, R_predicted, defect)
        add_block(P, lead + 3 * own, lead + 3 * counts[1], J, noise, measured, rows)
        landmarks[counts[0], ID], landmarks[counts[0], OWN] = ids[i], own
        landmarks[counts[0], ANCHOR] = -1 if euclidean else anchor
        counts[0] += 1
    # both parts are in ascending order of ids: insert the new ones
    if old > 0 and old < counts[0]:
        new = landmarks[old : counts[0]].copy()
        k, target = old - 1, counts[0] - 1
        for i in range(len(new) - 1, -1, -1):
            while k >= 0 and landmarks[k, ID] > new[i, ID]:
                copy(landmarks[k], landmarks[target])
                k -= 1
                target -= 1
            copy(new[i], landmarks[target])
            target -= 1


@njit(**ENTRY)
def predict_range(
    routines: tuple[int, ...],
    choices: IntArray,
    numbers: FloatArray,
    columns: IntArray,
    considered: IntArray,
    walk_rates: FloatArray,
    P: FloatArray,
    values: FloatArray,
    blocks: FloatArray,
    landmarks: IntArray,
    counts: IntArray,
    first: int,
    last: int,
    dt: FloatArray,
    odometry: FloatArray,
    covariances: FloatArray,
    has_odometry: BoolArray,
    active: BoolArray,
) -> None:
    """Predict the filters first to last - 1; dt, odometry and what belongs to it are those of these filters.

    Those that are not `active` are left as they are.
    """
    lead, velocity = choices[LEAD], choices[VELOCITY]
    innovation, H = np.empty((1, 6)), np.empty((1, 6, lead))
    no_map, no_rows = np.empty((1, 6, 0)), np.empty((1, 0), np.int64)
    used = np.empty(1, np.bool_)
    for b in range(first, last):
        i, n = b - first, lead + 3 * counts[b, 1]
        if not active[i]:
            continue
        prediction.predict(
            P[b],
            n,
            values[b],
            choices[MOTION],
            choices[ERROR],
            lead,
            velocity,
            numbers,
            walk_rates,
            dt[i],
            odometry[i],
            covariances[i],
        )
        if has_odometry[i] and choices[MOTION] == prediction.CONSTANT_VELOCITY:
            delta = np.empty(n)
            prediction.measure_odometry(values[b], velocity, dt[i], odometry[i], innovation, H)
            correct(routines, P[b], n, considered, innovation, H, no_map, no_rows, covariances[i : i + 1], delta, used)
            _retract(choices, columns, P[b], n, values[b], blocks[b, : counts[b, 1]], landmarks[b], counts[b, 0], delta)


@njit(**ENTRY)
def update_range(
    routines: tuple[int, ...],
    choices: IntArray,
    numbers: FloatArray,
    columns: IntArray,
    considered: IntArray,
    stages: FloatArray,
    rows_of_stages: IntArray,
    limits: FloatArray,
    copied: FloatArray,
    P: FloatArray,
    values: FloatArray,
    blocks: FloatArray,
    first_blocks: FloatArray,
    landmarks: IntArray,
    users: IntArray,
    counts: IntArray,
    held: IntArray,
    first: int,
    last: int,
    offsets: IntArray,
    ids: IntArray,
    uvd: FloatArray,
    R: FloatArray,
    v_right: FloatArray,
    fates: IntArray,
    results: FloatArray,
    dropped: IntArray,
    dropped_counts: IntArray,
    active: BoolArray,
) -> None:
    """Update the filters first to last - 1; the i-th of them with the measurements offsets[i] to offsets[i + 1] - 1.

    ids are ascending in each filter.
    rows_of_stages (S, 2) has the number of rows of each stage and the row of v_right, -1 where there is none; copied
    is the factor of its variance where it is not measured, NaN where it is left out then. v_right is NaN where it is
    not measured. results (b, 2) are NIS and degrees of freedom. Filters that are not `active` are left as they are.
    """
    lead = choices[LEAD]
    for b in range(first, last):
        which = b - first
        low, high = offsets[which], offsets[which + 1]
        results[which, 0] = results[which, 1] = 0.0
        dropped_counts[which] = 0
        if not active[which]:
            continue
        count = high - low
        known = np.empty(count, np.int64)
        fate = fates[low:high]
        k = 0
        any_known = False
        for i in range(count):
            while k < counts[b, 0] and landmarks[b, k, ID] < ids[low + i]:
                k += 1
            known[i] = k if k < counts[b, 0] and landmarks[b, k, ID] == ids[low + i] else -1
            any_known = any_known or known[i] >= 0
            fate[i] = USED
        n = lead + 3 * counts[b, 1]
        if any_known:
            has_right = len(v_right) > 0 and not math.isnan(v_right[low])
            for s in range(choices[STAGES]):
                size, right = rows_of_stages[s]
                limit = limits[s, size - 1]
                if right >= 0 and not has_right and math.isnan(copied[0]):
                    size -= 1
                    limit = limits[s, size - 1]
                    right = -1
                T = stages[s, :size]
                z, noise = np.empty((count, size)), np.empty((count, size, size))
                for i in range(count):
                    noise_of = R[low + i] if len(R) > 1 else R[0]
                    for a in range(size):
                        z[i, a] = T[a, 0] * uvd[low + i, 0] + T[a, 1] * uvd[low + i, 1] + T[a, 2] * uvd[low + i, 2]
                        for c in range(size):
                            value = 0.0
                            for e in range(3):
                                for f in range(3):
                                    value += T[a, e] * noise_of[e, f] * T[c, f]
                            noise[i, a, c] = value
                    if right >= 0:
                        if has_right:
                            z[i, right] = v_right[low + i]
                        else:
                            noise[i, right, right] *= copied[0]
                        if size == 4 or not has_right:
                            for a in range(size):
                                if a != right:
                                    noise[i, a, right] = noise[i, right, a] = 0.0
                _stage(
                    routines,
                    choices,
                    numbers,
                    columns,
                    considered,
                    P[b],
                    n,
                    values[b],
                    blocks[b, : counts[b, 1]],
                    first_blocks[b, : counts[b, 1]],
                    landmarks[b],
                    counts[b, 0],
                    known,
                    T,
                    z,
                    noise,
                    limit,
                    fate,
                    results[which],
                )
        if choices[DROP_UNSEEN]:
            gone = np.ones(counts[b, 0], np.bool_)
            for i in range(count):
                if known[i] >= 0:
                    gone[known[i]] = False
            dropped_counts[which] = _remove(
                P[b], lead, blocks[b], first_blocks[b], landmarks[b], users[b], counts[b], gone, dropped[which]
            )
        _start(
            choices,
            numbers,
            columns,
            P[b],
            values[b],
            blocks[b],
            first_blocks[b],
            landmarks[b],
            users[b],
            counts[b],
            ids[low:high],
            uvd[low:high],
            R[low:high] if len(R) > 1 else R[:1],
            known,
            fate,
        )
        _close_holes(P[b], lead, blocks[b], first_blocks[b], landmarks[b], users[b], counts[b], held[b])
