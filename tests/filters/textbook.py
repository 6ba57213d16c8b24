"""A second implementation of the three filters, written from the paper and from nothing else.

Dense matrices, a Python loop over landmarks, 13 numbers for the camera (additive quaternion), Eq. 4-25 as printed
where they are right, Joseph form. Jacobians are complex-step derivatives of the equations, exact to rounding, so no
formula of the package is repeated. Slow; only good as a reference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from filters import StereoCamera, StereoObservation

R_WC, Q_WC, V_W, OMEGA_C = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
CAMERA_STATE = 13
LEFT_EYE = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
RIGHT_EYE = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def complex_step_jacobian(function: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Jacobian of an analytic function at x."""
    step = 1e-30
    return np.stack([function(x + 1j * step * e).imag / step for e in np.eye(len(x))], axis=-1)


def atan2(y: complex, x: complex) -> complex:
    """Continue the arctangent analytically, which numpy's does not."""
    slope = (x.real * y.imag - y.real * x.imag) / (x.real**2 + y.real**2)
    return np.arctan2(y.real, x.real) + 1j * slope


def quaternion_product(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton product, xyzw."""
    vector = p[3] * q[:3] + q[3] * p[:3] + np.cross(p[:3], q[:3])
    return np.append(vector, p[3] * q[3] - p[:3] @ q[:3])


def quaternion_of(rotation_vector: np.ndarray) -> np.ndarray:
    """q(phi) of Eq. 6."""
    angle = np.sqrt(rotation_vector @ rotation_vector)
    if abs(angle) < 1e-14:
        return np.append(0.5 * rotation_vector, 1.0)
    return np.append(np.sin(angle / 2) / angle * rotation_vector, np.cos(angle / 2))


def rotation_matrix(q: np.ndarray) -> np.ndarray:
    """R^WC of a unit quaternion xyzw."""
    x, y, z, w = q
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def motion(x: np.ndarray, noise: np.ndarray, dt: float) -> np.ndarray:
    """f_v of Eq. 6, noise = (V, Omega)."""
    v, omega = x[V_W] + noise[:3], x[OMEGA_C] + noise[3:]
    return np.concatenate([x[R_WC] + v * dt, quaternion_product(x[Q_WC], quaternion_of(omega * dt)), v, omega])


def point_of_inverse_depth(y: np.ndarray) -> np.ndarray:
    """Eq. 4 and 5."""
    theta, phi, rho = y[3:]
    m = np.array([np.cos(phi) * np.sin(theta), -np.sin(phi), np.cos(phi) * np.cos(theta)])
    return y[:3] + m / rho


def project(camera: StereoCamera, pose: np.ndarray, point_w: np.ndarray) -> np.ndarray:
    """Eq. 9 and 10; pose = (r, q)."""
    h = rotation_matrix(pose[3:]).T @ (point_w - pose[:3])
    return np.array(
        [h[0] / h[2] * camera.fx + camera.cx, h[1] / h[2] * camera.fy + camera.cy, camera.fx * camera.baseline / h[2]]
    )


def triangulate(camera: StereoCamera, z: np.ndarray) -> np.ndarray:
    """h^C of Eq. 21, for unequal focal lengths too; behind the camera where d < 0."""
    u, v, d = z
    depth = camera.fx * camera.baseline / d
    return np.array([(u - camera.cx) / camera.fx * depth, (v - camera.cy) / camera.fy * depth, depth])


def new_inverse_depth(camera: StereoCamera, pose: np.ndarray, z: np.ndarray) -> np.ndarray:
    """G of Eq. 19-24."""
    h_c = triangulate(camera, z)
    h_w = rotation_matrix(pose[3:]) @ h_c
    theta = atan2(h_w[0], h_w[2])
    phi = atan2(-h_w[1], np.sqrt(h_w[0] ** 2 + h_w[2] ** 2))
    return np.concatenate([pose[:3], [theta, phi, 1 / np.sqrt(h_c @ h_c)]])


def new_euclidean(camera: StereoCamera, pose: np.ndarray, z: np.ndarray) -> np.ndarray:
    """X = r + R h^C."""
    return pose[:3] + rotation_matrix(pose[3:]) @ triangulate(camera, z)


def rotation_tangent(q: np.ndarray) -> np.ndarray:
    """Map a rotation error (3) to dq (4): dq = q x (delta / 2, 0)."""
    return np.stack([quaternion_product(q, np.append(0.5 * e, 0.0)) for e in np.eye(3)], axis=-1)


@dataclass
class TextbookEKF:
    """EKF-SLAM of the paper, dense.

    `x` is 13 numbers of the camera, then 6 (inverse depth) or 3 (XYZ) a landmark, in the order of `ids`.
    """

    camera: StereoCamera
    R: np.ndarray
    inverse_depth: bool = True
    sequential: bool = False
    sigma_acceleration: float = 3.0
    sigma_angular_acceleration: float = 0.6

    def reset(self, linear_velocity: np.ndarray, covariance: np.ndarray) -> None:
        """Start at the origin; covariance (12, 12) as in `StereoFilter.reset`."""
        self.ids: list[int] = []
        self.x = np.concatenate([np.zeros(3), [0.0, 0.0, 0.0, 1.0], linear_velocity, np.zeros(3)])
        lift = self._from_error()
        self.P = lift @ covariance @ lift.T

    def predict(self, dt: float) -> None:
        """Eq. 11 and 12."""
        x_c, zero = self.x[:CAMERA_STATE], np.zeros(6)
        F = np.eye(len(self.x))
        F[:CAMERA_STATE, :CAMERA_STATE] = complex_step_jacobian(lambda x: motion(x, zero, dt), x_c)
        G = np.zeros((len(self.x), 6))
        G[:CAMERA_STATE] = complex_step_jacobian(lambda n: motion(x_c, n, dt), zero)
        sigmas = np.repeat([self.sigma_acceleration * dt, self.sigma_angular_acceleration * dt], 3)
        self.P = F @ self.P @ F.T + G @ np.diag(sigmas**2) @ G.T
        self.x = np.concatenate([motion(x_c, zero, dt), self.x[CAMERA_STATE:]])
        self._normalise()

    def update(self, observation: StereoObservation) -> None:
        """Known landmarks correct the state, unseen ones leave, new ones enter."""
        seen = dict(zip(observation.ids.tolist(), observation.uvd, strict=True))
        known = sorted(i for i in seen if i in self.ids)
        for T in (LEFT_EYE, RIGHT_EYE[:1]) if self.sequential else (np.eye(3),):
            if known:
                self._correct(known, np.concatenate([T @ seen[i] for i in known]), T)
        self.keep([i for i in self.ids if i in seen])
        for i in sorted(set(seen) - set(known)):
            self._add(i, seen[i])

    def keep(self, ids: list[int]) -> None:
        """Marginalise every other landmark out."""
        rows = np.concatenate([np.arange(CAMERA_STATE), *[self._rows(i) for i in ids]])
        self.x, self.P, self.ids = self.x[rows], self.P[np.ix_(rows, rows)], ids

    def error_covariance(self) -> np.ndarray:
        """P with the quaternion's four numbers replaced by the three of the rotation error."""
        from_error = self._from_error()
        to_error = np.linalg.pinv(from_error)
        n = len(self.x) - CAMERA_STATE
        M = np.block([[to_error, np.zeros((12, n))], [np.zeros((n, CAMERA_STATE)), np.eye(n)]])
        return M @ self.P @ M.T

    def landmark(self, identity: int) -> np.ndarray:
        """Its 6 or 3 numbers."""
        return self.x[self._rows(identity)]

    def _size(self) -> int:
        return 6 if self.inverse_depth else 3

    def _rows(self, identity: int) -> np.ndarray:
        return CAMERA_STATE + self._size() * self.ids.index(identity) + np.arange(self._size())

    def _from_error(self) -> np.ndarray:
        lift = np.zeros((CAMERA_STATE, 12))
        lift[R_WC, :3] = np.eye(3)
        lift[Q_WC, 3:6] = rotation_tangent(self.x[Q_WC])
        lift[7:, 6:] = np.eye(6)
        return lift

    def _predict_measurement(self, x: np.ndarray, known: list[int], T: np.ndarray) -> np.ndarray:
        predicted = []
        for i in known:
            y = x[self._rows(i)]
            point = point_of_inverse_depth(y) if self.inverse_depth else y
            predicted.append(T @ project(self.camera, x[:7], point))
        return np.concatenate(predicted)

    def _correct(self, known: list[int], z: np.ndarray, T: np.ndarray) -> None:
        H = complex_step_jacobian(lambda x: self._predict_measurement(x, known, T), self.x)
        R = np.kron(np.eye(len(known)), T @ self.R @ T.T)
        S = H @ self.P @ H.T + R
        K = self.P @ H.T @ np.linalg.inv(S)
        I_KH = np.eye(len(self.x)) - K @ H
        self.x = self.x + K @ (z - self._predict_measurement(self.x, known, T))
        self.P = I_KH @ self.P @ I_KH.T + K @ R @ K.T
        self._normalise()

    def _normalise(self) -> None:
        """Divide the quaternion by its norm and carry P along."""
        q = self.x[Q_WC]
        J = np.eye(len(self.x))
        J[Q_WC, Q_WC] = complex_step_jacobian(lambda p: p / np.sqrt(p @ p), q)
        self.x = self.x.copy()
        self.x[Q_WC] = q / np.linalg.norm(q)
        self.P = J @ self.P @ J.T

    def _add(self, identity: int, z: np.ndarray) -> None:
        """Eq. 19-25, with the cross-covariances to the whole old state."""
        g = new_inverse_depth if self.inverse_depth else new_euclidean
        pose = self.x[:7]
        J_x = np.zeros((self._size(), len(self.x)))
        J_x[:, :7] = complex_step_jacobian(lambda p: g(self.camera, p, z), pose)
        J_R = complex_step_jacobian(lambda m: g(self.camera, pose, m), z)
        cross = J_x @ self.P
        self.P = np.block([[self.P, cross.T], [cross, cross @ J_x.T + J_R @ self.R @ J_R.T]])
        self.x = np.concatenate([self.x, g(self.camera, pose, z).real])
        self.ids = [*self.ids, identity]


@dataclass
class WithOwnErrors(TextbookEKF):
    """With numbers e of each landmark's own behind its six, which is measured at z + own e.

    They are independent of all else at first, with a covariance to which they return where they are forgotten.
    """

    own: np.ndarray = field(default_factory=lambda: np.eye(3))
    covariance: np.ndarray = field(default_factory=lambda: np.eye(3))
    memory: float = np.inf

    def predict(self, dt: float) -> None:
        """Own errors go back to zero, and to their variance."""
        super().predict(dt)
        kept, decay, fresh = np.exp(-dt / self.memory), np.ones(len(self.x)), np.zeros_like(self.P)
        for i in self.ids:
            rows = self._rows(i)[6:]
            decay[rows] = kept
            fresh[np.ix_(rows, rows)] = (1.0 - kept**2) * self.covariance
        self.x = decay * self.x
        self.P = decay[:, None] * self.P * decay + fresh

    def _size(self) -> int:
        return 6 + self.own.shape[1]

    def _predict_measurement(self, x: np.ndarray, known: list[int], T: np.ndarray) -> np.ndarray:
        told = []
        for i in known:
            y = x[self._rows(i)]
            told.append(project(self.camera, x[:7], point_of_inverse_depth(y[:6])) + self.own @ y[6:])
        return np.concatenate(told)

    def _add(self, identity: int, z: np.ndarray) -> None:
        """y = g(pose, z - own e): what is own is more numbers that are not known, beside z."""
        more = self.own.shape[1]

        def g(pose: np.ndarray, given: np.ndarray) -> np.ndarray:
            return np.append(new_inverse_depth(self.camera, pose, given[:3] - self.own @ given[3:]), given[3:])

        pose, given = self.x[:7], np.append(z, np.zeros(more))
        J_x = np.zeros((self._size(), len(self.x)))
        J_x[:, :7] = complex_step_jacobian(lambda p: g(p, given), pose)
        J = complex_step_jacobian(lambda y: g(pose, y), given)
        noise = np.zeros((3 + more, 3 + more))
        noise[:3, :3], noise[3:, 3:] = self.R, self.covariance
        cross = J_x @ self.P
        self.P = np.block([[self.P, cross.T], [cross, cross @ J_x.T + J @ noise @ J.T]])
        self.x = np.concatenate([self.x, g(pose, given).real])
        self.ids = [*self.ids, identity]
