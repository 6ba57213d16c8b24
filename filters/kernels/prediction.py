"""Kernels of the step: the leading variables with P, and odometry as a measurement."""

from __future__ import annotations

import numpy as np

from filters.geometry.arrays import FloatArray
from filters.geometry.rotations import Nine
from filters.geometry.vectors import cross_matrix, put, transposed
from filters.kernels.blas import kernel
from filters.kernels.calls import Calls, call, unit
from filters.kernels.correction import correct_rows
from filters.kernels.covariance import clear, identity, orientation, transform_leading
from filters.kernels.recipe import Plan
from filters.kernels.records import FrameArrays, Scratch


@kernel
def world_rotation(plan: Plan, x: FloatArray, effect: FloatArray) -> None:
    """Write the effect of a rotation of the world about its origin on the leading errors, zero in the other rows."""
    v = plan.velocity
    for i in range(len(effect)):
        for a in range(3):
            effect[i, a] = 0.0
    put(effect, 0, 0, cross_matrix(x[0], x[1], x[2]), -1.0)
    put(effect, 3, 0, transposed(orientation(x)), 1.0)
    put(effect, v, 0, cross_matrix(x[v + 1], x[v + 2], x[v + 3]), -1.0)
    for row in plan.in_world:
        put(effect, row, 0, cross_matrix(x[row + 1], x[row + 2], x[row + 3]), -1.0)


@kernel
def constrain(J: FloatArray, rows: int, columns: int, image: FloatArray, source: FloatArray, R: Nine) -> None:
    """Constrain a Jacobian to first estimates: J[:, 3:6] += (image - J source) R_wc (`filters.errors`)."""
    for i in range(rows):
        m0, m1, m2 = image[i, 0], image[i, 1], image[i, 2]
        for k in range(columns):
            m0 -= J[i, k] * source[k, 0]
            m1 -= J[i, k] * source[k, 1]
            m2 -= J[i, k] * source[k, 2]
        for a in range(3):
            J[i, 3 + a] += m0 * R[a] + m1 * R[3 + a] + m2 * R[6 + a]


@kernel
def constrain_step(plan: Plan, before: FloatArray, after: FloatArray, F: FloatArray, s: Scratch) -> None:
    """F of a step takes a rotation of the world before it to that after it."""
    leading = plan.leading
    source, image = s.W[:leading], s.W[leading : 2 * leading]
    world_rotation(plan, before, source)
    world_rotation(plan, after, image)
    constrain(F, leading, leading, image, source, orientation(before))


@unit("settle")
def settle(plan: Plan, P: FloatArray, n: int, x: FloatArray, predicted: FloatArray, s: Scratch) -> None:
    """P in the tangent space at the state as it is now, as after a step of no length: that is the first estimate."""
    identity(s.F)
    constrain_step(plan, predicted, x, s.F, s)
    transform_leading(P, n, s)


@unit("predict")
def predict(
    calls: Calls,
    plan: Plan,
    P: FloatArray,
    n: int,
    x: FloatArray,
    predicted: FloatArray,
    frame: FrameArrays,
    b: int,
    s: Scratch,
) -> None:
    """Leading variables and P after a step of the motion."""
    leading, rows, F, Q, moved = plan.leading, plan.moved_rows, s.F, s.Q, s.moved
    for i in range(len(plan.moved)):
        s.state[i] = s.after[i] = x[plan.moved[i]]
    clear(s.F_part)
    clear(Q)
    odometry = frame.odometry[b, : frame.odometry_rows[b]]
    # F and Q by the motion's `step` on dual numbers: lifted_motion.py
    call(calls.step, (plan.motion, s.state, frame.dt[b], odometry, s.after, s.F_part, Q))
    identity(F)
    for i in range(len(x)):
        moved[i] = x[i]
    for i in range(len(plan.moved)):
        moved[plan.moved[i]] = s.after[i]
    for i in range(len(rows)):
        for j in range(len(rows)):
            F[rows[i], rows[j]] = s.F_part[i, j]
    if plan.first_estimates:
        constrain_step(plan, predicted, moved, F, s)
    transform_leading(P, n, s)
    for i in range(len(rows)):
        for j in range(len(rows)):
            if rows[i] <= rows[j]:
                P[rows[i], rows[j]] += Q[i, j]
    seconds = frame.dt[b]
    for i in range(leading):
        P[i, i] += plan.walk[i] * seconds
    for i in range(len(x)):
        x[i] = predicted[i] = moved[i]


@unit("fuse_odometry")
def fuse_odometry(
    calls: Calls, plan: Plan, P: FloatArray, n: int, x: FloatArray, frame: FrameArrays, b: int, s: Scratch
) -> None:
    """Odometry as a measurement after the step: P in place, delta; `result` is 1 where it was used."""
    for i in range(len(plan.moved)):
        s.after[i] = x[plan.moved[i]]
    clear(s.odometry_H)
    clear(s.odometry_R)
    odometry = frame.odometry[b, : frame.odometry_rows[b]]
    arguments = plan.motion, s.after, frame.dt[b], odometry, s.odometry_nu, s.odometry_H, s.odometry_R
    call(calls.measure, arguments)
    nis = correct_rows(calls, P, n, plan.moved_rows, s.odometry_H, s.odometry_nu, s.odometry_R, np.inf, s)
    s.result[0] = 1.0 if nis >= 0.0 else 0.0
