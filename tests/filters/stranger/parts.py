"""What a stranger writes against the public face alone: a landmark on S^3 and a double-sphere camera.

None of it is known to the engine; `test_stranger.py` checks, drives and times it, with the inertial motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit

from filters import LandmarkKernels, LandmarkModel, MeasurementKernels, MeasurementModel, StereoCamera
from filters.geometry.rotations import matrix_of, quaternion_of, right_jacobian_of
from filters.geometry.three_by_three import times


def _number(name: str, value: object, low: float, high: float) -> None:
    if not isinstance(value, int | float) or not low <= value <= high or not np.isfinite(value):
        raise ValueError(f"{name} must be a finite number from {low} to {high}, got {value!r}")


def _s3_point(settings, values, points, J):
    for i in range(len(values)):
        for c in range(3):
            b = _column(values[i], c)
            for r in range(4):
                points[i, r], J[i, r, c] = values[i, r], b[r]


def _s3_start(settings, points, values, J, possible):
    for i in range(len(points)):
        square = 0.0
        for r in range(4):
            square += points[i, r] ** 2
        norm = np.sqrt(square)
        for r in range(4):
            values[i, r] = points[i, r] / norm
        for c in range(3):
            b = _column(values[i], c)
            for r in range(4):
                J[i, c, r] = b[r] / norm
        possible[i] = True


@njit
def _column(q, c):
    """q i, q j or q k of the quaternion q."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    if c == 0:
        return w, z, -y, -x
    return (-z, w, x, -y) if c == 1 else (y, -x, w, -z)


def _s3_rotation(settings, values, effect):
    for i in range(len(values)):
        x, y, z = values[i, 0], values[i, 1], values[i, 2]
        for c in range(3):
            b = _column(values[i], c)  # b . (e x q) = e . (q x b)
            effect[i, c, 0], effect[i, c, 1] = y * b[2] - z * b[1], z * b[0] - x * b[2]
            effect[i, c, 2] = x * b[1] - y * b[0]


def _s3_turn(settings, values, theta, correction, moved, J, J_theta):
    q0, q1, q2, q3 = quaternion_of(theta[0], theta[1], theta[2])
    R, spread = matrix_of(q0, q1, q2, q3), right_jacobian_of(-theta[0], -theta[1], -theta[2])
    by_delta, there = np.zeros((4, 3)), np.zeros(4)
    for i in range(len(values)):
        q, e = values[i], correction[i]
        square = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
        angle = np.sqrt(square)
        sinc, slope = 1.0 - square / 6.0, -1.0 / 3.0 + square / 30.0
        if angle > 1e-3:
            sinc = np.sin(angle) / angle
            slope = (np.cos(angle) - sinc) / square
        b = _column(q, 0), _column(q, 1), _column(q, 2)
        for r in range(4):
            along = b[0][r] * e[0] + b[1][r] * e[1] + b[2][r] * e[2]
            there[r] = np.cos(angle) * q[r] + sinc * along
            for c in range(3):
                by_delta[r, c] = sinc * (b[c][r] - q[r] * e[c]) + slope * along * e[c]
        x, y, z = times(R, there[0], there[1], there[2])
        moved[i, 0], moved[i, 1], moved[i, 2], moved[i, 3] = x, y, z, there[3]
        for a in range(3):
            f = _column(moved[i], a)
            for c in range(3):
                d0, d1, d2 = times(R, by_delta[0, c], by_delta[1, c], by_delta[2, c])
                J[i, a, c] = f[0] * d0 + f[1] * d1 + f[2] * d2 + f[3] * by_delta[3, c]
            t0, t1, t2 = y * f[2] - z * f[1], z * f[0] - x * f[2], x * f[1] - y * f[0]
            for c in range(3):
                J_theta[i, a, c] = t0 * spread[c] + t1 * spread[3 + c] + t2 * spread[6 + c]


