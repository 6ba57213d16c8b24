"""What a stranger writes against the public face alone: an inertial motion, a landmark on S^3, a camera, a window.

None of it is known to the engine; `test_stranger.py` checks, drives and times it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from filters import (
    BodyVelocity,
    CameraState,
    LandmarkModel,
    MeasurementModel,
    MotionModel,
    MotionPrediction,
    StereoCamera,
    Variable,
)


def skew(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def right_jacobian(phi: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(phi)
    if angle < 1e-6:
        return np.eye(3) - 0.5 * skew(phi)
    K = skew(phi) / angle
    return np.eye(3) - (1 - np.cos(angle)) / angle * K + (1 - np.sin(angle) / angle) * K @ K


def _number(name: str, value: object, low: float, high: float) -> None:
    if not isinstance(value, int | float) or not low <= value <= high or not np.isfinite(value):
        raise ValueError(f"{name} must be a finite number from {low} to {high}, got {value!r}")


@dataclass(frozen=True, eq=False)
class ImuStep(BodyVelocity):
    """Odometry that brings samples (K, 6) of gyro, rad/s, and accelerometer, m/s^2, camera frame, in equal times."""

    samples: np.ndarray = None  # type: ignore[assignment]


BIASES = Variable(
    "imu-bias", np.zeros(6), np.diag([1e-2] * 3 + [5e-2] * 3) ** 2, random_walk=np.repeat([2e-5, 3e-3], 3)
)
AT_REST = np.tile([0.0, 0.1, 0.0, 0.0, -9.8, 0.0], (4, 1))
GRAVITY = Variable("gravity", [0.0, 9.81, 0.0], 1e-4 * np.eye(3), in_world=True)


@dataclass(frozen=True)
class Strapdown(MotionModel):
    """Strapdown integration, midpoint attitude; biases and gravity are variables."""

    gyro_density: float = 1.7e-4
    accelerometer_density: float = 2e-3
    variables: tuple[Variable, ...] = (BIASES, GRAVITY)

    def __post_init__(self) -> None:
        for name in ("gyro_density", "accelerometer_density"):
            _number(name, getattr(self, name), 0.0, np.inf)

    def check_odometry(self, odometry: BodyVelocity | None) -> None:
        """Samples are needed."""
        if not isinstance(odometry, ImuStep):
            raise ValueError(f"odometry must be an ImuStep with motion=Strapdown(), got {type(odometry).__name__}")

    def predict(self, state: CameraState, dt: float, odometry: BodyVelocity | None) -> MotionPrediction:
        """Step by step, with the Jacobians of each."""
        samples = odometry.samples if isinstance(odometry, ImuStep) else AT_REST
        bias, g, h = state.variables["imu-bias"], state.variables["gravity"], dt / len(samples)
        p, R, v = state.position, Rotation.from_quat(state.orientation).as_matrix(), state.linear_velocity
        F, Q, rate = np.eye(21), np.zeros((21, 21)), state.angular_velocity
        densities = np.diag(np.repeat([self.gyro_density**2 / h, self.accelerometer_density**2 / h], 3))
        for sample in samples:
            rate, force = sample[:3] - bias[:3], sample[3:] - bias[3:]
            half, turn = Rotation.from_rotvec(0.5 * h * rate).as_matrix(), Rotation.from_rotvec(h * rate).as_matrix()
            R_h = R @ half
            a = R_h @ force + g
            A, J = np.eye(21), right_jacobian(h * rate)
            by_rotation = -R @ skew(half @ force)
            by_gyro = 0.5 * h * R_h @ skew(force) @ right_jacobian(0.5 * h * rate)
            for rows, scale in ((slice(0, 3), 0.5 * h * h), (slice(6, 9), h)):
                A[rows, 3:6] = scale * by_rotation
                A[rows, 12:15], A[rows, 15:18], A[rows, 18:] = scale * by_gyro, -scale * R_h, scale * np.eye(3)
            A[:3, 6:9] = h * np.eye(3)
            A[3:6, 3:6], A[3:6, 12:15] = turn.T, -h * J
            A[9:12, 9:12], A[9:12, 12:15] = 0.0, -np.eye(3)
            G = -A[:, 12:18].copy()
            G[12:18] = 0.0
            F, Q = A @ F, A @ Q @ A.T + G @ densities @ G.T
            p, v, R = p + h * v + 0.5 * h * h * a, v + h * a, R @ turn
        moved = CameraState(p, Rotation.from_matrix(R).as_quat(), v, rate, state.variables)
        return MotionPrediction(moved, F, np.eye(21), 0.5 * (Q + Q.T))


@dataclass(frozen=True)
class OnS3(LandmarkModel):
    """A homogeneous point on the unit sphere S^3 in W, without an anchor: regular at infinity."""

    value_size = 4

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


@dataclass(frozen=True)
class DoubleSphere(MeasurementModel):
    """A pair of double-sphere cameras (Usenko et al. 2018) with parallel axes; numbers (u, v, u - u_right), v_right."""

    xi: float = -0.2
    alpha: float = 0.55
    size = 4

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
