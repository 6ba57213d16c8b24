"""Kernels of `landmarks.inverse_depth`: initialisation of landmarks."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, types

from filters import rotations
from filters.engine.kernels.signatures import ANY_MATRIX, FIXED, FLOATS, INTRINSICS, VECTOR
from filters.validation import FloatArray

_matrix_of = njit(**FLOATS)(rotations.matrix_of)


@njit(
    types.Tuple((types.float64[:, ::1], types.float64[:, :, ::1], types.float64[:, :, ::1]))(
        INTRINSICS, VECTOR, ANY_MATRIX
    ),
    **FIXED,
)
def initialise(
    camera: tuple[float, float, float, float, float], orientation: FloatArray, uvd: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`InverseDepth.initialise`: parameters (M, 3), and their Jacobians by rotation and by measurement (M, 3, 3)."""
    fx, fy, cx, cy, disparity_constant = camera
    R = np.array(_matrix_of(orientation[0], orientation[1], orientation[2], orientation[3])).reshape(3, 3)
    parameters = np.empty((len(uvd), 3))
    by_rotation, by_measurement = np.zeros((len(uvd), 3, 3)), np.zeros((len(uvd), 3, 3))
    angles_by_w = np.empty((2, 3))
    for m in range(len(uvd)):
        h0, h1 = (uvd[m, 0] - cx) / fx, (uvd[m, 1] - cy) / fy
        x = R[0, 0] * h0 + R[0, 1] * h1 + R[0, 2]
        y = R[1, 0] * h0 + R[1, 1] * h1 + R[1, 2]
        z = R[2, 0] * h0 + R[2, 1] * h1 + R[2, 2]
        across_squared = x * x + z * z
        length_squared = across_squared + y * y
        across, length = math.sqrt(across_squared), math.sqrt(length_squared)
        rho_per_d = 1.0 / (disparity_constant * length)
        rho = uvd[m, 2] * rho_per_d
        parameters[m, 0], parameters[m, 1], parameters[m, 2] = math.atan2(x, z), math.atan2(-y, across), rho
        angles_by_w[0, 0], angles_by_w[0, 1], angles_by_w[0, 2] = z / across_squared, 0.0, -x / across_squared
        angles_by_w[1, 0] = x * y / (length_squared * across)
        angles_by_w[1, 1] = -across / length_squared
        angles_by_w[1, 2] = z * y / (length_squared * across)
        for a in range(2):
            w0, w1, w2 = angles_by_w[a, 0], angles_by_w[a, 1], angles_by_w[a, 2]
            g0 = w0 * R[0, 0] + w1 * R[1, 0] + w2 * R[2, 0]
            g1 = w0 * R[0, 1] + w1 * R[1, 1] + w2 * R[2, 1]
            g2 = w0 * R[0, 2] + w1 * R[1, 2] + w2 * R[2, 2]
            # -g^T [h]x = (h x g)^T
            by_rotation[m, a, 0] = h1 * g2 - g1
            by_rotation[m, a, 1] = g0 - h0 * g2
            by_rotation[m, a, 2] = h0 * g1 - h1 * g0
            by_measurement[m, a, 0], by_measurement[m, a, 1] = g0 / fx, g1 / fy
        by_measurement[m, 2, 0] = -rho / length_squared * h0 / fx
        by_measurement[m, 2, 1] = -rho / length_squared * h1 / fy
        by_measurement[m, 2, 2] = rho_per_d
    return parameters, by_rotation, by_measurement
