"""A second implementation of the invariant filters, written from Zhang et al. 2017 and from nothing else.

Dense matrices and the matrix exponential of the group: the state is one matrix [[R, p, f_1 ... f_n], [0, I]], an error
(theta, xi_p, xi_1 ... xi_n) moves it by exp(xi^), a right-invariant one from the left, a left-invariant one from the
right. After a correction the error of what is left is linear in that before, by the left or right Jacobian of the
group. XYZ landmarks, odometry as in `VelocityDriven`.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from filters import BodyVelocity, StereoCamera, StereoObservation

from .textbook import complex_step_jacobian, triangulate


def cross(a: np.ndarray) -> np.ndarray:
    """[a]x of one vector."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]], dtype=np.asarray(a).dtype)


def rodrigues(a: np.ndarray) -> np.ndarray:
    """Exp(a), analytic in a."""
    angle = np.sqrt(a @ a)
    return np.eye(3) + np.sin(angle) / angle * cross(a) + (1 - np.cos(angle)) / angle**2 * cross(a) @ cross(a)


def wedge(xi: np.ndarray) -> np.ndarray:
    """xi^: the columns of (theta, xi_p, xi_1 ...) as an element of the Lie algebra."""
    columns = xi.reshape(-1, 3)
    algebra = np.zeros((len(columns) + 2, len(columns) + 2))
    algebra[:3, :3] = cross(columns[0])
    algebra[:3, 3:] = columns[1:].T
    return algebra


def adjoint(xi: np.ndarray) -> np.ndarray:
    """ad of xi: [xi, eta] = ad eta."""
    columns = xi.reshape(-1, 3)
    ad = np.kron(np.eye(len(columns)), cross(columns[0]))
    for row, column in enumerate(columns[1:], start=1):
        ad[3 * row : 3 * row + 3, :3] = cross(column)
    return ad


def left_jacobian(xi: np.ndarray) -> np.ndarray:
    """exp(xi + e) = exp(J e) exp(xi) to first order: the sum of ad^k / (k + 1)!, as a block of an exponential."""
    size = len(xi)
    series = np.block([[adjoint(xi), np.eye(size)], [np.zeros((size, 2 * size))]])
    return expm(series)[:size, size:]


