"""Kernels of the Kalman update, a chunk of measurements at a time: an exact sequential update; and its iteration.

All chunks have the Jacobians and predictions of one linearisation; what the ones before have explained is taken from
the innovation of the next. With P = P^T in its upper triangle and L L^T = S the update is P -= X^T X, X = L^-1 H P.
The passes of an iterated update before the last one correct the state alone, and linearise the measurements there.
"""

from __future__ import annotations

import math

import numpy as np

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.rotations import right_jacobian_of
from filters.geometry.vectors import put, times, transposed
from filters.kernels.blas import cholesky, kernel, multiply_panel, solve_triangular, subtract_square
from filters.kernels.calls import Calls, call, unit
from filters.kernels.covariance import orientation, take_leading, take_row, take_rows
from filters.kernels.recipe import Plan
from filters.kernels.records import BLOCKS, CHUNK_ROWS, Scratch, Storage
from filters.kernels.retraction import move, put_variables, scales_blocks

DROWNED = 1e12
"""Times R: a landmark as good as in the image plane has an S so large that R is lost in its rounding."""


@kernel
def times_covariance(
    plan: Plan, P: FloatArray, n: int, s: Scratch, select: IntArray, first: int, last: int, size: int
) -> None:
    """H P of the selected measurements first to last - 1, in the first rows of HP."""
    measured, held = plan.measured, -1
    own = measured + 3 * plan.anchors
    width = own + plan.size
    take_leading(P, n, measured, s.lead)
    for i in range(first, last):
        m = select[i]
        if plan.anchors > 0 and s.base[m, 0] != held:  # neighbours often share an anchor
            held = s.base[m, 0]
            take_rows(P, n, held, 3, s.lead[measured:])
        take_rows(P, n, s.base[m, 1], plan.size, s.lead[own:])
        multiply_panel(s.HP[(i - first) * size :], 0, s.H[m], size, s.lead, 0, 0, width, n)


@kernel
def take_columns(plan: Plan, s: Scratch, m: int, top: int, rows: int, held: int) -> int:
    """Columns of HP that belong to a landmark, transposed, below those of the leading rows in `shared`.

    Those of the anchor are there where it is `held`, the one before; the anchor that is there now.
    """
    HP, shared, column = s.HP, s.shared, plan.measured
    for which in range(1 - plan.anchors, 2):
        base = s.base[m, which]
        for row in range(rows if which < 1 and s.base[m, 0] == held else top, rows):
            shared[column, row] = HP[row, base]
            shared[column + 1, row] = HP[row, base + 1]
            shared[column + 2, row] = HP[row, base + 2]
        column += 3
    for c in range(3, plan.size):
        for row in range(top, rows):
            shared[column, row] = HP[row, s.base[m, 1] + c]
        column += 1
    return int(s.base[m, 0])


@kernel
def take_leading_columns(plan: Plan, s: Scratch, rows: int) -> None:
    """The first columns of HP, transposed, in `shared`."""
    for row in range(rows):
        for c in range(plan.measured):
            s.shared[c, row] = s.HP[row, c]


@kernel
def innovation_covariance(plan: Plan, s: Scratch, select: IntArray, first: int, last: int, size: int) -> bool:
    """Upper triangle of S = (H P) H^T + R of these measurements; whether R is left in it."""
    S, rows, held = s.S, (last - first) * size, np.int64(-1)
    width = plan.measured + 3 * plan.anchors + plan.size
    take_leading_columns(plan, s, rows)
    for i in range(first, last):
        m, top = select[i], (i - first) * size
        held = take_columns(plan, s, m, top, rows, held)
        multiply_panel(S[top:], top, s.H[m], size, s.shared, 0, top, width, rows - top)
        for a in range(size):
            for b in range(a, size):
                S[top + a, top + b] += s.R[m, a, b]
            if S[top + a, top + a] > DROWNED * s.R[m, a, a]:
                return False
    return True


@kernel
def factorise(calls: Calls, s: Scratch, rows: int) -> bool:
    """Cholesky factor of S in place; whether there is one."""
    return cholesky(calls.cholesky, s.S, rows, s.letters, s.sizes) and math.isfinite(s.S[rows - 1, rows - 1])


