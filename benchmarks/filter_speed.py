"""Cost of a frame (predict + update, n landmarks all observed), as a ratio to the linear algebra it cannot avoid.

    python benchmarks/filter_speed.py                  # all sizes, a minute
    python benchmarks/filter_speed.py --sizes 100

The yardstick is Cholesky + triangular solve + symmetric rank-k update of the whole frame in one batch, by scipy's
BLAS and LAPACK, at the sizes of the shared-anchor state. Everything is measured in turns in one process with one BLAS
thread, so the ratios hold on a noisy machine; the milliseconds are this machine's.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from rich.console import Console
from rich.table import Table
from scipy.linalg import blas, lapack
from threadpoolctl import threadpool_limits

from filters import StereoEKF, StereoNoise, StereoObservation
from filters.conformance import REFERENCE_CAMERA as CAMERA

NOISE = StereoNoise.independent_pixels(1.0)
ANCHORS = 10
DT, SPEED = 0.1, 0.05  # slow, so that every landmark stays in view through the whole measurement
FILTERS = {
    "inverse-depth (6-D)": {"landmark": "inverse-depth"},
    "inverse-depth (shared anchors)": {"landmark": "shared-anchor"},
    "dual-bearing (6-D)": {"landmark": "inverse-depth", "measurement": "sequential"},
    "euclidean": {"landmark": "euclidean"},
}


class Drive:
    """A slow drive towards a cloud of n points, which enter the map in `ANCHORS` groups."""

    def __init__(self, n: int, **options: str) -> None:
        rng = np.random.default_rng(n)
        uvd = rng.uniform((400, 100, 5), (900, 300, 40), (n, 3))
        self.points, self.rng, self.frame = CAMERA.backproject(uvd), rng, 0
        self.slam = StereoEKF(CAMERA, NOISE, **options)  # type: ignore[arg-type]
        self.slam.reset(linear_velocity=(0, 0, SPEED))
        for group in range(1, ANCHORS + 1):
            self.slam.update(self.observe(n * group // ANCHORS))
            self.slam.predict(DT)
            self.frame += 1

    def observe(self, count: int) -> StereoObservation:
        """Measure the first `count` points."""
        p_c = self.points[:count] - (0.0, 0.0, SPEED * DT * self.frame)
        errors = self.rng.multivariate_normal(np.zeros(3), NOISE.R, count)
        return StereoObservation(np.arange(count), CAMERA.project(p_c) + errors)

    def step(self) -> float:
        """Time of predict + update, s."""
        self.frame += 1
        observation = self.observe(len(self.points))
        began = time.perf_counter()
        self.slam.predict(DT)
        report = self.slam.update(observation)
        elapsed = time.perf_counter() - began
        assert len(report.updated) > 0.9 * len(self.points)
        return elapsed


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
        began = time.perf_counter()
        factor, _ = lapack.dpotrf(s, lower=1, overwrite_a=1)
        solved = blas.dtrsm(1.0, factor, hp, lower=1, overwrite_b=1)
        blas.dsyrk(-1.0, solved, beta=1.0, c=P, trans=1, lower=1, overwrite_c=1)
        return time.perf_counter() - began

    return step


def filterpy_step(n: int) -> Callable[[], float]:
    """Predict + update of filterpy's EKF at the same sizes, with H given."""
    rows, states = 3 * n, 12 + 3 * n + 3 * ANCHORS
    rng = np.random.default_rng(0)
    H = rng.standard_normal((rows, states))
    ekf = ExtendedKalmanFilter(dim_x=states, dim_z=rows)
    ekf.R = np.eye(rows)
    z = rng.standard_normal((rows, 1))

    def step() -> float:
        began = time.perf_counter()
        ekf.predict()
        ekf.update(z, lambda x: H, lambda x: H @ x)
        return time.perf_counter() - began

    return step


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[25, 50, 100, 200])
    parser.add_argument("--repeats", type=int, default=40)
    arguments = parser.parse_args()
    table = Table(title="median ms of predict + update (ratio to the yardstick), one BLAS thread")
    for head in ("n", "yardstick", *FILTERS, "filterpy EKF"):
        table.add_column(head, justify="right")
    with threadpool_limits(1):
        for n in arguments.sizes:
            steps = {"yardstick": yardstick(n)}
            steps |= {name: Drive(n, **options).step for name, options in FILTERS.items()}
            times: dict[str, list[float]] = {name: [] for name in (*steps, "filterpy")}
            oracle = filterpy_step(n)
            for repeat in range(arguments.repeats):
                for name, step in steps.items():
                    times[name].append(step())
                if repeat < 3:
                    times["filterpy"].append(oracle())
            floor = np.median(times["yardstick"])
            cells = [f"{1e3 * np.median(t):.2f} ({np.median(t) / floor:.2f})" for t in times.values()]
            table.add_row(str(n), *cells)
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
