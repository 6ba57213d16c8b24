"""Strapdown integration of the samples of an inertial unit, with its biases and gravity as variables.

Derivation: docs/derivations/inertial.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from filters.contract.inputs import InertialSamples
from filters.contract.validation import finite_array, positive
from filters.contract.variables import Variable
from filters.geometry.arrays import FloatArray as Array
from filters.geometry.machine_code import compiled
from filters.geometry.rotations import Nine, matrix_of, product_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import IDENTITY, cross_matrix, multiply, put, times, transposed
from filters.motions.motion_model import CAMERA_SIZE, MotionKernels, MotionModel


@compiled
def _at_lever(state: Array, place: Array, sign: float, J: Array) -> None:
    """From the velocity and position of the camera to those of the unit (sign 1), or back (-1), with the Jacobian."""
    R, x, y, z = matrix_of(state[3], state[4], state[5], state[6]), place[0], place[1], place[2]
    s0, s1, s2 = times(cross_matrix(state[10], state[11], state[12]), x, y, z)
    arm, speed, by_arm = times(R, x, y, z), times(R, s0, s1, s2), multiply(R, cross_matrix(x, y, z))
    put(J, 0, 3, by_arm, -sign)
    put(J, 6, 9, by_arm, -sign)
    put(J, 6, 3, multiply(R, cross_matrix(s0, s1, s2)), -sign)
    for i in range(3):
        state[i], state[7 + i] = state[i] + sign * arm[i], state[7 + i] + sign * speed[i]


@compiled
def _carry(M: Array, by_turn: Nine, back: Nine, h: float) -> None:
    """Carry errors, the columns of M, over a sample: the old angular velocity has no effect."""
    for j in range(M.shape[1]):
        x, y, z = M[3, j], M[4, j], M[5, j]
        M[3, j], M[4, j], M[5, j] = times(back, x, y, z)
        for i, turned in enumerate(times(by_turn, x, y, z)):
            M[i, j] += h * (M[6 + i, j] - 0.5 * h * turned)
            M[6 + i, j] -= h * turned
            M[9 + i, j] = 0.0


def _step(settings: Array, state: Array, dt: float, odometry: Array, moved: Array, F: Array, Q: Array) -> None:
    n, begin, mounting = CAMERA_SIZE, 0.0, len(F) > 21
    c, (a0, a1, a2) = odometry[1], (state[22], state[23], state[24]) if mounting else (0.0, 0.0, 0.0)
    d0, d1, d2, d3 = quaternion_of(a0, a1, a2)
    C, by_angles = matrix_of(*product_of(d0, d1, d2, d3, c[0], c[1], c[2], c[3])), right_jacobian_of(-a0, -a1, -a2)
    J, N, A, D, E = np.zeros((n, 6)), np.zeros((n, n)), np.eye(n), np.zeros((6, 6)), np.zeros((6, 3))
    M = np.zeros((n, len(F)))  # by the state before; D, E: rates and forces by the biases, and by the mounting
    put(D, 0, 0, C, -1.0)
    put(D, 3, 3, C, -1.0)
    moved[:] = state
    _at_lever(moved, odometry[0], 1.0, A)
    M[:, :n] = A
    for k in range(3, len(odometry)):
        sample, end = odometry[k], dt if k == len(odometry) - 1 else odometry[k, 0]
        h, begin = end - begin, end
        w0, w1, w2 = times(C, sample[1] - state[13], sample[2] - state[14], sample[3] - state[15])
        f0, f1, f2 = times(C, sample[4] - state[16], sample[5] - state[17], sample[6] - state[18])
        h0, h1, h2, turn = 0.5 * h * w0, 0.5 * h * w1, 0.5 * h * w2, quaternion_of(h * w0, h * w1, h * w2)
        R, half = matrix_of(moved[3], moved[4], moved[5], moved[6]), matrix_of(*quaternion_of(h0, h1, h2))
        R_h, (b0, b1, b2) = multiply(R, half), times(half, f0, f1, f2)
        by_rate = multiply(multiply(R_h, cross_matrix(f0, f1, f2)), right_jacobian_of(h0, h1, h2))
        by_turn, back = multiply(R, cross_matrix(b0, b1, b2)), transposed(matrix_of(*turn))
        put(J, 3, 0, right_jacobian_of(h * w0, h * w1, h * w2), h)
        put(J, 9, 0, IDENTITY, 1.0)
        for row, scale in ((0, 0.5 * h * h), (6, h)):
            put(J, row, 0, by_rate, -0.5 * h * scale)
            put(J, row, 3, R_h, scale)
        a = times(R_h, f0, f1, f2)
        for i in range(3):
            acceleration = a[i] + state[19 + i]
            moved[i] += h * moved[7 + i] + 0.5 * h * h * acceleration
            moved[7 + i] += h * acceleration
        moved[3], moved[4], moved[5], moved[6] = product_of(moved[3], moved[4], moved[5], moved[6], *turn)
        moved[10], moved[11], moved[12] = w0, w1, w2
        _carry(M, by_turn, back, h)
        _carry(N, by_turn, back, h)
        _carry(N.T, by_turn, back, h)
        if mounting:
            put(E, 0, 0, multiply(cross_matrix(w0, w1, w2), by_angles), -1.0)
            put(E, 3, 0, multiply(cross_matrix(f0, f1, f2), by_angles), -1.0)
            M[:, 21:] += J @ E
        for i in range(3):
            M[i, 18 + i] += 0.5 * h * h
            M[6 + i, 18 + i] += h
        M[:, 12:18] += J
        J[:, :3] *= odometry[0, 3] / np.sqrt(h)
        J[:, 3:] *= odometry[0, 4] / np.sqrt(h)
        N += J @ J.T
    A[:] = np.eye(n)
    _at_lever(moved, odometry[0], -1.0, A)
    M[:, 12:18] = M[:, 12:18].copy() @ D
    F[:], Q[:n, :n] = np.eye(len(F)), A @ N @ A.T
    F[:n] = A @ M
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

    def odometry_numbers(self, odometry: InertialSamples | None) -> Array:
        """Rows of seven: place and densities; orientation; walks of the biases; then time, rates, forces of samples."""
        if odometry is None:
            return np.zeros((0, 7))
        samples = np.column_stack([odometry.times, odometry.angular_rates, odometry.specific_forces])
        return np.vstack([odometry.unit.rows, samples])