@kernel
def absorb(calls: Calls, P: FloatArray, n: int, s: Scratch, rows: int) -> float:
    """Correct P and delta by HP, its last column the innovation, and S; the NIS, or -1 without a Cholesky factor."""
    HP = s.HP
    if not factorise(calls, s, rows):
        return -1.0
    solve_triangular(s.S, HP, rows, n + 1)
    nis = 0.0
    for row in range(rows):
        solved, nu = HP[row], HP[row, n]
        for j in range(n):
            s.delta[j] += nu * solved[j]
        nis += nu**2
    subtract_square(P, HP, rows, n)
    return nis


@kernel
def explained(plan: Plan, s: Scratch, m: int, k: int) -> float:
    """Product of one row of a measurement's H with delta."""
    H, delta, measured = s.H[m, k], s.delta, plan.measured
    total = 0.0
    for c in range(measured):
        total += H[c] * delta[c]
    for which in range(1 - plan.anchors, 2):
        for c in range(3):
            total += H[measured + c] * delta[s.base[m, which] + c]
        measured += 3
    for c in range(3, plan.size):
        total += H[measured + c - 3] * delta[s.base[m, 1] + c]
    return total


@kernel
def _take(
    calls: Calls, plan: Plan, P: FloatArray, n: int, s: Scratch, select: IntArray, first: int, last: int, size: int
) -> float:
    """Correct P and delta with the measurements first to last - 1; the NIS, or -1 where S has no Cholesky factor."""
    times_covariance(plan, P, n, s, select, first, last, size)
    if not innovation_covariance(plan, s, select, first, last, size):
        return -1.0
    for i in range(first, last):
        m = select[i]
        for k in range(size):
            s.HP[(i - first) * size + k, n] = s.nu[m, k] - explained(plan, s, m, k)
    return absorb(calls, P, n, s, (last - first) * size)


