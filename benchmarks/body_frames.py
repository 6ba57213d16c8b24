"""Landmarks of a moving body kept in W, or in the axes of the body: what each form says of the body's pose.

    python benchmarks/body_frames.py             # 40 bodies each, three minutes of one core
    python benchmarks/body_frames.py --seeds 5   # fewer

One body with twelve landmarks before a camera that is known and stands still, so that the forms differ in nothing else.
Landmarks are (x / z, y / z, 1 / z) of where they are (W), or of where they were at birth (body). Jacobians are taken at
the estimates, as a filter must, or at the truth, which no gauge can take information from. NEES a degree of freedom of
point and rotation since birth, mean over the frames of a body: median, 90 % quantile and largest over the bodies.
"""

from __future__ import annotations

import numpy as np

from filters import StereoCamera, StereoNoise
from filters.bodies.rigid_bodies import BODY_SIZE, BodyStep, RigidBodies
from filters.geometry import rotations
from harness import arguments, show

CAMERA = StereoCamera(721.5, 721.5, 672.0, 195.5, 0.571, 1344, 391)
NOISE = StereoNoise.independent_pixels(0.5)
DT, FRAMES, POINTS, NEAREST, GATE = 0.1, 60, 12, 8.0, 11.34
SETTINGS = RigidBodies()
DRIVES = {"comes from 40 m": (40.0, -5.0), "25 m ahead, alike": (25.0, 0.5)}


def chart(points: np.ndarray) -> np.ndarray:
    """(x / z, y / z, 1 / z)."""
    return np.column_stack([points[:, :2], np.ones(len(points))]) / points[:, 2:]


point = chart  # its own inverse