@dataclass(frozen=True)
class OnS3(LandmarkModel):
    """A homogeneous point on the unit sphere S^3 in W, without an anchor: regular at infinity."""

    value_size = 4
    kernels = LandmarkKernels(_s3_point, _s3_start, _s3_turn, _s3_rotation)

    def parameters_of(self, position, h_w, scale):
        """(h_w + scale r, scale), normalised."""
        point = np.column_stack([h_w + scale[:, None] * position, scale])
        return point / np.linalg.norm(point, axis=1, keepdims=True)

    def homogeneous(self, position, anchors, parameters):
        """(x - w r, w)."""
        return np.hstack([parameters[:, :3] - parameters[:, 3:] * position, parameters[:, 3:]])

    def rotated(self, anchors, parameters, R):
        """The first three numbers turn."""
        return np.hstack([parameters[:, :3] @ R.T, parameters[:, 3:]])

    def shifted(self, parameters, shift):
        """(x + w shift, w), normalised."""
        point = np.hstack([parameters[:, :3] + parameters[:, 3:] * shift, parameters[:, 3:]])
        return point / np.linalg.norm(point, axis=1, keepdims=True)

    def retract(self, parameters, delta):
        """Along the great circle of the basis."""
        tangent = (self._basis(parameters) @ delta[..., None])[..., 0]
        angle = np.linalg.norm(tangent, axis=1, keepdims=True)
        return np.cos(angle) * parameters + np.sinc(angle / np.pi) * tangent

    def local(self, parameters, other):
        """The way back, in the basis."""
        cosine = np.sum(parameters * other, axis=1, keepdims=True)
        across = other - cosine * parameters
        sine = np.linalg.norm(across, axis=1, keepdims=True)
        longer = np.divide(np.arctan2(sine, cosine), sine, out=np.ones_like(sine), where=sine > 0)
        return np.einsum("mij,mi->mj", self._basis(parameters), longer * across)

    @staticmethod
    def _basis(q: np.ndarray) -> np.ndarray:
        """q i, q j, q k of the quaternion q: smooth everywhere; (M, 4, 3)."""
        x, y, z, w = q.T
        columns = [[w, z, -y, -x], [-z, w, x, -y], [y, -x, w, -z]]
        return np.stack([np.stack(column, axis=1) for column in columns], axis=2)


@njit
def _pixel(xi, alpha, x, y, z):
    """x and y over what is below the fraction, and their Jacobians by the direction."""
    d1 = np.sqrt(x * x + y * y + z * z)
    z1 = xi * d1 + z
    d2 = np.sqrt(x * x + y * y + z1 * z1)
    below = alpha * d2 + (1.0 - alpha) * z1
    z_x, z_y, z_z = xi * x / d1, xi * y / d1, xi * z / d1 + 1.0
    b_x = alpha * (x + z1 * z_x) / d2 + (1.0 - alpha) * z_x
    b_y = alpha * (y + z1 * z_y) / d2 + (1.0 - alpha) * z_y
    b_z = alpha * z1 * z_z / d2 + (1.0 - alpha) * z_z
    u, v = x / below, y / below
    return (
        u,
        v,
        (1.0 - u * b_x) / below,
        -u * b_y / below,
        -u * b_z / below,
        -v * b_x / below,
        (1.0 - v * b_y) / below,
        -v * b_z / below,
    )


def _predict(settings, camera, points, values, numbers, J, J_values, in_front):
    xi, alpha, fx, fy, b = settings[0], settings[1], camera[0], camera[1], camera[4]
    for i in range(len(points)):
        x, y, z, scale = points[i, 0], points[i, 1], points[i, 2], points[i, 3]
        left, right = _pixel(xi, alpha, x, y, z), _pixel(xi, alpha, x - scale * b, y, z)
        numbers[i, 0], numbers[i, 1] = fx * left[0] + camera[2], fy * left[1] + camera[3]
        numbers[i, 2], numbers[i, 3] = fx * (left[0] - right[0]), fy * right[1] + camera[3]
        for k in range(3):
            J[i, 0, k], J[i, 1, k] = fx * left[2 + k], fy * left[5 + k]
            J[i, 2, k], J[i, 3, k] = fx * (left[2 + k] - right[2 + k]), fy * right[5 + k]
        J[i, 2, 3], J[i, 3, 3] = fx * b * right[2], -fy * b * right[5]
        in_front[i] = z > 0.1 * np.sqrt(x * x + y * y + z * z)


@njit
def _point(xi, alpha, camera, u, v, d):
    """The left ray by the inverse of the model, the scale by Newton's method on the right column."""
    x, y = (u - camera[2]) / camera[0], (v - camera[3]) / camera[1]
    r2 = x * x + y * y
    mz = (1 - alpha * alpha * r2) / (alpha * np.sqrt(1 - (2 * alpha - 1) * r2) + 1 - alpha)
    k = (mz * xi + np.sqrt(mz * mz + (1 - xi * xi) * r2)) / (mz * mz + r2)
    x, y, z, b = k * x, k * y, k * mz - xi, camera[4]
    scale = d / (camera[0] * b)
    for _ in range(8):
        right = _pixel(xi, alpha, x - scale * b, y, z)
        scale += (right[0] - (u - d - camera[2]) / camera[0]) / (b * right[2])
    return x, y, z, scale