@unit("correct")
def correct(
    calls: Calls, plan: Plan, P: FloatArray, n: int, s: Scratch, select: IntArray, count: int, size: int
) -> None:
    """Kalman update with the selected measurements: P in place; delta, `used` and the NIS (`result`) written."""
    for j in range(n):
        s.delta[j] = 0.0
    nis, chunk = 0.0, max(1, CHUNK_ROWS // size)
    chunks = -(-count // chunk)
    for i in range(chunks):
        first, last = count * i // chunks, count * (i + 1) // chunks
        gained = _take(calls, plan, P, n, s, select, first, last, size)
        for j in range(first, last):
            s.used[select[j]] = gained >= 0.0
        if gained >= 0.0:
            nis += gained
        elif last - first > 1:
            for j in range(first, last):
                gained = _take(calls, plan, P, n, s, select, j, j + 1, size)
                s.used[select[j]] = gained >= 0.0
                if gained >= 0.0:
                    nis += gained
    s.result[0] = nis


@kernel
def correct_rows(
    calls: Calls,
    P: FloatArray,
    n: int,
    rows: IntArray,
    H: FloatArray,
    nu: FloatArray,
    R: FloatArray,
    limit: float,
    s: Scratch,
) -> float:
    """Correct P and delta with one measurement that is linear in the errors at `rows`, H (k, len(rows)).

    The NIS, above `limit` without a correction; -1 where S has no Cholesky factor. `lead` has room for the rows.
    """
    size, width = H.shape
    for j in range(width):
        take_row(P, n, rows[j], s.lead[j])
    for top in range(0, size, 4):
        multiply_panel(s.HP[top:], 0, H[top:], min(4, size - top), s.lead, 0, 0, width, n)
    for a in range(size):
        for b in range(a, size):
            total = R[a, b]
            for j in range(width):
                total += s.HP[b, rows[j]] * H[a, j]
            s.S[a, b] = total
        s.HP[a, n] = nu[a]
    for j in range(n):
        s.delta[j] = 0.0
    if not factorise(calls, s, size):
        return -1.0
    solve_triangular(s.S, s.HP, size, n + 1)
    nis = 0.0
    for a in range(size):
        nis += s.HP[a, n] ** 2
    if nis <= limit:
        for a in range(size):
            whitened = s.HP[a, n]
            for j in range(n):
                s.delta[j] += whitened * s.HP[a, j]
        subtract_square(P, s.HP, size, n)
    return nis


@unit("iterate")
def iterate(
    calls: Calls, plan: Plan, variant: int, stage: int, S: Storage, b: int, s: Scratch, count: int, size: int
) -> None:
    """One pass before the last one: the selected measurements, linearised where it would move the state."""
    n = plan.leading + plan.size * S.counts[b, BLOCKS]
    _propose(calls, plan, S, b, s, count, size, n)
    for i in plan.considered:
        s.delta[i] = 0.0
    keeps = plan.relinearise_above > 0.0
    if keeps:
        _keep_tangents(s, count, size)
    move(calls, plan, S, b, s)
    call(calls.linearise, (calls, plan, variant, stage, S, b, s.moved, s.moved_blocks, s, count))
    if plan.resets:
        _left_jacobian(S.x[b], s.delta, s.F)
    put_variables(plan, s.delta, s.F)
    _by_earlier_errors(plan, n, s, count, size)
    if keeps:
        _restore_straight(plan, s, count, size)


@kernel
def _propose(calls: Calls, plan: Plan, S: Storage, b: int, s: Scratch, count: int, size: int, n: int) -> None:
    """delta of one pass, P as it was: from one batch, or chunk by chunk on a copy where that has no factor."""
    P, rows = S.P[b], count * size
    times_covariance(plan, P, n, s, s.select, 0, count, size)
    if innovation_covariance(plan, s, s.select, 0, count, size) and factorise(calls, s, rows):
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
    call(calls.correct, (calls, plan, s.copy, n, s, s.select, count, size))


@kernel
def _left_jacobian(x: FloatArray, delta: FloatArray, J: FloatArray) -> None:
    """J_l of the rotation delta in W, (3, 3)."""
    t0, t1, t2 = times(orientation(x), delta[3], delta[4], delta[5])
    put(J, 0, 0, transposed(right_jacobian_of(t0, t1, t2)), 1.0)


@kernel
def _by_earlier_errors(plan: Plan, n: int, s: Scratch, count: int, size: int) -> None:
    """Carry H back to the errors before the correction, by W and D of the scratch, and nu what that has explained."""
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
                for which in range(1 - plan.anchors, 2):
                    for j in range(3 if which < 1 else plan.size):
                        total += H[c] * s.W[s.base[m, which] + j, a]
                        c += 1
                s.nu[m, k] += total * s.delta[3 + a]
                s.block[a, 0] = total
            if plan.resets:  # leading points turn
                _times_block(H, 0, 3, s.F, s.G[0])
                if plan.sees_velocity:
                    _times_block(H, plan.velocity, 3, s.F, s.G[0])
            for r in range(0 if plan.first_estimates else len(plan.rotations)):
                row = plan.rotations[r, 0]
                if row < measured:
                    _times_block(H, row, 3, s.F[row:, row:], s.G[0])
            if scales_blocks(plan):
                c = measured
                for which in range(1 - plan.anchors, 2):
                    width = 3 if which < 1 else plan.size
                    _times_block(H, c, width, s.D[(s.base[m, which] - plan.leading) // plan.size], s.G[0])
                    c += width
            for a in range(3):
                H[3 + a] += s.block[a, 0]
            s.nu[m, k] += explained(plan, s, m, k)
            for a in range(3):
                s.nu[m, k] -= s.block[a, 0] * s.delta[3 + a]


@kernel
def _times_block(H: FloatArray, first: int, width: int, D: FloatArray, before: FloatArray) -> None:
    """H[first:first + width] <- H[first:first + width] D, of D its first rows and columns."""
    for j in range(width):
        before[j] = H[first + j]
    for j in range(width):
        H[first + j] = 0.0
        for k in range(width):
            H[first + j] += before[k] * D[k, j]


@kernel
def _keep_tangents(s: Scratch, count: int, size: int) -> None:
    """Copy H and nu of the selected measurements."""
    width = s.H.shape[2]
    for i in range(count):
        m = s.select[i]
        for k in range(size):
            for c in range(width):
                s.tangents[m, k, c] = s.H[m, k, c]
            s.tangents[m, k, width] = s.nu[m, k]


@kernel
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


@kernel
def _exchange_tangent(s: Scratch, m: int, k: int) -> None:
    """Exchange a row of H and its nu with those that were kept."""
    width = s.H.shape[2]
    for c in range(width):
        s.H[m, k, c], s.tangents[m, k, c] = s.tangents[m, k, c], s.H[m, k, c]
    s.nu[m, k], s.tangents[m, k, width] = s.tangents[m, k, width], s.nu[m, k]
