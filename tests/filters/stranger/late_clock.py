"""A stranger's camera whose clock is late by an unknown time: a measurement that depends on the velocity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from filters import MeasurementKernels, MeasurementModel, StereoCamera, Variable
from filters.geometry.three_by_three import times

OFFSET = Variable("time-offset", [0.0], [[0.015**2]])


def _predict(settings, camera, points, values, numbers, J, J_values, in_front):
    tau, v0, v1, v2, w0, w1, w2 = values[0], values[1], values[2], values[3], values[4], values[5], values[6]
    by_point = np.zeros((3, 4))
    for i in range(len(points)):
        x, y, z, s = points[i, 0], points[i, 1], points[i, 2], points[i, 3]
        m0, m1, m2 = w1 * z - w2 * y + s * v0, w2 * x - w0 * z + s * v1, w0 * y - w1 * x + s * v2
        inverse = 1.0 / (z - tau * m2)
        fx, fy, fb = camera[0] * inverse, camera[1] * inverse, camera[0] * camera[4] * inverse
        u, v, d = fx * (x - tau * m0), fy * (y - tau * m1), fb * s
        numbers[i, 0], numbers[i, 1], numbers[i, 2] = u + camera[2], v + camera[3], d
        in_front[i] = z > 0.0
        by_point[0, 0], by_point[1, 1], by_point[2, 3] = fx, fy, fb
        by_point[0, 2], by_point[1, 2], by_point[2, 2] = -u * inverse, -v * inverse, -d * inverse
        for k in range(3):
            g0, g1, g2 = by_point[k, 0], by_point[k, 1], by_point[k, 2]
            J[i, k, 0] = g0 - tau * (g1 * w2 - g2 * w1)
            J[i, k, 1] = g1 - tau * (g2 * w0 - g0 * w2)
            J[i, k, 2] = g2 - tau * (g0 * w1 - g1 * w0)
            J[i, k, 3] = by_point[k, 3] - tau * (g0 * v0 + g1 * v1 + g2 * v2)
            J_values[i, k, 0] = -(g0 * m0 + g1 * m1 + g2 * m2)
            J_values[i, k, 1], J_values[i, k, 2], J_values[i, k, 3] = -tau * s * g0, -tau * s * g1, -tau * s * g2
            J_values[i, k, 4] = tau * (g1 * z - g2 * y)
            J_values[i, k, 5] = tau * (g2 * x - g0 * z)
            J_values[i, k, 6] = tau * (g0 * y - g1 * x)


def _backproject(settings, camera, uvd, values, points, J, J_values):
    tau, v0, v1, v2, w0, w1, w2 = values[0], values[1], values[2], values[3], values[4], values[5], values[6]
    a0, a1, a2 = tau * w0, tau * w1, tau * w2
    below = 1.0 / (1.0 + a0 * a0 + a1 * a1 + a2 * a2)  # (I - [a]x)^-1 = (I + [a]x + a a^T) / (1 + a^T a)
    first = (1.0 + a0 * a0) * below, (a0 * a1 - a2) * below, (a0 * a2 + a1) * below
    second = (a0 * a1 + a2) * below, (1.0 + a1 * a1) * below, (a1 * a2 - a0) * below
    third = (a0 * a2 - a1) * below, (a1 * a2 + a0) * below, (1.0 + a2 * a2) * below
    M = (*first, *second, *third)
    for i in range(len(uvd)):
        s, fx, fy = uvd[i, 2] / (camera[0] * camera[4]), camera[0], camera[1]
        h0, h1 = (uvd[i, 0] - camera[2]) / fx + tau * s * v0, (uvd[i, 1] - camera[3]) / fy + tau * s * v1
        x, y, z = times(M, h0, h1, 1.0 + tau * s * v2)
        points[i, 0], points[i, 1], points[i, 2], points[i, 3] = x, y, z, s
        by_s = times(M, tau * v0, tau * v1, tau * v2)
        by_tau = times(M, w1 * z - w2 * y + s * v0, w2 * x - w0 * z + s * v1, w0 * y - w1 * x + s * v2)
        by_w = times(M, 0.0, -z, y), times(M, z, 0.0, -x), times(M, -y, x, 0.0)
        J[i, 3, 2] = 1.0 / (camera[0] * camera[4])
        for r in range(3):
            J[i, r, 0], J[i, r, 1], J[i, r, 2] = M[3 * r] / fx, M[3 * r + 1] / fy, by_s[r] * J[i, 3, 2]
            J_values[i, r, 0] = by_tau[r]
            for c in range(3):
                J_values[i, r, 1 + c], J_values[i, r, 4 + c] = tau * s * M[3 * r + c], tau * by_w[c][r]


@dataclass(frozen=True)
class LateClock(MeasurementModel):
    """(u, v, d) of where the points are `time-offset` seconds after the time of the state, at constant velocity."""

    variables: tuple[Variable, ...] = (OFFSET,)
    sees_velocity = True
    kernels = MeasurementKernels(_predict, _backproject)

    def predict(self, camera: StereoCamera, points_c: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """The points move by -(w x p + v) a second."""
        tau, v, w = values["time-offset"][0], values["velocity"][:3], values["velocity"][3:]
        h, s = points_c[..., :3], points_c[..., 3]
        return camera.project_scaled(h - tau * (np.cross(w, h) + s[..., None] * v), s)

    def backproject(self, camera: StereoCamera, uvd: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """The same, solved for the point."""
        tau, v, w = values["time-offset"][0], values["velocity"][:3], values["velocity"][3:]
        s = uvd[:, 2:] / camera.disparity_constant
        A = np.eye(3) + tau * np.cross(np.eye(3), w).T
        return np.hstack([np.linalg.solve(A, (camera.ray(uvd) + tau * s * v).T).T, s])
