"""Kernels on P: rows of the symmetric matrix, transforms of leading rows, changes of rank six, moves of blocks."""

from __future__ import annotations

from filters.geometry.arrays import FloatArray, IntArray
from filters.geometry.rotations import Nine, matrix_of
from filters.kernels.blas import kernel
from filters.kernels.calls import unit
from filters.kernels.recipe import Plan
from filters.kernels.records import Scratch

LOST = 1e-10
"""Share of a variance of the pose that rounding may have made up."""


@kernel
def take_row(P: FloatArray, n: int, row: int, taken: FloatArray) -> None:
    """A whole row of the symmetric P, (n,)."""
    for i in range(row):
        taken[i] = P[i, row]
    for i in range(row, n):
        taken[i] = P[row, i]


@kernel
def take_rows(P: FloatArray, n: int, first: int, count: int, rows: FloatArray) -> None:
    """Whole rows first to first + count - 1 >= first + 2 of the symmetric P, (count, n)."""
    for j in range(first):
        rows[0, j], rows[1, j], rows[2, j] = P[j, first], P[j, first + 1], P[j, first + 2]
    for i in range(3):
        for j in range(first, first + i):
            rows[i, j] = P[j, first + i]
        for j in range(first + i, n):
            rows[i, j] = P[first + i, j]
    for i in range(3, count):
        take_row(P, n, first + i, rows[i])


@kernel
def take_leading(P: FloatArray, n: int, count: int, rows: FloatArray) -> None:
    """The first whole rows of the symmetric P, (count, n)."""
    for i in range(count):
        for j in range(i):
            rows[i, j] = P[j, i]
        for j in range(i, n):
            rows[i, j] = P[i, j]


@kernel
def orientation(x: FloatArray) -> Nine:
    """R_wc, row by row."""
    return matrix_of(x[3], x[4], x[5], x[6])


