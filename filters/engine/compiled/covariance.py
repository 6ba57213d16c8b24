"""Kernels on P: rows of the symmetric matrix, transforms of leading rows, changes of rank six, moves of blocks."""

from __future__ import annotations

from numba import njit

from filters.engine.compiled.blas import KERNEL
from filters.engine.compiled.storage import Scratch
from filters.validation import FloatArray, IntArray

LOST = 1e-10
"""Share of a variance of the pose that rounding may have made up; another order of the same sums then agrees."""


@njit(**KERNEL)
def take_rows(P: FloatArray, n: int, first: int, rows: FloatArray) -> None:
    """Whole rows first to first + 2 of the symmetric P, (3, n)."""
    for j in range(first):
        rows[0, j], rows[1, j], rows[2, j] = P[j, first], P[j, first + 1], P[j, first + 2]
    for i in range(3):
        for j in range(first, first + i):
            rows[i, j] = P[j, first + i]
        for j in range(first + i, n):
            rows[i, j] = P[first + i, j]


@njit(**KERNEL)
def take_leading(P: FloatArray, n: int, count: int, rows: FloatArray) -> None:
    """The first whole rows of the symmetric P, (count, n)."""
    for i in range(count):
        for j in range(i):
            rows[i, j] = P[j, i]
        for j in range(i, n):
            rows[i, j] = P[i, j]


@njit(**KERNEL)
def identity(F: FloatArray) -> None:
    """F = I."""
    for i in range(len(F)):
        for j in range(len(F)):
            F[i, j] = 1.0 if i == j else 0.0


@njit(**KERNEL)
def transform_leading(P: FloatArray, n: int, s: Scratch) -> None:
    """P <- blockdiag(F, I) P blockdiag(F, I)^T, with F of the scratch (`symmetric.transform_leading`)."""
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


@njit(**KERNEL)
def add_rank_six(P: FloatArray, n: int, G: FloatArray) -> None:
    """P += U V^T + V U^T, with U^T and V^T one above the other in G (6, n)."""
    for i in range(n):
        u0, u1, u2, v0, v1, v2 = G[0, i], G[1, i], G[2, i], G[3, i], G[4, i], G[5, i]
        if u0 == 0.0 and u1 == 0.0 and u2 == 0.0 and v0 == 0.0 and v1 == 0.0 and v2 == 0.0:
            continue
        for j in range(i, n):
            P[i, j] += u0 * G[3, j] + u1 * G[4, j] + u2 * G[5, j] + v0 * G[0, j] + v1 * G[1, j] + v2 * G[2, j]


@njit(**KERNEL)
def shear_by_rotation(P: FloatArray, n: int, W: FloatArray, s: Scratch) -> None:
    """P <- (I + W E^T) P (I + W E^T)^T, E selecting the rotation (rows 3 to 5); W (n, 3)."""
    G, rotation = s.G, s.block
    take_rows(P, n, 3, rotation)
    for j in range(n):
        for a in range(3):
            G[a, j] = W[j, a]
            G[3 + a, j] = rotation[a, j] + 0.5 * (
                W[j, 0] * rotation[0, 3 + a] + W[j, 1] * rotation[1, 3 + a] + W[j, 2] * rotation[2, 3 + a]
            )
    add_rank_six(P, n, G)


