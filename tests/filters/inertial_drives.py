"""Smooth drives and flights, in closed form, with a camera and an inertial unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from filters import InertialSamples, InertialUnit, Start, StereoEKF, StereoObservation

from .drives import CAMERA, INDEPENDENT_PIXELS

DT, SAMPLES = 0.1, 20
GRAVITY = np.array([0.0, 9.81, 0.0])
PLACE, TURN = np.array([0.05, -0.1, 0.2]), Rotation.from_euler("xyz", [0.4, -0.2, 1.5])
UNIT = InertialUnit(PLACE, TURN.as_quat(), 1.7e-4, 2e-3, 2e-5, 3e-3)
"""Away from the camera and turned against it; noise as of an ADIS16448."""
BIASES = np.repeat([0.01, 0.1], 3)
START_SIGMAS = np.repeat([1e-6, 1e-6, 0.5, 0.05], 3)
VISIBLE = 25

Poses = tuple[np.ndarray, Rotation]
Path = Callable[[np.ndarray], Poses]


def driven(t: np.ndarray) -> Poses:
    """A car at some 8 m/s on a winding road, with pitch and roll."""
    x, z = 4.0 * np.sin(0.6 * t), 8.0 * t + 1.6 * np.sin(0.9 * t)
    heading = np.arctan2(2.4 * np.cos(0.6 * t), 8.0 + 1.44 * np.cos(0.9 * t))
    angles = np.column_stack([heading, 0.01 * np.sin(4.0 * t), 0.01 * np.sin(5.0 * t)])
    return np.column_stack([x, 0.02 * np.sin(3.0 * t), z]), Rotation.from_euler("YXZ", angles)


def flown(t: np.ndarray) -> Poses:
    """A camera that is carried through a hall, in all six degrees of freedom."""
    at = np.column_stack([2.0 * np.sin(0.8 * t), 0.6 * np.sin(1.3 * t), 1.5 * np.sin(0.6 * t)])
    angles = np.column_stack([0.5 * np.sin(0.7 * t), 0.2 * np.sin(1.1 * t), 0.15 * np.sin(0.9 * t)])
    return at, Rotation.from_euler("YXZ", angles)


def moving(path: Path, t: np.ndarray, arm: np.ndarray | None = None) -> np.ndarray:
    """Velocity in W of the camera, or of a point that sits at `arm` in its frame; (K, 3) m/s."""
    there = [at + (0.0 if arm is None else R.apply(arm)) for at, R in (path(t + e) for e in (1e-4, -1e-4))]
    return (there[0] - there[1]) / 2e-4


def measured(path: Path, edges: np.ndarray) -> np.ndarray:
    """Exact means of rates and forces between `edges` (K + 1,) s, in the frame of the unit; (K, 6)."""
    R, middle = path(edges)[1], path(0.5 * (edges[1:] + edges[:-1]))[1] * TURN
    h = np.diff(edges)[:, None]
    rates = TURN.inv().apply((R[:-1].inv() * R[1:]).as_rotvec() / h)
    forces = middle.inv().apply(np.diff(moving(path, edges, PLACE), axis=0) / h - GRAVITY)
    return np.hstack([rates, forces])


@dataclass(frozen=True, eq=False)
class Step:
    """A frame: true pose, measurements, samples of the step to it, biases at its end."""

    position: np.ndarray
    orientation: np.ndarray
    observation: StereoObservation
    inertial: InertialSamples
    biases: np.ndarray


@dataclass(frozen=True, eq=False)
class Journey:
    """Frames every `DT` s, and what a filter is told of the start."""

    start: Start
    steps: tuple[Step, ...]

    @classmethod
    def along(
        cls,
        path: Path,
        seed: int,
        seconds: float,
        sigmas: np.ndarray = START_SIGMAS,
        tracked: int = VISIBLE,
        walk: float = 0.0,
    ) -> Journey:
        """Along a path past points that are drawn from the seed, `tracked` in a frame; the start is off by `sigmas`.

        While a point is tracked its image walks by `walk` standard deviations of a measurement a frame.
        """
        rng = np.random.default_rng(seed)
        count = round(seconds / DT)
        h, times = DT / SAMPLES, DT * np.arange(count + 1)
        at, R = path(times)
        points = at[rng.integers(0, count + 1, 60 * count + 300)] + rng.uniform(
            [-15, -4, -2], [15, 4, 40], (60 * count + 300, 3)
        )
        densities = np.repeat([UNIT.gyro_density, UNIT.accelerometer_density], 3)
        walks = np.repeat([UNIT.gyro_walk, UNIT.accelerometer_walk], 3)
        biases, steps, seen = BIASES * rng.standard_normal(6), [], np.zeros(0, dtype=np.int64)
        for k in range(count + 1):
            edges = DT * max(k - 1, 0) + h * np.arange(SAMPLES + 1)
            numbers = measured(path, edges) + biases + densities / np.sqrt(h) * rng.standard_normal((SAMPLES, 6))
            inertial = InertialSamples(h * np.arange(1, SAMPLES + 1), numbers[:, :3], numbers[:, 3:], UNIT)
            biases = biases + walks * np.sqrt(DT if k else 0.0) * rng.standard_normal(6)
            p_c = R[k].inv().apply(points - at[k])
            uvd = CAMERA.project(np.where(p_c[:, 2:] > 2.0, p_c, [0.0, 0.0, 1.0]))
            visible = np.flatnonzero((p_c[:, 2] > 2.0) & CAMERA.in_view(uvd))
            kept = seen[np.isin(seen, visible)]
            new = rng.permutation(np.setdiff1d(visible, kept))[: max(tracked - len(kept), 0)]
            seen = np.sort(np.concatenate([kept, new]))
            noisy = uvd[seen] + rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(seen))
            steps.append(Step(at[k], R[k].as_quat(), StereoObservation(seen, noisy), inertial, biases))
            if walk:
                moved = walk * rng.multivariate_normal(np.zeros(3), INDEPENDENT_PIXELS.R, len(seen))
                p_seen = CAMERA.backproject(uvd[seen] + moved) - p_c[seen]
                points[seen] += R[k].apply(p_seen)
        return cls(_told(path, sigmas, rng), tuple(steps))

    def run(self, slam: StereoEKF) -> np.ndarray:
        """Error and claimed covariance of the pose after each frame, as NEES; (K,)."""
        slam.reset(self.start)
        found = []
        for k, step in enumerate(self.steps):
            if k:
                slam.predict(DT, inertial=step.inertial)
            slam.update(step.observation)
            error, covariance = slam.pose_error(step.position, step.orientation)
            found.append(error @ np.linalg.solve(covariance, error))
        return np.array(found)


def _told(path: Path, sigmas: np.ndarray, rng: np.random.Generator) -> Start:
    at, R = path(np.zeros(1))
    ahead = path(np.array([1e-4]))[1]
    errors = sigmas * rng.standard_normal(12)
    orientation = (R[0] * Rotation.from_rotvec(errors[3:6])).as_quat()
    rate = (R[0].inv() * ahead[0]).as_rotvec() / 1e-4
    velocity = moving(path, np.zeros(1))[0] + errors[6:9]
    return Start(at[0] + errors[:3], orientation, velocity, rate + errors[9:], np.diag(sigmas**2))