@kernel
def clear(matrix: FloatArray) -> None:
    """Set all entries to zero."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0.0


@kernel
def identity(F: FloatArray) -> None:
    """Set F to the identity."""
    for i in range(len(F)):
        for j in range(len(F)):
            F[i, j] = 1.0 if i == j else 0.0


@kernel
def transform_leading(P: FloatArray, n: int, s: Scratch) -> None:
    """P <- blockdiag(F, I) P blockdiag(F, I)^T, with F of the scratch."""
    F, old, half, changed, lead = s.F, s.old, s.half, s.changed, s.lead
    leading = len(F)
    for i in range(leading):
        changed[i] = False
        for k in range(leading):
            if F[i, k] != (1.0 if i == k else 0.0):
                changed[i] = True
        for j in range(i, leading):
            old[i, j] = old[j, i] = P[i, j]
    for i in range(leading):
        if changed[i]:
            for j in range(leading):
                half[i, j] = 0.0
            for k in range(leading):
                a = F[i, k]
                if a != 0.0:
                    for j in range(leading):
                        half[i, j] += a * old[k, j]
            for j in range(leading, n):
                lead[i, j] = P[i, j]
        else:
            for j in range(leading):
                half[i, j] = old[i, j]
    for i in range(leading):
        for j in range(i, leading):
            if changed[j]:
                total = 0.0
                for k in range(leading):
                    total += half[i, k] * F[j, k]
                P[i, j] = total
            elif changed[i]:
                P[i, j] = half[i, j]
    for i in range(leading):
        if changed[i]:
            first = True
            for k in range(leading):
                a = F[i, k]
                if a != 0.0:
                    source = lead if changed[k] else P
                    if first:
                        for j in range(leading, n):
                            P[i, j] = a * source[k, j]
                        first = False
                    else:
                        for j in range(leading, n):
                            P[i, j] += a * source[k, j]
            if first:
                for j in range(leading, n):
                    P[i, j] = 0.0


@kernel
def add_rank_six(P: FloatArray, n: int, G: FloatArray) -> None:
    """P += U V^T + V U^T, with U^T and V^T one above the other in G (6, n)."""
    for i in range(n):
        u0, u1, u2, v0, v1, v2 = G[0, i], G[1, i], G[2, i], G[3, i], G[4, i], G[5, i]
        if u0 == 0.0 and u1 == 0.0 and u2 == 0.0 and v0 == 0.0 and v1 == 0.0 and v2 == 0.0:
            continue
        for j in range(i, n):
            P[i, j] += u0 * G[3, j] + u1 * G[4, j] + u2 * G[5, j] + v0 * G[0, j] + v1 * G[1, j] + v2 * G[2, j]


@unit("shear")
def shear(P: FloatArray, n: int, s: Scratch) -> None:
    """P <- (I + W E^T) P (I + W E^T)^T, E selecting the rotation; W (n, 3) of the scratch."""
    G, W, rows = s.G, s.W, s.block
    take_rows(P, n, 3, 3, rows)
    for j in range(n):
        for a in range(3):
            G[a, j] = W[j, a]
            G[3 + a, j] = rows[a, j] + 0.5 * (
                W[j, 0] * rows[0, 3 + a] + W[j, 1] * rows[1, 3 + a] + W[j, 2] * rows[2, 3 + a]
            )
    add_rank_six(P, n, G)


@unit("scale_blocks")
def scale_blocks(plan: Plan, P: FloatArray, n: int, s: Scratch) -> None:
    """P <- blockdiag(I, D) P blockdiag(I, D)^T, with D (C, s, s) of the scratch on the blocks behind the leading rows.

    Rows take the diagonals of D^T as vectors, which a loop over blocks of three could not do.
    """
    D, size, leading = s.D, plan.size, plan.leading
    diagonals, rows, turned = s.G, s.lead[:size], s.lead[size : 2 * size]
    diagonals[: 2 * size - 1, leading:n] = 0.0
    for left in range(leading, n, size):
        A = D[(left - leading) // size]
        for j in range(size):
            for k in range(size):
                diagonals[size - 1 + k - j, left + j] = A[j, k]
    for i in range(leading):
        _times_diagonals(P[i], leading, n, diagonals, size, rows[0], P[i])
    for top in range(leading, n, size):
        for i in range(1, size):  # the block on the diagonal has to be whole
            for j in range(i):
                P[top + i, top + j] = P[top + j, top + i]
        for i in range(size):
            _times_diagonals(P[top + i], top, n, diagonals, size, rows[i], turned[i])
        A = D[(top - leading) // size]
        for i in range(size):
            target, a, b, c = P[top + i], A[i, 0], A[i, 1], A[i, 2]
            for j in range(top, n):
                target[j] = a * turned[0, j] + b * turned[1, j] + c * turned[2, j]
            for k in range(3, size):
                for j in range(top, n):
                    target[j] += A[i, k] * turned[k, j]


@kernel
def scale_block(P: FloatArray, n: int, first: int, D: tuple[float, ...], rows: FloatArray) -> None:
    """P <- blockdiag(I, D, I) P blockdiag(I, D, I)^T, with D (row by row) on the rows first to first + 2."""
    take_rows(P, n, first, 3, rows)
    for j in range(n):
        a, b, c = rows[0, j], rows[1, j], rows[2, j]
        for i in range(3):
            rows[i, j] = D[3 * i] * a + D[3 * i + 1] * b + D[3 * i + 2] * c
    for i in range(3):
        a, b, c = rows[i, first], rows[i, first + 1], rows[i, first + 2]
        for j in range(3):
            rows[i, first + j] = a * D[3 * j] + b * D[3 * j + 1] + c * D[3 * j + 2]
    for i in range(3):
        for j in range(first):
            P[j, first + i] = rows[i, j]
        for j in range(first + i, n):
            P[first + i, j] = rows[i, j]


@kernel
def _times_diagonals(
    row: FloatArray, first: int, n: int, diagonals: FloatArray, size: int, copied: FloatArray, target: FloatArray
) -> None:
    """The columns first to n - 1 of a row times a matrix with these diagonals, 1 - size to size - 1, in `target`."""
    m = size - 1
    for j in range(first, n):
        copied[j] = row[j]
    copied[first - 2] = copied[first - 1] = copied[n] = copied[n + 1] = 0.0
    below, beside, on = diagonals[m - 2], diagonals[m - 1], diagonals[m]
    for j in range(first, n):
        target[j] = below[j] * copied[j - 2] + beside[j] * copied[j - 1] + on[j] * copied[j]
    beside, above = diagonals[m + 1], diagonals[m + 2]
    for j in range(first, n):
        target[j] += beside[j] * copied[j + 1] + above[j] * copied[j + 2]
    for d in range(3, size):
        for j in range(first + d, n):
            target[j] += diagonals[m - d, j] * copied[j - d]
        for j in range(first, n - d):
            target[j] += diagonals[m + d, j] * copied[j + d]


@kernel
def move_block(P: FloatArray, origin: int, target: int, size: int) -> None:
    """The rows of the block at row target become those of the last one, at row origin > target."""
    for j in range(target):
        for c in range(size):
            P[j, target + c] = P[j, origin + c]
    for a in range(size):
        for c in range(a, size):
            P[target + a, target + c] = P[origin + a, origin + c]
    for j in range(target + size, origin):
        for c in range(size):
            P[target + c, j] = P[j, origin + c]


@kernel
def keep_considered(P: FloatArray, considered: IntArray, kept: FloatArray) -> None:
    """Remember what the considered rows have among themselves."""
    for a in range(len(considered)):
        for b in range(a, len(considered)):
            i, j = considered[a], considered[b]
            kept[a, b] = P[min(i, j), max(i, j)]


@kernel
def restore_considered(P: FloatArray, considered: IntArray, kept: FloatArray, delta: FloatArray) -> None:
    """Undo what a correction did to the considered rows among themselves, and to their values (Schmidt-Kalman).

    The correction of everything else, and of its covariance with them, is that of the full update.
    """
    for a in range(len(considered)):
        delta[considered[a]] = 0.0
        for b in range(a, len(considered)):
            i, j = considered[a], considered[b]
            P[min(i, j), max(i, j)] = kept[a, b]


@kernel
def pose_variances(P: FloatArray) -> tuple[float, ...]:
    """Variances of the pose."""
    return P[0, 0], P[1, 1], P[2, 2], P[3, 3], P[4, 4], P[5, 5]


@kernel
def keep_definite(P: FloatArray, before: tuple[float, ...], factor: FloatArray) -> None:
    """Give the pose a Cholesky factor again where rounding has taken it: the smallest diagonal that will do is added.

    A step whose numbers differ by 1e16 and more leaves less of a variance than its own rounding, which is a share of
    the variances `before` the step. What is added is about that size: the belief grows by hardly more than was lost,
    and what was known exactly stays so.
    """
    share = LOST
    while share <= 1e6 and not _has_factor(P, before, factor):  # what is not finite never has one
        for i, variance in enumerate(before):
            P[i, i] = max(P[i, i], 0.0) + share * (abs(P[i, i]) + variance)
        share *= 10.0


@kernel
def _has_factor(P: FloatArray, before: tuple[float, ...], L: FloatArray) -> bool:
    """Whether the pose less what rounding makes up of each variance has a factor.

    The least eigenvalue of its correlations is then LOST or more, and the rounding of any other order of the sums is
    far below it. What is exactly zero was so before.
    """
    for j, variance in enumerate(before):
        for i in range(j, 6):
            value = P[j, i] if i > j else (1.0 - LOST) * P[j, j]
            for k in range(j):
                value -= L[i, k] * L[j, k] * L[k, k]
            if i > j:
                L[i, j] = value / L[j, j] if L[j, j] > 0.0 else 0.0
            elif value > 0.0 or (value == 0.0 and variance == 0.0):
                L[j, j] = value
            else:
                return False
    return True
