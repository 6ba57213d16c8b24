"""Kernels for the gate, which `frame` applies: squared distances, joint compatibility, and heavy-tailed noise."""

from __future__ import annotations

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.blas import kernel, multiply_panel
from filters.kernels.calls import unit
from filters.kernels.correction import take_columns, take_leading_columns, times_covariance
from filters.kernels.process_noise import step_covariance
from filters.kernels.recipe import Plan
from filters.kernels.records import Scratch


@kernel
def solve(S: FloatArray, x: FloatArray, size: int) -> float:
    """x^T S^-1 x by S = L D L^T of the lower triangle, which becomes the factors; x becomes L^-1 x."""
    total = 0.0
    for a in range(size):
        for b in range(a):
            ratio = S[a, b] / S[b, b]
            x[a] -= ratio * x[b]
            for c in range(a, size):
                S[c, a] -= S[c, b] * ratio
        total += x[a] ** 2 / S[a, a]
    return total


@unit("distances")
def squared_distances(plan: Plan, P: FloatArray, s: Scratch, select: IntArray, count: int, size: int) -> None:
    """nu^T S^-1 nu of each selected measurement on its own, in the scratch."""
    measured = plan.measured
    own = measured + 3 * plan.anchors
    total = own + plan.size
    rows, C, HP, S, x = s.gate_rows, s.gate_P, s.gate_HP, s.small[0], s.small[1, 0]
    for i in range(measured):
        rows[i] = i
        for j in range(i, measured):
            C[i, j] = C[j, i] = P[i, j]
    for i in range(count):
        m = select[i]
        for c in range(3 * plan.anchors):
            rows[measured + c] = s.base[m, 0] + c
        for c in range(3):
            rows[own + c] = s.base[m, 1] + c
        for c in range(3, plan.size):
            rows[own + c] = s.base[m, 1] + c
        for p in range(measured, total):
            row = rows[p]
            for q in range(measured):
                C[q, p] = C[p, q] = P[q, row]
            for q in range(measured, p + 1):
                other = rows[q]
                C[q, p] = C[p, q] = P[min(row, other), max(row, other)]
        multiply_panel(HP, 0, s.H[m], size, C, 0, 0, total, total)
        for a in range(size):
            x[a] = s.nu[m, a]
            for b in range(a + 1):
                value = s.R[m, a, b]
                for p in range(total):
                    value += HP[a, p] * s.H[m, b, p]
                S[a, b] = value
        s.mahalanobis2[m] = solve(S, x, size)


@kernel
def reweight(plan: Plan, s: Scratch, select: IntArray, count: int, size: int) -> None:
    """R divided by the weights of Student's t, (dof + k) / (dof + d^2) up to 1, from the distances in the scratch.

    With heavy-tailed noise that is the expected precision of a measurement given its innovation.
    """
    for i in range(count):
        m = select[i]
        weight = min((plan.tail_dof + size) / (plan.tail_dof + s.mahalanobis2[m]), 1.0)
        for a in range(size):
            for b in range(size):
                s.R[m, a, b] /= weight
                if len(plan.sigma_points) > 0:
                    s.added[m, a, b] /= weight


@kernel
def _invert(S: FloatArray, inverse: FloatArray, factors: FloatArray, size: int) -> None:
    """Inverse of a symmetric positive definite matrix, column by column."""
    for column in range(size):
        for a in range(size):
            inverse[column, a] = 1.0 if a == column else 0.0
            for b in range(size):
                factors[a, b] = S[a, b]
        _solve_whole(factors, inverse[column], size)


@kernel
def _solve_whole(S: FloatArray, x: FloatArray, size: int) -> None:
    """x <- S^-1 x with a symmetric positive definite S, whose lower triangle becomes its factors."""
    solve(S, x, size)
    for a in range(size - 1, -1, -1):
        x[a] /= S[a, a]
        for b in range(a + 1, size):
            x[a] -= S[b, a] / S[a, a] * x[b]


@unit("agree")
def largest_agreement(
    plan: Plan,
    P: FloatArray,
    n: int,
    s: Scratch,
    select: IntArray,
    count: int,
    size: int,
    limit: float,
    T: FloatArray,
    stage: int,
) -> None:
    """One-point RANSAC with all hypotheses at once: the place of the best in `result`, its followers in `support`.

    A single landmark is enough to fix the camera, because the prior knows the rest. So each believable measurement
    proposes a correction, and the proposal that explains most of the others, up to their noise and the steps of their
    landmarks, wins; of equals, the one with the smallest residuals. A measurement that agrees with the prediction only
    because the prediction is vague does not pass. Row j, column i of `support`: whether j agrees with hypothesis i.

    Source: Civera, Grasa, Davison and Montiel, "1-point RANSAC for extended Kalman filtering", J. Field Robotics 27(5),
    2010.
    """
    if count < 2:
        for i in range(count):
            s.support[i, i] = True
        s.result[0] = 0.0
        return
    rows, width = count * size, plan.measured + 3 * plan.anchors + plan.size
    times_covariance(plan, P, n, s, select, 0, count, size)
    take_leading_columns(plan, s, rows)
    own, proposal = s.small[1], s.small[2, 0]
    for i in range(count):
        noise = s.R[select[i]]
        if stage == 0 and plan.drift[0].any():
            step_covariance(plan.drift[0], s.noise[select[i]], s.small[0])
            for a in range(size):
                for b in range(size):
                    own[a, b] = noise[a, b]
                    for p in range(3):
                        for q in range(3):
                            own[a, b] += T[a, p] * s.small[0, p, q] * T[b, q]
            noise = own
        _invert(noise, s.inverse_R[select[i]], s.small[0], size)
    best, most, least, held = -1, -1, np.inf, np.int64(-1)
    cross, nu, left = s.S, s.S[size], s.S[size + 1]  # of all measurements with one of them, transposed: H_i P H_j^T
    for j in range(count):
        for a in range(size):
            nu[j * size + a] = s.nu[select[j], a]
    for i in range(count):
        m = select[i]
        held = take_columns(plan, s, m, 0, rows, held)
        multiply_panel(cross, 0, s.H[m], size, s.shared, 0, 0, width, rows)
        for a in range(size):
            proposal[a] = s.nu[m, a]
            for b in range(size):
                cross[a, i * size + b] += s.R[m, a, b]
                own[a, b] = cross[a, i * size + b]
        _solve_whole(own, proposal, size)
        for row in range(rows):
            left[row] = nu[row]
        for b in range(size):
            along, step = cross[b], proposal[b]
            for row in range(rows):
                left[row] -= along[row] * step
        followers, tightness = 0, 0.0
        for j in range(count):
            inverse, distance, first = s.inverse_R[select[j]], 0.0, j * size
            if i != j:
                for a in range(size):
                    for b in range(size):
                        distance += left[first + a] * inverse[a, b] * left[first + b]
            agrees = distance <= limit
            s.support[j, i] = agrees
            if agrees:
                followers += 1
                tightness += distance
        if followers > most or (followers == most and tightness < least):
            best, most, least = i, followers, tightness
    s.result[0] = best
