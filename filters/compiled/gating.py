"""Kernels of the gate, of the joint compatibility of a frame and of heavy-tailed noise."""

from __future__ import annotations

import numpy as np
from numba import njit, types

from filters.compiled.blas import KERNEL
from filters.compiled.correction import times_covariance
from filters.compiled.recipe import Plan
from filters.compiled.storage import Scratch
from filters.compiled.units import INDEX, MATRIX, PLAN, SCRATCH, unit
from filters.validation import FloatArray, IntArray


@njit(**KERNEL)
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


@unit(PLAN, MATRIX, SCRATCH, INDEX, types.int64, types.int64)
def squared_distances(plan: Plan, P: FloatArray, s: Scratch, select: IntArray, count: int, size: int) -> None:
    """`kalman.squared_distances`: nu^T S^-1 nu of each selected measurement on its own, in the scratch."""
    measured = plan.measured
    total = measured + (6 if plan.anchored else 3)
    rows, C, HP, S, x = s.gate_rows, s.gate_P, s.gate_HP, s.small[0], s.small[1, 0]
    for i in range(measured):
        rows[i] = i
        for j in range(i, measured):
            C[i, j] = C[j, i] = P[i, j]
    for i in range(count):
        m = select[i]
        for c in range(3):
            if plan.anchored:
                rows[measured + c] = s.base[m, 0] + c
            rows[total - 3 + c] = s.base[m, 1] + c
        for p in range(measured, total):
            row = rows[p]
            for q in range(measured):
                C[q, p] = C[p, q] = P[q, row]
            for q in range(measured, p + 1):
                other = rows[q]
                C[q, p] = C[p, q] = P[min(row, other), max(row, other)]
        for a in range(size):
            x[a] = s.nu[m, a]
            for p in range(total):
                HP[a, p] = 0.0
            for q in range(total):
                h = s.H[m, a, q]
                for p in range(total):
                    HP[a, p] += h * C[q, p]
            for b in range(a + 1):
                value = s.R[m, a, b]
                for p in range(total):
                    value += HP[a, p] * s.H[m, b, p]
                S[a, b] = value
        s.distances[m] = solve(S, x, size)


@njit(**KERNEL)
def reweight(plan: Plan, s: Scratch, select: IntArray, count: int, size: int) -> None:
    """`heavy_tails.reweighted`: R divided by the weights of Student's t, from the distances in the scratch."""
    for i in range(count):
        m = select[i]
        weight = min((plan.tail_dof + size) / (plan.tail_dof + s.distances[m]), 1.0)
        for a in range(size):
            for b in range(size):
                s.R[m, a, b] /= weight


@njit(**KERNEL)
def _cross(plan: Plan, s: Scratch, H: FloatArray, m: int, j: int, size: int, width: int, cross: FloatArray) -> None:
    """H_j P H_m^T (k, k), j a place in the selection and m a measurement."""
    measured = plan.measured
    for a in range(size):
        row = s.HP[j * size + a]
        for b in range(size):
            total = 0.0
            for c in range(measured):
                total += row[c] * H[b, c]
            c = measured
            if plan.anchored:
                base = s.base[m, 0]
                total += row[base] * H[b, c] + row[base + 1] * H[b, c + 1] + row[base + 2] * H[b, c + 2]
                c += 3
            base = s.base[m, 1]
            total += row[base] * H[b, c] + row[base + 1] * H[b, c + 1] + row[base + 2] * H[b, c + 2]
            cross[a, b] = total


@njit(**KERNEL)
def _solve_whole(S: FloatArray, x: FloatArray, size: int) -> None:
    """x <- S^-1 x with a symmetric positive definite S, whose lower triangle becomes its factors."""
    solve(S, x, size)
    for a in range(size - 1, -1, -1):
        x[a] /= S[a, a]
        for b in range(a + 1, size):
            x[a] -= S[b, a] / S[a, a] * x[b]


@unit(PLAN, MATRIX, types.int64, SCRATCH, INDEX, types.int64, types.int64, types.float64)
def largest_agreement(
    plan: Plan, P: FloatArray, n: int, s: Scratch, select: IntArray, count: int, size: int, limit: float
) -> None:
    """`consensus.largest_agreement`: place in the selection of the best hypothesis, in `result`; its followers in `support`.

    Row j, column i of `support`: whether measurement j agrees with hypothesis i.
    """
    if count < 2:
        for i in range(count):
            s.support[i, i] = True
        s.result[0] = 0.0
        return
    measured = plan.measured
    width = measured + (6 if plan.anchored else 3)
    times_covariance(plan, P, n, s, select, 0, count, size)
    cross, own, x, proposal = s.small[0], s.small[1], s.small[2, 0], s.small[2, 1]
    best, most, least = -1, -1, np.inf
    for i in range(count):
        m = select[i]
        H = s.H[m]
        _cross(plan, s, H, m, i, size, width, own)
        for a in range(size):
            proposal[a] = s.nu[m, a]
            for b in range(size):
                own[a, b] += s.R[m, a, b]
        _solve_whole(own, proposal, size)
        followers, tightness = 0, 0.0
        for j in range(count):
            other = select[j]
            _cross(plan, s, H, m, j, size, width, cross)
            if j == i:
                for a in range(size):
                    for b in range(size):
                        cross[a, b] += s.R[m, a, b]
            for a in range(size):
                x[a] = s.nu[other, a]
                for b in range(size):
                    x[a] -= cross[a, b] * proposal[b]
                    own[a, b] = s.R[other, a, b]
            distance = solve(own, x, size)
            agrees = distance <= limit or i == j
            s.support[j, i] = agrees
            if agrees:
                followers += 1
                tightness += distance
        if followers > most or (followers == most and tightness < least):
            best, most, least = i, followers, tightness
    s.result[0] = best
