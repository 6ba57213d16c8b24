"""A stranger's inertial motion: strapdown integration with biases and gravity, as a kernel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from filters import BodyVelocity, MotionKernels, MotionModel, Variable
from filters.geometry.rotations import matrix_of, product_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import cross_matrix, multiply, put, times, transposed


@dataclass(frozen=True, eq=False)
class ImuStep(BodyVelocity):
    """Odometry that brings samples (K, 6) of gyro, rad/s, and accelerometer, m/s^2, camera frame, in equal times."""

    samples: np.ndarray = None  # type: ignore[assignment]


BIASES = Variable(
    "imu-bias", np.zeros(6), np.diag([1e-2] * 3 + [5e-2] * 3) ** 2, random_walk=np.repeat([2e-5, 3e-3], 3)
)
AT_REST = np.tile([0.0, 0.1, 0.0, 0.0, -9.8, 0.0], (4, 1))
GRAVITY = Variable("gravity", [0.0, 9.81, 0.0], 1e-4 * np.eye(3), in_world=True)


@njit
def _times_transpose(A, B, C):
    """C = A B^T."""
    for i in range(len(A)):
        for j in range(len(B)):
            C[i, j] = 0.0
            for k in range(A.shape[1]):
                C[i, j] += A[i, k] * B[j, k]


@njit
def _transform(A, M, half):
    """M <- A M; the rows of A from the biases on are those of the identity."""
    for i in range(12):
        for j in range(M.shape[1]):
            half[i, j] = 0.0
        for k in range(len(M)):
            if A[i, k] != 0.0:
                for j in range(M.shape[1]):
                    half[i, j] += A[i, k] * M[k, j]
    M[:12] = half[:12]


def _step(settings, state, dt, odometry, moved, F, Q):
    """Step by step, attitude at half of each, with the Jacobians."""
    h, A, G = dt / len(odometry), np.eye(21), np.zeros((21, 6))
    half, GG = np.zeros((21, 21)), np.zeros((21, 21))
    g0, g1, g2 = state[19], state[20], state[21]
    moved[:] = state
    for i in range(21):
        F[i, i] = 1.0
    for i in range(9, 12):
        A[i, i], A[i, 3 + i] = 0.0, -1.0
    for s in range(len(odometry)):
        w0, w1, w2 = odometry[s, 0] - state[13], odometry[s, 1] - state[14], odometry[s, 2] - state[15]
        f0, f1, f2 = odometry[s, 3] - state[16], odometry[s, 4] - state[17], odometry[s, 5] - state[18]
        R = matrix_of(moved[3], moved[4], moved[5], moved[6])
        q0, q1, q2, q3 = quaternion_of(0.5 * h * w0, 0.5 * h * w1, 0.5 * h * w2)
        middle = matrix_of(q0, q1, q2, q3)
        R_h, (c0, c1, c2) = multiply(R, middle), times(middle, f0, f1, f2)
        by_rotation = multiply(R, cross_matrix(c0, c1, c2))
        by_gyro = multiply(
            multiply(R_h, cross_matrix(f0, f1, f2)), right_jacobian_of(0.5 * h * w0, 0.5 * h * w1, 0.5 * h * w2)
        )
        q0, q1, q2, q3 = quaternion_of(h * w0, h * w1, h * w2)
        put(A, 3, 3, transposed(matrix_of(q0, q1, q2, q3)), 1.0)
        put(A, 3, 12, right_jacobian_of(h * w0, h * w1, h * w2), -h)
        for row, scale in ((0, 0.5 * h * h), (6, h)):
            put(A, row, 3, by_rotation, -scale)
            put(A, row, 12, by_gyro, 0.5 * h * scale)
            put(A, row, 15, R_h, -scale)
            for i in range(3):
                A[row + i, 18 + i], A[i, 6 + i] = scale, h
        for i in range(12):
            for k in range(6):
                G[i, k] = A[i, 12 + k] * settings[0 if k < 3 else 1] / np.sqrt(h)
        _transform(A, F, half)
        _transform(A, Q, half)
        _times_transpose(Q, A, half)
        _times_transpose(G, G, GG)
        Q[:] = half + GG
        a = times(R_h, f0, f1, f2)
        for i, acceleration in enumerate((a[0] + g0, a[1] + g1, a[2] + g2)):
            moved[i] += h * moved[7 + i] + 0.5 * h * h * acceleration
            moved[7 + i] += h * acceleration
        moved[3], moved[4], moved[5], moved[6] = product_of(moved[3], moved[4], moved[5], moved[6], q0, q1, q2, q3)
        moved[10], moved[11], moved[12] = w0, w1, w2


@dataclass(frozen=True)
class Strapdown(MotionModel):
    """Strapdown integration, midpoint attitude; biases and gravity are variables."""

    gyro_density: float = 1.7e-4
    accelerometer_density: float = 2e-3
    variables: tuple[Variable, ...] = (BIASES, GRAVITY)
    kernels = MotionKernels(_step, settings=("gyro_density", "accelerometer_density"))

    def __post_init__(self) -> None:
        for name in ("gyro_density", "accelerometer_density"):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not 0.0 <= value < np.inf:
                raise ValueError(f"{name} must be a finite number >= 0, got {value!r}")

    def check_odometry(self, odometry: BodyVelocity | None) -> None:
        """Samples are needed."""
        if not isinstance(odometry, ImuStep):
            raise ValueError(f"odometry must be an ImuStep with motion=Strapdown(), got {type(odometry).__name__}")

    def odometry_numbers(self, odometry: BodyVelocity | None) -> np.ndarray:
        """The samples."""
        return odometry.samples if isinstance(odometry, ImuStep) else AT_REST
