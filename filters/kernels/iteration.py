"""Passes of an iterated update before the last one: the state corrected, and the measurements linearised there."""

from __future__ import annotations

from filters.geometry.arrays import FloatArray
from filters.geometry.rotations import right_jacobian_of
from filters.geometry.three_by_three import put, times, transposed
from filters.kernels.blas import kernel
from filters.kernels.calls import Calls, call, unit
from filters.kernels.correction import explained, factorise, innovation_covariance, times_covariance
from filters.kernels.prediction import orientation
from filters.kernels.recipe import Plan
from filters.kernels.records import BLOCKS, Scratch, Storage
from filters.kernels.retraction import move, put_variables, scales_blocks


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