def _backproject(settings, camera, uvd, values, points, J, J_values):
    step = 1e-3  # px
    for i in range(len(uvd)):
        u, v, d = uvd[i, 0], uvd[i, 1], uvd[i, 2]
        points[i, 0], points[i, 1], points[i, 2], points[i, 3] = _point(settings[0], settings[1], camera, u, v, d)
        for c in range(3):
            e0, e1, e2 = step if c == 0 else 0.0, step if c == 1 else 0.0, step if c == 2 else 0.0
            after = _point(settings[0], settings[1], camera, u + e0, v + e1, d + e2)
            before = _point(settings[0], settings[1], camera, u - e0, v - e1, d - e2)
            for r in range(4):
                J[i, r, c] = (after[r] - before[r]) / (2 * step)


@dataclass(frozen=True)
class AnchoredOnS3(OnS3):
    """The same with the place of the first sight as its origin."""

    anchored = True

    def parameters_of(self, position, h_w, scale):
        """(h_w, scale), normalised."""
        return super().parameters_of(np.zeros(3), h_w, scale)

    def homogeneous(self, position, anchors, parameters):
        """(x + w (anchor - r), w)."""
        return super().homogeneous(position - anchors, None, parameters)


@dataclass(frozen=True)
class DoubleSphere(MeasurementModel):
    """A pair of double-sphere cameras (Usenko et al. 2018) with parallel axes; numbers (u, v, u - u_right), v_right."""

    xi: float = -0.2
    alpha: float = 0.55
    size = 4
    kernels = MeasurementKernels(_predict, _backproject, settings=("xi", "alpha"))

    def __post_init__(self) -> None:
        _number("xi", self.xi, -1.0, 1.0)
        _number("alpha", self.alpha, 0.0, 1.0)

    def _pixels(self, camera: StereoCamera, d: np.ndarray) -> np.ndarray:
        d1 = np.linalg.norm(d, axis=-1)
        z1 = self.xi * d1 + d[..., 2]
        d2 = np.sqrt(d[..., 0] ** 2 + d[..., 1] ** 2 + z1**2)
        below = self.alpha * d2 + (1.0 - self.alpha) * z1
        return d[..., :2] / below[..., None] * [camera.fx, camera.fy] + [camera.cx, camera.cy]

    def predict(self, camera: StereoCamera, points_c: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """Both pixels; the right camera sees direction - scale (baseline, 0, 0)."""
        left = self._pixels(camera, points_c[..., :3])
        right = self._pixels(camera, points_c[..., :3] - points_c[..., 3:] * [camera.baseline, 0.0, 0.0])
        return np.concatenate([left, left[..., :1] - right[..., :1], right[..., 1:]], axis=-1)

    def backproject(self, camera: StereoCamera, uvd: np.ndarray, values: Mapping[str, np.ndarray]) -> np.ndarray:
        """The left ray by the inverse of the model, the scale by Newton's method on the right column."""
        m = (uvd[:, :2] - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
        r2, a = np.sum(m**2, axis=1), self.alpha
        mz = (1 - a * a * r2) / (a * np.sqrt(1 - (2 * a - 1) * r2) + 1 - a)
        k = (mz * self.xi + np.sqrt(mz**2 + (1 - self.xi**2) * r2)) / (mz**2 + r2)
        ray = k[:, None] * np.column_stack([m, mz]) - [0.0, 0.0, self.xi]
        scale, step = uvd[:, 2] / camera.disparity_constant, 1e-6
        for _ in range(8):
            ahead, behind = (
                self._pixels(camera, ray - np.outer(s, [camera.baseline, 0.0, 0.0]))[:, 0]
                for s in (scale + step, scale - step)
            )
            here = self._pixels(camera, ray - np.outer(scale, [camera.baseline, 0.0, 0.0]))[:, 0]
            scale = scale - (here - (uvd[:, 0] - uvd[:, 2])) * 2 * step / (ahead - behind)
        return np.column_stack([ray, scale])

    def in_front(self, points_c: np.ndarray) -> np.ndarray:
        """Where the projection is one-to-one, with some room."""
        return points_c[:, 2] > 0.1 * np.linalg.norm(points_c[:, :3], axis=1)