def by_chart(y: np.ndarray) -> np.ndarray:
    """Jacobians of the points by (x / z, y / z, 1 / z)."""
    J = np.zeros((len(y), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0 / y[:, 2]
    J[:, :, 2] = -point(y) / y[:, 2:]
    return J


def measured(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(u, v, d) of points, with noise."""
    return CAMERA.project(points) + rng.multivariate_normal(np.zeros(3), NOISE.R, len(points))


def nees(seed: int, in_world: bool, at_truth: bool, distance: float, speed: float) -> float:
    """Mean NEES / 6 of one body, from half a second after its birth on."""
    rng = np.random.default_rng([3, seed])
    moving = [0.2 * rng.standard_normal(), 0.0, speed, 0.0, 0.05 * rng.standard_normal(), 0.0]
    truth = np.array([3.0, 1.0, distance, 0.0, 0.0, 0.0, 1.0, *moving])
    points = truth[:3] + (rng.random((POINTS, 3)) - 0.5) * [1.8, 1.4, 4.0]
    body = truth.copy()
    body[7:10] += [1.0, 0.3, 1.0] * rng.standard_normal(3)
    body[10:] = 0.0
    birth, y_true = Place(truth), chart(points)
    y = chart(CAMERA.backproject(measured(points, rng)))
    P = np.zeros((BODY_SIZE + 3 * POINTS,) * 2)
    P[6:12, 6:12] = SETTINGS.prior(turning=True)
    first = y_true if at_truth else y
    for i, J in enumerate(np.linalg.inv(CAMERA.project_jacobian(point(first)) @ by_chart(first))):
        rows = slice(BODY_SIZE + 3 * i, BODY_SIZE + 3 * i + 3)
        P[rows, rows] = J @ NOISE.R @ J.T
    noise, values = SETTINGS.noise(DT, turning=True), []
    for k in range(1, FRAMES):
        impulses = 0.2 * np.sqrt(np.diag(noise)[6:]) * rng.standard_normal(6)
        pushed = truth.copy()
        pushed[7:] += impulses
        true_step, step = BodyStep.of(pushed[None], DT), BodyStep.of(body[None], DT)
        chosen = true_step if at_truth else step
        one = np.zeros(POINTS, dtype=np.int64)
        F = np.eye(len(P))
        F[:BODY_SIZE, :BODY_SIZE] = chosen.F[0]
        if in_world:
            before = points if at_truth else point(y)
            after, by_body = chosen.carry(one, before)
            inverse, B = np.linalg.inv(by_chart(chart(after))), by_chart(chart(before))
            for i in range(POINTS):
                rows = slice(BODY_SIZE + 3 * i, BODY_SIZE + 3 * i + 3)
                F[rows, :BODY_SIZE], F[rows, rows] = inverse[i] @ by_body[i], inverse[i] @ chosen.D[0] @ B[i]
            y = chart(step.carry(one, point(y))[0])
        P[6:12, 6:12] += noise[6:, 6:]
        P = F @ P @ F.T
        points, truth, body = true_step.carry(one, points)[0], true_step.moved[0], step.moved[0]
        if truth[2] < NEAREST:
            break
        uvd = measured(points, rng)
        now = Place(body)
        expected = point(y) if in_world else now.of(birth, point(y))
        seen_from = points if at_truth else expected
        H = np.zeros((POINTS, 3, len(P)))
        place, own = (Place(truth), y_true) if at_truth else (now, y)
        H_point = CAMERA.project_jacobian(seen_from)
        for i in range(POINTS):
            rows = slice(BODY_SIZE + 3 * i, BODY_SIZE + 3 * i + 3)
            if in_world:
                H[i][:, rows] = H_point[i] @ by_chart(chart(seen_from))[i]
            else:
                local = birth.R.T @ (point(own)[i] - birth.p)
                H[i][:, :3], H[i][:, 3:6] = H_point[i], -H_point[i] @ place.R @ rotations.skew(local)
                H[i][:, rows] = H_point[i] @ place.R @ birth.R.T @ by_chart(own)[i]
        innovation = uvd - CAMERA.project(expected)
        S = H @ P @ H.transpose(0, 2, 1) + NOISE.R
        used = np.einsum("ni,nij,nj->n", innovation, np.linalg.inv(S), innovation) < GATE
        if not used.any():
            continue
        H_all, nu = H[used].reshape(-1, len(P)), innovation[used].ravel()
        R = np.kron(np.eye(int(used.sum())), NOISE.R)
        K = np.linalg.solve(H_all @ P @ H_all.T + R, H_all @ P).T
        delta, A = K @ nu, np.eye(len(P)) - K @ H_all
        P = A @ P @ A.T + K @ R @ K.T
        body[:3] += delta[:3]
        body[3:7] = rotations.multiply(body[3:7], rotations.exp_quaternion(delta[3:6]))
        body[7:] += delta[6:12]
        y = y + delta[12:].reshape(-1, 3)
        error = np.concatenate([truth[:3] - body[:3], rotations.log(Place(body).R.T @ Place(truth).R)])
        if k > 5:
            values.append(error @ np.linalg.solve(P[:6, :6] + 1e-12 * np.eye(6), error) / 6)
    return float(np.mean(values))


class Place:
    """Point and axes of a body."""

    def __init__(self, body: np.ndarray) -> None:
        self.p, self.R = body[:3], rotations.matrix(body[3:7])

    def of(self, birth: Place, points: np.ndarray) -> np.ndarray:
        """Where points of the body are that were at `points` at its birth."""
        return self.p + rotations.turned(self.R @ birth.R.T, points - birth.p)


def main() -> None:
    """Print a row for each drive, form and place of the Jacobians."""
    options, rows = arguments(__doc__, seeds=40), []
    for drive, settings in DRIVES.items():
        for form in ("W", "body"):
            for jacobians in ("estimates", "truth"):
                values = [nees(s, form == "W", jacobians == "truth", *settings) for s in range(options.seeds)]
                figures = np.median(values), np.quantile(values, 0.9), max(values)
                rows.append([drive, form, jacobians, *(f"{value:.2f}" for value in figures)])
    show("NEES / 6 of the pose of a body", ["drive", "landmarks in", "Jacobians at", "median", "90 %", "largest"], rows)


if __name__ == "__main__":
    main()
