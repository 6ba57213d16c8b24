"""Compiled code of a motion from its plain functions, with Jacobians by dual numbers.

Errors are those of `filters.motions.motion_model`. A step that inertial samples drive is one of each sample.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from filters.kernels.blas import kernel
from filters.kernels.duals import numbers, variables, write
from filters.kernels.plain import Keyed, Layout, differences, errors_of, grouped, plain, seeded, size_of, tried
from filters.kernels.recipe import Functions
from filters.motions.motion_model import MotionModel

TOGETHER = 6
"""Derivatives of a step that are carried along at once: more take longer to compile."""


@cache
def motion_functions(cls: type[MotionModel], layout: Layout, state: Layout, k: int, driver: str) -> Functions | str:
    """Compiled functions of a motion with these settings and k numbers of noise, or why there are zeros.

    `state` is what it moves; `driver` is what drives it: "noise", "odometry" or "samples" of an inertial unit.
    """
    functions = replace(
        _motion_kernels(cls, layout, state, k, driver), made_by=(motion_functions, cls, layout, state, k, driver)
    )
    return tried(cls.step, functions, ("step",))


def _motion_kernels(cls: type[MotionModel], layout: Layout, state: Layout, k: int, driver: str) -> Functions:
    v, m, step = size_of(state), errors_of(state), plain(cls.step, layout)
    count, flat = -(-(m + k) // TOGETHER), Keyed(_flat(len(state)), "flat", len(state))
    errors, seed, named = differences(state), seeded(state, TOGETHER), Keyed(grouped(state), "record", state)
    at = Keyed(lambda x, first, zeros: named(seed(x, zeros, first)), "state", state)
    names = tuple(name for name, _ in layout)
    noise: Any = Keyed({"noise": _no_noise(k), "odometry": _odometry, "samples": _sample}[driver], driver, k)
    sigmas: Any = plain(cls.sigmas, layout) if driver == "noise" else None

    def forward(
        settings: Any, x: Any, dt: Any, odometry: Any, row: Any, moved: Any, J: Any, zeros: Any, unused: Any
    ) -> None:
        for group in range(count):
            first = -TOGETHER * group  # column of the first error among the derivatives that are carried along
            arguments = noise(odometry, row, first + m, zeros)
            new = flat(step(settings, at(x, first, zeros), dt, arguments))
            write(moved, unused, new)
            write(zeros, J[:, TOGETHER * group : TOGETHER * (group + 1)], errors(moved, new))
            for i in range(m):
                zeros[i] = 0.0

    stepped = Keyed(forward, step, at, noise, errors, count, m)

    def by_noise(settings: Any, x: Any, dt: Any, odometry: Any, moved: Any, F: Any, Q: Any) -> None:
        J, U = np.zeros((m, TOGETHER * count)), np.zeros((k, k))
        zeros, unused = np.zeros(v + k), np.zeros((v, TOGETHER))
        stepped(settings, x, dt, odometry, 0, moved, J, zeros, unused)
        write(zeros, unused, sigmas(settings, dt))
        for i in range(k):
            U[i, i] = zeros[i] * zeros[i]
        _put(J, U, F, Q)

    def by_odometry(settings: Any, x: Any, dt: Any, odometry: Any, moved: Any, F: Any, Q: Any) -> None:
        J, zeros, unused = np.zeros((m, TOGETHER * count)), np.zeros(v + k), np.zeros((v, TOGETHER))
        stepped(settings, x, dt, odometry, 0, moved, J, zeros, unused)
        _put(J, odometry[1:], F, Q)

    def by_samples(settings: Any, x: Any, dt: Any, odometry: Any, moved: Any, F: Any, Q: Any) -> None:
        J, U = np.zeros((m, TOGETHER * count)), np.zeros((k, k))
        zeros, unused = np.zeros(v + k), np.zeros((v, TOGETHER))
        A, B, before, begin = np.zeros((m, m)), np.zeros((m, m)), x.copy(), 0.0
        for i in range(m):
            F[i, i] = 1.0
        for row in range(3, len(odometry)):
            end = dt if row == len(odometry) - 1 else odometry[row, 0]
            h, begin = end - begin, end
            for i in range(3):
                U[i, i], U[3 + i, 3 + i] = odometry[0, 3] ** 2 / h, odometry[0, 4] ** 2 / h
                U[6 + i, 6 + i], U[9 + i, 9 + i] = odometry[2, 0] ** 2 * h, odometry[2, 1] ** 2 * h
            stepped(settings, before, h, odometry, row, moved, J, zeros, unused)
            _put(J, U, A, B)
            _follow(A, F, J)
            _follow(A, Q, J)
            _follow(A, Q.T, J)
            for i in range(m):
                for j in range(m):
                    Q[i, j] += B[i, j]
            before[:] = moved

    kernel_of = {"noise": by_noise, "odometry": by_odometry, "samples": by_samples}
    if driver != "noise" or cls.odometry is MotionModel.odometry:
        return Functions(step=kernel_of[driver], settings=names)
    expected = plain(cls.odometry, layout)

    def measure(settings: Any, x: Any, dt: Any, odometry: Any, innovation: Any, H: Any, R: Any) -> None:
        J, zeros = np.zeros((6, TOGETHER * count)), np.zeros(v)
        for group in range(count):
            linear, angular = expected(settings, at(x, -TOGETHER * group, zeros), dt)
            write(innovation, J[:, TOGETHER * group : TOGETHER * (group + 1)], linear + angular)
        for i in range(6):
            innovation[i] = odometry[0, i] - innovation[i]
            for j in range(m):
                H[i, j] = J[i, j]
            for j in range(6):
                R[i, j] = odometry[1 + i, j]

    return Functions(step=by_noise, measure=measure, settings=names)


def _no_noise(k: int) -> Any:
    return lambda odometry, row, first, zeros: variables(zeros, k, first, TOGETHER)


def _odometry(odometry: Any, row: Any, first: Any, zeros: Any) -> Any:
    """Linear and angular velocity of an odometry."""
    return variables(odometry[0], 3, first, TOGETHER), variables(odometry[0, 3:], 3, first + 3, TOGETHER)


def _sample(odometry: Any, row: Any, first: Any, zeros: Any) -> Any:
    """Numbers of an inertial sample, walks of the biases, and where the unit is (`InertialUnit.rows`)."""
    return (
        variables(odometry[row, 1:], 3, first, TOGETHER),
        variables(odometry[row, 4:], 3, first + 3, TOGETHER),
        variables(zeros, 3, first + 6, TOGETHER),
        variables(zeros, 3, first + 9, TOGETHER),
        numbers(odometry[0], 3),
        numbers(odometry[1], 4),
    )


def _flat(count: int) -> Any:
    """Function that joins so many tuples."""
    if count == 1:
        return lambda parts: parts[0]
    rest = Keyed(_flat(count - 1), "flat", count - 1)
    return lambda parts: parts[0] + rest(parts[1:])


@kernel
def _put(J: Any, U: Any, F: Any, Q: Any) -> None:
    """F and Q = G U G^T from (F, G) side by side."""
    m, k = len(F), len(U)
    for i in range(m):
        for j in range(m):
            F[i, j], Q[i, j] = J[i, j], 0.0
        for a in range(k):
            along = 0.0
            for b in range(k):
                along += J[i, m + b] * U[b, a]
            if along != 0.0:
                for j in range(m):
                    Q[i, j] += along * J[j, m + a]


@kernel
def _follow(A: Any, F: Any, room: Any) -> None:
    """F = A F; rows of A that are those of the identity change nothing."""
    m = len(A)
    for i in range(m):
        for j in range(m):
            room[i, j] = 0.0
        for a in range(m):
            if A[i, a] != 0.0:
                for j in range(m):
                    room[i, j] += A[i, a] * F[a, j]
    for i in range(m):
        for j in range(m):
            F[i, j] = room[i, j]
