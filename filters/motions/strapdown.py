"""Strapdown integration of the samples of an inertial unit, with its biases and gravity as variables.

Derivation: docs/derivations/inertial.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.inertial import InertialSamples
from filters.contract.validation import finite_array, positive
from filters.contract.variables import Variable
from filters.geometry.arrays import FloatArray
from filters.geometry.machine_code import compiled
from filters.geometry.rotations import matrix_of, product_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import cross_matrix, multiply, put, times, transposed
from filters.motions.model import CAMERA_SIZE, MotionKernels, MotionModel


@compiled
def _at_lever(state: FloatArray, place: FloatArray, sign: float, J: FloatArray) -> None:
    """From the velocity and position of the camera to those of the unit (sign 1), or back (-1), with the Jacobian."""
    R, x, y, z = matrix_of(state[3], state[4], state[5], state[6]), place[0], place[1], place[2]
    s0, s1, s2 = times(cross_matrix(state[10], state[11], state[12]), x, y, z)
    arm, speed, by_arm = times(R, x, y, z), times(R, s0, s1, s2), multiply(R, cross_matrix(x, y, z))
    put(J, 0, 3, by_arm, -sign)
    put(J, 6, 9, by_arm, -sign)
    put(J, 6, 3, multiply(R, cross_matrix(s0, s1, s2)), -sign)
    for i in range(3):
        state[i] += sign * arm[i]
        state[7 + i] += sign * speed[i]


@compiled
def _carry(A: FloatArray, M: FloatArray, product: FloatArray) -> None:
    """product = A M, A being mostly zeros."""
    for i in range(len(A)):
        for j in range(M.shape[1]):
            product[i, j] = 0.0
        for k in range(len(A)):
            if A[i, k] != 0.0:
                for j in range(M.shape[1]):
                    product[i, j] += A[i, k] * M[k, j]


def _step(
    settings: FloatArray,
    state: FloatArray,
    dt: float,
    odometry: FloatArray,
    moved: FloatArray,
    F: FloatArray,
    Q: FloatArray,
) -> None:
    n, m, begin, turned = CAMERA_SIZE, len(F), 0.0, len(F) > 21
    c, a0, a1, a2 = odometry[1], 0.0, 0.0, 0.0
    if turned:
        a0, a1, a2 = state[22], state[23], state[24]
    d0, d1, d2, d3 = quaternion_of(a0, a1, a2)
    C, by_angles = matrix_of(*product_of(d0, d1, d2, d3, c[0], c[1], c[2], c[3])), right_jacobian_of(-a0, -a1, -a2)
    A, J, N = np.eye(n), np.zeros((n, 6)), np.zeros((n, n))
    M, D, E = (
        np.zeros((n, 24)),
        np.zeros((6, 6)),
        np.zeros((6, 3)),
    )  # by the state before, by rates and forces, gravity, angles
    like_M, like_N = np.zeros((n, 24)), np.zeros((n, n))
    put(D, 0, 0, C, -1.0)
    put(D, 3, 3, C, -1.0)
    moved[:] = state
    _at_lever(moved, odometry[0], 1.0, A)
    M[:, :n] = A
    A[:] = 0.0
    for i in range(3):
        A[i, i] = A[6 + i, 6 + i] = J[9 + i, i] = 1.0
    for k in range(3, len(odometry)):
        h = (dt if k == len(odometry) - 1 else odometry[k, 0]) - begin
        begin += h
        w0, w1, w2 = times(C, odometry[k, 1] - state[13], odometry[k, 2] - state[14], odometry[k, 3] - state[15])
        f0, f1, f2 = times(C, odometry[k, 4] - state[16], odometry[k, 5] - state[17], odometry[k, 6] - state[18])
        R = matrix_of(moved[3], moved[4], moved[5], moved[6])
        h0, h1, h2 = 0.5 * h * w0, 0.5 * h * w1, 0.5 * h * w2
        half, turn = matrix_of(*quaternion_of(h0, h1, h2)), quaternion_of(h * w0, h * w1, h * w2)
        R_h, (b0, b1, b2) = multiply(R, half), times(half, f0, f1, f2)
        by_turn = multiply(R, cross_matrix(b0, b1, b2))
        by_rate = multiply(multiply(R_h, cross_matrix(f0, f1, f2)), right_jacobian_of(h0, h1, h2))
        put(A, 3, 3, transposed(matrix_of(*turn)), 1.0)
        put(J, 3, 0, right_jacobian_of(h * w0, h * w1, h * w2), h)
        for row, scale in ((0, 0.5 * h * h), (6, h)):
            put(A, row, 3, by_turn, -scale)
            put(J, row, 0, by_rate, -0.5 * h * scale)
            put(J, row, 3, R_h, scale)
        a = times(R_h, f0, f1, f2)
        for i in range(3):
            A[i, 6 + i], acceleration = h, a[i] + state[19 + i]
            moved[i] += h * moved[7 + i] + 0.5 * h * h * acceleration
            moved[7 + i] += h * acceleration
        moved[3], moved[4], moved[5], moved[6] = product_of(moved[3], moved[4], moved[5], moved[6], *turn)
        moved[10], moved[11], moved[12] = w0, w1, w2
        _carry(A, M, like_M)
        _carry(A, N, like_N)
        M[:], N[:] = like_M, like_N.T
        _carry(A, N, like_N)
        N[:] = like_N
        if turned:
            put(E, 0, 0, multiply(cross_matrix(w0, w1, w2), by_angles), -1.0)
            put(E, 3, 0, multiply(cross_matrix(f0, f1, f2), by_angles), -1.0)
            M[:, 21:] += J @ E
        for i in range(n):
            for j in range(6):
                M[i, 12 + j] += J[i, j]
                variance = J[i, j] * odometry[0, 3 + j // 3] ** 2 / h
                for other in range(n if variance != 0.0 else 0):
                    N[i, other] += variance * J[other, j]
        for i in range(3):
            M[i, 18 + i] += 0.5 * h * h
            M[6 + i, 18 + i] += h
    A[:] = np.eye(n)
    _at_lever(moved, odometry[0], -1.0, A)
    M[:, 12:18] = M[:, 12:18].copy() @ D
    F[:n], Q[:n, :n] = (A @ M)[:, :m], A @ N @ A.T
    for i in range(n, m):
        F[i, i] = 1.0
    for i in range(6):
        Q[12 + i, 12 + i] = odometry[2, i // 3] ** 2 * dt


@dataclass(frozen=True)
class Strapdown(MotionModel):
    """Strapdown integration of inertial samples, with biases and gravity as variables. Needs samples in every step.

    Noise and place of the unit are those that the samples state. Variables: "imu-bias", of the gyros and of the
    accelerometers; "gravity", in W; and with `sigma_mounting` "imu-mounting", a rotation vector in the camera frame.

    Parameters
    ----------
    gravity : (3,) sequence of float
        In W, m/s^2: 9.81 along y where the camera was level at the start.
    sigma_gravity : float
        Standard deviation of each component of that, m/s^2.
    sigma_gyro_bias, sigma_accelerometer_bias : float
        Of the biases at the start, rad/s and m/s^2, each axis.
    sigma_mounting : float
        Of the error of the stated orientation of the unit, rad, each axis; 0: it is exact.
    """

    gravity: tuple[float, float, float] = (0.0, 9.81, 0.0)
    sigma_gravity: float = 0.5
    sigma_gyro_bias: float = 0.01
    sigma_accelerometer_bias: float = 0.1
    sigma_mounting: float = 0.0
    takes: ClassVar[type[InertialSamples]] = InertialSamples
    kernels: ClassVar[MotionKernels | None] = MotionKernels(_step)

    def __post_init__(self) -> None:
        gravity = finite_array("gravity", self.gravity, (3,))
        object.__setattr__(self, "gravity", tuple(gravity.tolist()))
        names = "sigma_gravity", "sigma_gyro_bias", "sigma_accelerometer_bias", "sigma_mounting"
        g, gyro, accelerometer, mounting = (positive(name, getattr(self, name), allow_zero=True) for name in names)
        biases = Variable("imu-bias", np.zeros(6), np.diag(np.repeat([gyro, accelerometer], 3) ** 2))
        variables = [biases, Variable("gravity", gravity, g**2 * np.eye(3), in_world=True)]
        if mounting:
            variables.append(Variable("imu-mounting", np.zeros(3), mounting**2 * np.eye(3)))
        object.__setattr__(self, "variables", tuple(variables))

    def check_odometry(self, odometry: InertialSamples | None) -> None:
        """It needs samples."""
        if odometry is None:
            raise ValueError("inertial must be given in every predict with motion=Strapdown(): pass InertialSamples")

    def odometry_numbers(self, odometry: InertialSamples | None) -> FloatArray:
        """Rows of seven: place and densities; orientation; walks of the biases; then time, rates, forces of samples."""
        if odometry is None:
            return np.zeros((0, 7))
        numbers = np.empty((3 + len(odometry.times), 7))
        numbers[:3], numbers[3:, 0] = odometry.unit.rows, odometry.times
        numbers[3:, 1:4], numbers[3:, 4:] = odometry.angular_rates, odometry.specific_forces
        return numbers
