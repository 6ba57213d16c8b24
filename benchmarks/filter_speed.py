"""Cost of a frame (predict + update, n landmarks all observed), as a ratio to the linear algebra it cannot avoid.

    python benchmarks/filter_speed.py                  # 25 to 200 landmarks, five minutes
    python benchmarks/filter_speed.py --sizes 400 800 --repeats 15

The yardstick is Cholesky + triangular solve + symmetric rank-k update of the whole frame's measurement in one batch, by
scipy's BLAS and LAPACK, at the sizes of the shared-anchor state. Everything is measured in turns, some frames of each
at a time, in one process with one BLAS thread, so the ratios hold on a noisy machine; times are this machine's
processor time, 20 % quantile. "Own" parts are a stranger's: plain functions, compiled, or run in Python as where Numba
cannot compile them. filterpy's EKF gets H for nothing, at the sizes of the shared-anchor and of the six-dimensional
state: it has no
shared anchors, so the latter is the same problem as a user would write it; OpenCV's KalmanFilter and a careful EKF in
NumPy (Cholesky, triangular solve, a step of the leading rows alone) get it at the sizes of the former, and so does the
same EKF in JAX where that is installed, a filter of `JAX_FILTERS` under `vmap`. These are measured up to 200 landmarks.
"Turnover" is the share of a frame that goes into landmarks leaving and entering the map, 3 % of them a frame as on the
reference drive: frames with and without it, in turns on the same map. `rival_speed.py` drives, and has iSAM2.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import blas, cholesky, lapack, solve_triangular
from threadpoolctl import threadpool_limits

from filters import (
    CalibratedPair,
    MeasurementModel,
    MotionModel,
    Start,
    StereoEKF,
    StereoNoise,
    StereoObservation,
    vectors,
)
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from harness import arguments, show, undisturbed

try:
    import jax
    import jax.numpy as jnp
    from jax.scipy.linalg import solve_triangular as jax_solve_triangular
except ImportError:
    jax = None

NOISE = StereoNoise.independent_pixels(1.0)
ANCHORS = 10
TURNOVER = 0.03
BURST = 5  # frames of one filter in a row: in use it does not share the processor's caches with its rivals
DT, SPEED = 0.1, 0.05  # slow, so that every landmark stays in view through the whole measurement
SLOW_FRAMES = 6  # of the rivals that take long
MOST_OF_RIVALS = 200  # landmarks
JAX_FILTERS = 8
SHARED = "shared anchors"


class OwnCompiledCamera(MeasurementModel):
    """The rectified pair as a stranger writes it."""

    def project(self, camera: Any, h: Any) -> Any:
        """(u, v, d)."""
        u, v = camera.fx * h[0] / h[2] + camera.cx, camera.fy * h[1] / h[2] + camera.cy
        return u, v, camera.fx * camera.baseline * h[3] / h[2]

    def unproject(self, camera: Any, uvd: Any) -> Any:
        """The inverse."""
        x, y = (uvd[0] - camera.cx) / camera.fx, (uvd[1] - camera.cy) / camera.fy
        return x, y, 1.0, uvd[2] / (camera.fx * camera.baseline)


class OwnCamera(OwnCompiledCamera):
    """The same in Python, as where Numba cannot compile it."""

    in_machine_code = False


@dataclass(frozen=True)
class OwnCompiledMotion(MotionModel):
    """Constant velocity as a stranger writes it."""

    def sigmas(self, dt: float) -> tuple[float, ...]:
        """Impulses."""
        return 3.0 * dt, 3.0 * dt, 3.0 * dt, 0.6 * dt, 0.6 * dt, 0.6 * dt

    def step(self, x: Any, dt: float, n: Any) -> Any:
        """Eq. 6."""
        v, w = vectors.plus(x.linear_velocity, n[:3], 1.0), vectors.plus(x.angular_velocity, n[3:], 1.0)
        turn = vectors.quaternion(vectors.scaled(dt, w))
        return vectors.plus(x.position, v, dt), vectors.product(x.orientation, turn), v, w


class OwnMotion(OwnCompiledMotion):
    """The same in Python."""

    in_machine_code = False


CHOICES: dict[str, dict[str, object]] = {
    SHARED: {},
    "dual-bearing": {"measurement": "sequential"},
    "euclidean": {"landmark": "euclidean"},
    "6-D": {"landmark": "inverse-depth"},
    "consensus": {"consensus": True},
    "first-estimates": {"error": "first-estimates"},
    "right-invariant": {"error": "right-invariant"},
    "calibration considered": {"measurement": CalibratedPair(0.25, 3e-3, 2e-3, 5e-3, considered=True)},
    "own camera": {"measurement": OwnCamera()},
    "own camera, compiled": {"measurement": OwnCompiledCamera()},
    "own motion": {"motion": OwnMotion()},
    "own motion, compiled": {"motion": OwnCompiledMotion()},
    "hybrid": {"landmark": "hybrid"},
    "unscented": {"update": "unscented"},
    "one clone": {},
    "eleven clones": {},
}
FILTERS = {name: {"landmark": "shared-anchor", **options} for name, options in CHOICES.items()}
CLONES = {"one clone": 1, "eleven clones": 11}


class Drive:
    """A slow drive towards a cloud of n points, which enter the map in `ANCHORS` groups."""

    def __init__(self, n: int, clones: int = 0, **options: object) -> None:
        self.rng, self.frame = np.random.default_rng(n), 0
        self.points = self.cloud(n)
        self.ids = np.arange(n)
        self.slam = StereoEKF(CAMERA, NOISE, **options)  # type: ignore[arg-type]
        self.slam.reset(Start(linear_velocity=(0, 0, SPEED)))
        for group in range(1, ANCHORS + 1):
            self.slam.update(self.observe(n * group // ANCHORS))
            self.slam.predict(DT)
            self.frame += 1
        for clone in range(clones):
            self.slam.clone_pose(str(clone))

    def cloud(self, count: int) -> np.ndarray:
        """Points in view from here."""
        uvd = self.rng.uniform((400, 100, 5), (900, 300, 40), (count, 3))
        return CAMERA.backproject(uvd) + np.array([0.0, 0.0, SPEED * DT * self.frame])

    def observe(self, count: int) -> StereoObservation:
        """Measure the first `count` points."""
        p_c = self.points[:count] - (0.0, 0.0, SPEED * DT * self.frame)
        errors = self.rng.multivariate_normal(np.zeros(3), NOISE.R, count)
        return StereoObservation(self.ids[:count], CAMERA.project(p_c) + errors)

    def replace(self, count: int) -> None:
        """The `count` oldest points leave, as many new ones come."""
        self.points = np.vstack([self.points[count:], self.cloud(count)])
        self.ids = np.concatenate([self.ids[count:], self.ids[-1] + 1 + np.arange(count)])

    def step(self) -> float:
        """Time of predict + update, s."""
        self.frame += 1
        observation = self.observe(len(self.points))
        began = time.process_time()
        self.slam.predict(DT)
        report = self.slam.update(observation)
        elapsed = time.process_time() - began
        assert len(report.updated) + len(report.initialised) > 0.9 * len(self.points)
        return elapsed


def turnover_share(n: int, repeats: int, **options: object) -> float:
    """Share of a frame's cost that goes into landmarks leaving and entering, once every landmark has been replaced."""
    drive, count = Drive(n, **options), max(1, round(TURNOVER * n))
    plain, busy = [], []
    for repeat in range(n // count + repeats):
        drive.replace(count)
        busy_time, plain_time = drive.step(), drive.step()
        if repeat >= n // count:
            busy.append(busy_time)
            plain.append(plain_time)
    return 1.0 - undisturbed(plain) / undisturbed(busy)


def yardstick(n: int) -> Callable[[], float]:
    """The factorisation, solve and rank-k update of one batch of 3 n rows on 12 + 3 n + 3 ANCHORS states."""
    rows, states = 3 * n, 12 + 3 * n + 3 * ANCHORS
    rng = np.random.default_rng(0)
    root = rng.standard_normal((rows, rows + 5))
    S = np.asfortranarray(root @ root.T)
    HP = np.asfortranarray(rng.standard_normal((rows, states)))
    P = np.asfortranarray(np.eye(states) * 1e6)

    def step() -> float:
        s, hp = S.copy(order="F"), HP.copy(order="F")
        began = time.process_time()
        factor, _ = lapack.dpotrf(s, lower=1, overwrite_a=1)
        solved = blas.dtrsm(1.0, factor, hp, lower=1, overwrite_b=1)
        blas.dsyrk(-1.0, solved, beta=1.0, c=P, trans=1, lower=1, overwrite_c=1)
        return time.process_time() - began

    return step


def filterpy_step(rows: int, states: int) -> Callable[[], float]:
    """Predict + update of filterpy's EKF at these sizes, with H given."""
    rng = np.random.default_rng(0)
    H = rng.standard_normal((rows, states))
    ekf = ExtendedKalmanFilter(dim_x=states, dim_z=rows)
    ekf.R = np.eye(rows)
    z = rng.standard_normal((rows, 1))

    def step() -> float:
        began = time.process_time()
        ekf.predict()
        ekf.update(z, lambda x: H, lambda x: H @ x)
        return time.process_time() - began

    return step


def opencv_step(rows: int, states: int) -> Callable[[], float]:
    """Predict + correct of OpenCV's KalmanFilter at these sizes."""
    rng = np.random.default_rng(0)
    kf = cv2.KalmanFilter(states, rows, 0, cv2.CV_64F)
    kf.transitionMatrix, kf.processNoiseCov = np.eye(states), 1e-6 * np.eye(states)
    kf.measurementMatrix, kf.measurementNoiseCov = rng.standard_normal((rows, states)), np.eye(rows)
    kf.errorCovPost, z = np.eye(states), rng.standard_normal((rows, 1))

    def step() -> float:
        began = time.process_time()
        kf.predict()
        kf.correct(z)
        return time.process_time() - began

    return step


def numpy_step(rows: int, states: int) -> Callable[[], float]:
    """Predict + update of an EKF in NumPy and SciPy at these sizes, as one who cares for speed writes it."""
    rng = np.random.default_rng(0)
    H, z, R = rng.standard_normal((rows, states)), rng.standard_normal(rows), np.eye(rows)
    F, Q, x, P = np.eye(12) + 0.1 * np.eye(12, k=6), 1e-6 * np.eye(12), np.zeros(states), np.eye(states)

    def step() -> float:
        began = time.process_time()
        P[:12] = F @ P[:12]
        P[:, :12] = P[:, :12] @ F.T
        P[:12, :12] += Q
        HP = H @ P
        factor = cholesky(HP @ H.T + R, lower=True, overwrite_a=True, check_finite=False)
        solved = solve_triangular(factor, HP, lower=True, overwrite_b=True, check_finite=False)
        nu = solve_triangular(factor, z - H @ x, lower=True, check_finite=False)
        np.add(x, solved.T @ nu, out=x)
        np.subtract(P, solved.T @ solved, out=P)
        return time.process_time() - began

    return step


def jax_step(rows: int, states: int) -> Callable[[], float]:
    """The same in JAX, compiled, in double precision: a filter's share of `JAX_FILTERS` under `vmap`."""
    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(0)
    H, z, R = jnp.array(rng.standard_normal((rows, states))), jnp.array(rng.standard_normal(rows)), jnp.eye(rows)
    F, Q = jnp.eye(12) + 0.1 * jnp.eye(12, k=6), 1e-6 * jnp.eye(12)

    def frame(x: Any, P: Any) -> Any:
        P = P.at[:12].set(F @ P[:12])
        P = P.at[:, :12].set(P[:, :12] @ F.T)
        P = P.at[:12, :12].add(Q)
        HP = H @ P
        factor = jnp.linalg.cholesky(HP @ H.T + R)
        solved = jax_solve_triangular(factor, HP, lower=True)
        nu = jax_solve_triangular(factor, z - H @ x, lower=True)
        return x + solved.T @ nu, P - solved.T @ solved

    frames = jax.jit(jax.vmap(frame), donate_argnums=(0, 1))
    belief = frames(jnp.zeros((JAX_FILTERS, states)), jnp.tile(jnp.eye(states), (JAX_FILTERS, 1, 1)))

    def step() -> float:
        nonlocal belief
        began = time.process_time()
        belief = jax.block_until_ready(frames(*belief))
        return (time.process_time() - began) / JAX_FILTERS

    return step


def measure(n: int, repeats: int) -> dict[str, float]:
    """Seconds a frame of everything, at n landmarks."""
    shared = 12 + 3 * n + 3 * ANCHORS
    steps = {"yardstick": yardstick(n)}
    drives = {name: Drive(n, CLONES.get(name, 0), **options) for name, options in FILTERS.items()}
    steps |= {name: drive.step for name, drive in drives.items()}
    slow = {
        "filterpy EKF, shared state": filterpy_step(3 * n, shared),
        "filterpy EKF, 6-D state": filterpy_step(3 * n, 12 + 6 * n),
        "OpenCV KalmanFilter": opencv_step(3 * n, shared),
        "EKF in NumPy": numpy_step(3 * n, shared),
    }
    if jax is not None:
        slow["EKF in JAX"] = jax_step(3 * n, shared)
    if n > MOST_OF_RIVALS:
        slow = {}
    times: dict[str, list[float]] = {name: [] for name in (*steps, *slow)}
    for repeat in range(repeats // BURST):
        for name, step in steps.items():
            times[name] += [step() for _ in range(BURST)]
        for name, step in slow.items():
            if repeat < SLOW_FRAMES:
                times[name].append(step())
    return {name: undisturbed(t) for name, t in times.items()}


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, sizes=[25, 50, 100, 200], repeats=60)
    columns = []
    with threadpool_limits(1):
        for n in given.sizes:
            taken = measure(n, given.repeats)
            cells = {
                name: f"{1e3 * s:.2f} ({s / taken['yardstick']:.2f}, {s / taken[SHARED]:.2f})"
                for name, s in taken.items()
            }
            cells["turnover"] = f"{100 * turnover_share(n, given.repeats, **FILTERS[SHARED]):.0f} %"
            columns.append(cells)
    rows = [(name, *(column.get(name, "") for column in columns)) for name in columns[0]]
    title = "ms of predict + update (ratio to the yardstick, to shared anchors), one BLAS thread"
    show(title, ("landmarks", *map(str, given.sizes)), rows)


if __name__ == "__main__":
    main()