@njit(**KERNEL)
def scale_blocks(P: FloatArray, n: int, leading: int, D: FloatArray, s: Scratch) -> None:
    """P <- blockdiag(I, D) P blockdiag(I, D)^T, with D (C, 3, 3) on the blocks behind the leading rows.

    Rows take the five diagonals of D^T as vectors, which a loop over blocks of three could not do.
    """
    diagonals, rows, turned = s.G, s.lead[:3], s.lead[3:6]
    diagonals[:5, leading:n] = 0.0
    for left in range(leading, n, 3):
        A = D[(left - leading) // 3]
        for j in range(3):
            for k in range(3):
                diagonals[2 + k - j, left + j] = A[j, k]
    for i in range(leading):
        _times_diagonals(P[i], leading, n, diagonals, rows[0], P[i])
    for top in range(leading, n, 3):
        for i in range(1, 3):  # the block on the diagonal has to be whole
            for j in range(i):
                P[top + i, top + j] = P[top + j, top + i]
        for i in range(3):
            _times_diagonals(P[top + i], top, n, diagonals, rows[i], turned[i])
        A = D[(top - leading) // 3]
        for i in range(3):
            target, a, b, c = P[top + i], A[i, 0], A[i, 1], A[i, 2]
            for j in range(top, n):
                target[j] = a * turned[0, j] + b * turned[1, j] + c * turned[2, j]


@njit(**KERNEL)
def scale_block(P: FloatArray, n: int, first: int, D: tuple[float, ...], rows: FloatArray) -> None:
    """P <- blockdiag(I, D, I) P blockdiag(I, D, I)^T, with D (row by row) on the rows first to first + 2."""
    take_rows(P, n, first, rows)
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


@njit(**KERNEL)
def _times_diagonals(
    row: FloatArray, first: int, n: int, diagonals: FloatArray, copied: FloatArray, target: FloatArray
) -> None:
    """The columns first to n - 1 of a row times a matrix with these diagonals, -2 to 2, in `target`."""
    for j in range(first, n):
        copied[j] = row[j]
    copied[first - 2] = copied[first - 1] = copied[n] = copied[n + 1] = 0.0
    for j in range(first, n):
        target[j] = diagonals[0, j] * copied[j - 2] + diagonals[1, j] * copied[j - 1] + diagonals[2, j] * copied[j]
    for j in range(first, n):
        target[j] += diagonals[3, j] * copied[j + 1] + diagonals[4, j] * copied[j + 2]


@njit(**KERNEL)
def move_block(P: FloatArray, origin: int, target: int) -> None:
    """Rows target to target + 2 become those of the last block, at rows origin > target."""
    for j in range(target):
        for c in range(3):
            P[j, target + c] = P[j, origin + c]
    for a in range(3):
        for c in range(a, 3):
            P[target + a, target + c] = P[origin + a, origin + c]
    for j in range(target + 3, origin):
        for c in range(3):
            P[target + c, j] = P[j, origin + c]


@njit(**KERNEL)
def keep_considered(P: FloatArray, considered: IntArray, kept: FloatArray) -> None:
    """Remember what the considered rows have among themselves."""
    for a in range(len(considered)):
        for b in range(a, len(considered)):
            i, j = considered[a], considered[b]
            kept[a, b] = P[min(i, j), max(i, j)]


@njit(**KERNEL)
def restore_considered(P: FloatArray, considered: IntArray, kept: FloatArray, delta: FloatArray) -> None:
    """Undo what a correction did to the considered rows among themselves, and to their values (Schmidt-Kalman).

    The correction of everything else, and of its covariance with them, is that of the full update.
    """
    for a in range(len(considered)):
        delta[considered[a]] = 0.0
        for b in range(a, len(considered)):
            i, j = considered[a], considered[b]
            P[min(i, j), max(i, j)] = kept[a, b]


@njit(**KERNEL)
def pose_variances(P: FloatArray) -> tuple[float, ...]:
    """Variances of the pose."""
    return P[0, 0], P[1, 1], P[2, 2], P[3, 3], P[4, 4], P[5, 5]


@njit(**KERNEL)
def keep_definite(P: FloatArray, before: tuple[float, ...], factor: FloatArray) -> None:
    """Give the pose a Cholesky factor again where rounding has taken it: the smallest diagonal that will do is added.

    A step whose numbers differ by 1e16 and more leaves less of a variance than its own rounding, which is a share of
    the variances `before` the step. What is added is about that size: the belief grows by hardly more than was lost,
    and what is known exactly stays so.
    """
    share = LOST
    while share <= 1e6 and not _has_factor(P, factor):  # what is not finite never has one
        for i, variance in enumerate(before):
            P[i, i] = max(P[i, i], 0.0) + share * (abs(P[i, i]) + variance)
        share *= 10.0


@njit(**KERNEL)
def _has_factor(P: FloatArray, L: FloatArray) -> bool:
    """Whether each variance of the pose, given those before it, is more than rounding makes up, or exactly zero."""
    for j in range(6):
        for i in range(j, 6):
            value = P[j, i]
            for k in range(j):
                value -= L[i, k] * L[j, k] * L[k, k]
            if i > j:
                L[i, j] = value / L[j, j] if L[j, j] > 0.0 else 0.0
            elif value > LOST * P[j, j] or P[j, j] == 0.0:
                L[j, j] = value
            else:
                return False
    return True
