"""Landmarks that change by themselves: steps of measured ones, and numbers that fade (`LandmarkDrift`, `memory`)."""

from __future__ import annotations

import math

from filters.geometry.arrays import FloatArray, IntArray
from filters.kernels.blas import kernel
from filters.kernels.calls import TO_DRIFT, Calls, ask, unit
from filters.kernels.linearisation import AGAIN, linearise_selected
from filters.kernels.recipe import Plan
from filters.kernels.scratch import Scratch
from filters.kernels.storage import BLOCKS, OWN, POINT, Storage

SMALLEST_DETERMINANT = 1e-3
"""Of d(u, v, d) / d(own numbers): below, a landmark is so far that a step in the image has no place in the map."""


@kernel
def step_covariance(part: FloatArray, R: FloatArray, Q: FloatArray) -> None:
    """Covariance of a step in (u, v, d): Q = share^2 R + diag(pixels^2)."""
    for a in range(3):
        for b in range(3):
            Q[a, b] = part[0] * R[a, b]
        Q[a, a] += part[1 + a]


@kernel
def take_steps(plan: Plan, part: FloatArray, P: FloatArray, s: Scratch, select: IntArray, count: int) -> None:
    """P_own += J^-1 Q J^-T of the selected landmarks, linearised, J = d(u, v, d) / d(own numbers)."""
    first = plan.measured + 3 * plan.anchors
    Q, inverse, half = s.small[0], s.small[1], s.small[2]
    for i in range(count):
        m = select[i]
        J, own = s.H[m], s.base[m, 2]
        for a in range(3):  # cofactors
            b, c = (a + 1) % 3, (a + 2) % 3
            for k in range(3):
                p, q = (k + 1) % 3, (k + 2) % 3
                inverse[k, a] = J[b, first + p] * J[c, first + q] - J[b, first + q] * J[c, first + p]
        determinant = 0.0
        for k in range(3):
            determinant += J[0, first + k] * inverse[k, 0]
        if not abs(determinant) >= SMALLEST_DETERMINANT:
            continue
        step_covariance(part, s.noise[m], Q)
        for a in range(3):
            for b in range(3):
                half[a, b] = 0.0
                for k in range(3):
                    half[a, b] += inverse[a, k] * Q[k, b] / determinant
        for a in range(3):
            for b in range(a, 3):
                total = 0.0
                for k in range(3):
                    total += half[a, k] * inverse[b, k]
                P[own + a, own + b] += total / determinant


@unit("fade")
def fade(plan: Plan, S: Storage, b: int, s: Scratch, dt: float) -> None:
    """Numbers of landmarks behind the third go back to zero, their covariance to `prior`, in a step of dt."""
    P, blocks, kept = S.P[b], S.blocks[b], math.exp(-dt / plan.memory)
    n, factors = plan.leading + plan.size * S.counts[b, BLOCKS], s.G[0]
    for i in range(n):
        factors[i] = 1.0
    for k in range(S.counts[b, BLOCKS]):
        if S.kind[b, k] == OWN or S.kind[b, k] == POINT:
            for a in range(3, plan.size):
                factors[plan.leading + plan.size * k + a] = kept
                blocks[k, a] *= kept
    for i in range(n):
        for j in range(i, n):
            P[i, j] *= factors[i] * factors[j]
    for k in range(S.counts[b, BLOCKS]):
        first = plan.leading + plan.size * k
        if factors[first + 3] == kept:
            for a in range(3, plan.size):
                for c in range(a, plan.size):
                    P[first + a, first + c] += (1.0 - kept * kept) * plan.prior[a - 3, c - 3]


@unit("drift")
def drift(
    calls: Calls, plan: Plan, part: int, variant: int, stage: int, S: Storage, b: int, s: Scratch, count: int
) -> None:
    """Steps of the selected landmarks before the first stage, by the Jacobian of (u, v, d)."""
    if not plan.drift[part].any():
        return
    x, blocks, whole = S.x[b], S.blocks[b], plan.T.shape[1] - 1
    if plan.by_numbers:
        if not ask(calls, TO_DRIFT, b, s, count, 0, 0, 0):
            return
    else:
        linearise_selected(calls, plan, variant, whole, S, b, x, blocks, s, count, AGAIN)
    take_steps(plan, plan.drift[part], S.P[b], s, s.select, count)
    linearise_selected(calls, plan, variant, stage, S, b, x, blocks, s, count, AGAIN)