class InvariantEKF:
    """Invariant EKF-SLAM, dense; errors in the order rotation, position, landmarks in the order of `ids`.

    Without `reset` the covariance stays what it was in the coordinates of the error, as in the paper.
    """

    def __init__(self, camera: StereoCamera, noise: np.ndarray, side: str = "right", reset: bool = True) -> None:
        self.camera, self.noise, self.right, self.reset = camera, noise, side == "right", reset
        self.X = np.eye(4)
        self.P = np.zeros((6, 6))
        self.ids: list[int] = []

    @property
    def rotation(self) -> np.ndarray:
        """R^WC."""
        return self.X[:3, :3]

    @property
    def position(self) -> np.ndarray:
        """r^WC."""
        return self.X[:3, 3]

    def landmark(self, identity: int) -> np.ndarray:
        """Position in W."""
        return self.X[:3, 4 + self.ids.index(identity)]

    def landmark_covariance(self, identity: int) -> np.ndarray:
        """Of the position in W, to first order: f = f^ + theta x f^ + xi_f, or f^ + R xi_f."""
        rows = 6 + 3 * self.ids.index(identity) + np.arange(3)
        J = np.zeros((3, len(self.P)))
        if self.right:
            J[:, rows], J[:, :3] = np.eye(3), -cross(self.landmark(identity))
        else:
            J[:, rows] = self.rotation
        return J @ self.P @ J.T

    def predict(self, dt: float, odometry: BodyVelocity) -> None:
        """F = I and G = Ad_X B; or F of the inverse of the step, and G = F B."""

        def step(velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            turn = velocity[3:] * dt
            return rodrigues(turn), rodrigues(0.5 * turn) @ velocity[:3] * dt

        measured = np.concatenate([odometry.linear, odometry.angular])
        turn, shift = step(measured)

        def left_error(velocity: np.ndarray) -> np.ndarray:
            """What multiplies the step from the left, to first order."""
            other_turn, other_shift = step(velocity)
            K = other_turn @ turn.T
            theta = 0.5 * np.array([K[2, 1] - K[1, 2], K[0, 2] - K[2, 0], K[1, 0] - K[0, 1]])
            return np.concatenate([theta, other_shift - np.cross(theta, shift)])

        B = complex_step_jacobian(left_error, measured.astype(complex))
        F, G = np.eye(len(self.P)), np.zeros((len(self.P), 6))
        if self.right:
            G[:3, :3] = G[3:6, 3:] = self.rotation
            for column in range(3, self.X.shape[1]):
                rows = 3 * (column - 2) + np.arange(3)
                G[rows, :3] = cross(self.X[:3, column]) @ self.rotation
        else:
            F = np.kron(np.eye(len(self.P) // 3), turn.T)
            F[3:6, :3] = -turn.T @ cross(shift)
            G = F[:, :6]
        G = G @ B
        self.P = F @ self.P @ F.T + G @ odometry.covariance @ G.T
        self.X[:3, 3] = self.position + self.rotation @ shift
        self.X[:3, :3] = self.rotation @ turn

    def update(self, observation: StereoObservation) -> None:
        """Known landmarks correct the state, new ones enter."""
        seen = dict(zip(observation.ids.tolist(), observation.uvd, strict=True))
        known = [i for i in self.ids if i in seen]
        if known:
            self._correct(known, [seen[i] for i in known])
        for i in sorted(set(seen) - set(known)):
            self._add(i, seen[i])

    def _project(self, h: np.ndarray) -> np.ndarray:
        camera = self.camera
        focal = np.array([camera.fx * h[0], camera.fy * h[1], camera.fx * camera.baseline])
        return focal / h[2] + np.array([camera.cx, camera.cy, 0.0])

    def _correct(self, known: list[int], measured: list[np.ndarray]) -> None:
        H = np.zeros((3 * len(known), len(self.P)))
        innovation = np.zeros(3 * len(known))
        R_cw = self.rotation.T
        for k, (i, z) in enumerate(zip(known, measured, strict=True)):
            h = R_cw @ (self.landmark(i) - self.position)
            J = complex_step_jacobian(self._project, h.astype(complex))
            rows, columns = slice(3 * k, 3 * k + 3), 6 + 3 * self.ids.index(i) + np.arange(3)
            if self.right:
                H[rows, 3:6], H[rows, columns] = -J @ R_cw, J @ R_cw
            else:
                H[rows, :3], H[rows, 3:6], H[rows, columns] = J @ cross(h), -J, J
            innovation[rows] = z - self._project(h)
        R = np.kron(np.eye(len(known)), self.noise)
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        I_KH = np.eye(len(self.P)) - K @ H
        self.P = I_KH @ self.P @ I_KH.T + K @ R @ K.T
        xi = K @ innovation
        self.X = expm(wedge(xi)) @ self.X if self.right else self.X @ expm(wedge(xi))
        if self.reset:
            J = left_jacobian(xi if self.right else -xi)
            self.P = J @ self.P @ J.T

    def _add(self, identity: int, z: np.ndarray) -> None:
        h = triangulate(self.camera, z)
        J = complex_step_jacobian(lambda m: triangulate(self.camera, m), z.astype(complex))
        M = np.zeros((3, len(self.P)))
        M[:, 3:6] = np.eye(3)
        if self.right:
            J = self.rotation @ J
        else:
            M[:, :3] = -cross(h.real)
        block = M @ self.P
        self.P = np.block([[self.P, block.T], [block, block @ M.T + J @ self.noise @ J.T]])
        grown = np.eye(len(self.X) + 1)
        grown[:3, : len(self.X)] = self.X[:3]
        grown[:3, -1] = self.position + self.rotation @ h
        self.X = grown
        self.ids = [*self.ids, identity]
