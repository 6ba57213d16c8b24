"""Kernels of `engine.linearisation`: prediction of measurements and its Jacobian."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, types

from filters import rotations
from filters.engine.kernels.signatures import ANY_MATRIX, FIXED, FLOATS, SEEN
from filters.validation import BoolArray, FloatArray, IntArray

_matrix_of = njit(**FLOATS)(rotations.matrix_of)


@njit(**FLOATS)
def _ray(theta: float, phi: float, ray: FloatArray) -> None:
    """`inverse_depth.ray_direction` and its Jacobian by theta and phi, one after the other in `ray` (9,)."""
    sin_theta, cos_theta, sin_phi, cos_phi = math.sin(theta), math.cos(theta), math.sin(phi), math.cos(phi)
    ray[0], ray[1], ray[2] = cos_phi * sin_theta, -sin_phi, cos_phi * cos_theta
    ray[3], ray[4], ray[5] = cos_phi * cos_theta, 0.0, -cos_phi * sin_theta
    ray[6], ray[7], ray[8] = -sin_phi * sin_theta, -cos_phi, -sin_phi * cos_theta


@njit(**FLOATS)
def _seen(
    position: FloatArray, blocks: FloatArray, anchor: int, parameter: int, ray: FloatArray, seen: FloatArray
) -> None:
    """`LandmarkModel.homogeneous` of one landmark, and its anchor relative to the camera, in `seen` (7,)."""
    if anchor < 0:  # Euclidean
        for i in range(3):
            seen[i] = blocks[parameter, i] - position[i]
        seen[3] = 1.0
        return
    rho = blocks[parameter, 2]
    _ray(blocks[parameter, 0], blocks[parameter, 1], ray)
    for i in range(3):
        seen[4 + i] = blocks[anchor, i] - position[i]
        seen[i] = rho * seen[4 + i] + ray[i]
    seen[3] = rho


@njit(
    types.Tuple(
        (
            types.float64[:, ::1],
            types.float64[:, :, ::1],
            types.float64[:, :, ::1],
            types.int64[:, ::1],
            types.boolean[::1],
        )
    )(*SEEN, ANY_MATRIX),
    **FIXED,
)
def linearise(
    camera: tuple[float, float, float, float, float],
    position: FloatArray,
    orientation: FloatArray,
    blocks: FloatArray,
    anchors: IntArray,
    parameters: IntArray,
    width: int,
    index: IntArray,
    T: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, BoolArray]:
    """`linearisation.linearise` and `in_front`.

    Returns predicted z (M, k), H by camera (M, k, 6) and by map (M, k, w), rows of the map (M, w), ahead (M,).
    """
    fx, fy, cx, cy, disparity_constant = camera
    count, size = len(index), len(T)
    R_wc = np.array(_matrix_of(orientation[0], orientation[1], orientation[2], orientation[3])).reshape(3, 3)
    predicted = np.empty((count, size))
    by_camera = np.empty((count, size, 6))
    by_map = np.empty((count, size, width))
    rows, ahead = np.empty((count, width), np.int64), np.empty(count, np.bool_)
    ray, seen, h, uvd, g = np.empty(9), np.empty(7), np.empty(3), np.empty(3), np.empty(3)
    for m in range(count):
        anchor, parameter = anchors[index[m]], parameters[index[m]]
        _seen(position, blocks, anchor, parameter, ray, seen)
        for i in range(3):
            h[i] = seen[0] * R_wc[0, i] + seen[1] * R_wc[1, i] + seen[2] * R_wc[2, i]
            rows[m, width - 3 + i] = 12 + 3 * parameter + i
            if anchor >= 0:
                rows[m, i] = 12 + 3 * anchor + i
        rho, inverse_z = seen[3], 1.0 / h[2]
        ahead[m] = h[2] > 0.0
        uvd[0] = fx * h[0] * inverse_z + cx
        uvd[1] = fy * h[1] * inverse_z + cy
        uvd[2] = disparity_constant * rho * inverse_z
        for a in range(size):
            predicted[m, a] = T[a, 0] * uvd[0] + T[a, 1] * uvd[1] + T[a, 2] * uvd[2]
            # z by direction in the camera frame (g_c) and in the world (g), and by scale
            by_scale = T[a, 2] * disparity_constant * inverse_z
            g0, g1 = T[a, 0] * fx * inverse_z, T[a, 1] * fy * inverse_z
            g2 = -(g0 * h[0] + g1 * h[1] + by_scale * rho) * inverse_z
            for i in range(3):
                g[i] = R_wc[i, 0] * g0 + R_wc[i, 1] * g1 + R_wc[i, 2] * g2
            # g_c^T [h]x = (g_c x h)^T
            by_camera[m, a, 3] = g1 * h[2] - g2 * h[1]
            by_camera[m, a, 4] = g2 * h[0] - g0 * h[2]
            by_camera[m, a, 5] = g0 * h[1] - g1 * h[0]
            for i in range(3):
                by_camera[m, a, i] = -g[i] if anchor < 0 else -rho * g[i]
                by_map[m, a, i] = -by_camera[m, a, i]
            if anchor >= 0:
                by_map[m, a, 3] = g[0] * ray[3] + g[1] * ray[4] + g[2] * ray[5]
                by_map[m, a, 4] = g[0] * ray[6] + g[1] * ray[7] + g[2] * ray[8]
                by_map[m, a, 5] = g[0] * seen[4] + g[1] * seen[5] + g[2] * seen[6] + by_scale
    return predicted, by_camera, by_map, rows, ahead
