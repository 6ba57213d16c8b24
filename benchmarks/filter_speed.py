"""Cost of a frame (predict + update, n landmarks all observed), as a ratio to the linear algebra it cannot avoid.

    python benchmarks/filter_speed.py                  # all sizes, two minutes
    python benchmarks/filter_speed.py --sizes 100
    python benchmarks/filter_speed.py --json speed.json

The yardstick is Cholesky + triangular solve + symmetric rank-k update of the whole frame's measurement in one batch, by
scipy's BLAS and LAPACK, at the sizes of the shared-anchor state. Everything is measured in turns, some frames of each
at a time, in one process with one BLAS thread, so the ratios hold on a noisy machine; the milliseconds are this
machine's. filterpy's EKF gets H for nothing, at the sizes of the shared-anchor and of the six-dimensional state; iSAM2
is timed where gtsam is installed. "Turnover" is the share of a frame that goes into landmarks leaving and entering the
map, 3 % of them a frame as on the reference drive: frames with and without it, in turns on the same map.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from rich.console import Console
from rich.table import Table
from scipy.linalg import blas, lapack
from threadpoolctl import threadpool_limits

from filters import StereoEKF, StereoNoise, StereoObservation
from filters.conformance import REFERENCE_CAMERA as CAMERA

try:
    import gtsam
except ImportError:
    gtsam = None

NOISE = StereoNoise.independent_pixels(1.0)
ANCHORS = 10
TURNOVER = 0.03
BURST = 5  # frames of one filter in a row: in use it does not share the processor's caches with its rivals
DT, SPEED = 0.1, 0.05  # slow, so that every landmark stays in view through the whole measurement
SLOW_FRAMES = 6  # of the rivals that take long
SHARED = "shared anchors"
FILTERS = {
    "6-D": {"landmark": "inverse-depth"},
    SHARED: {"landmark": "shared-anchor"},
    "dual-bearing": {"landmark": "inverse-depth", "measurement": "sequential"},
    "euclidean": {"landmark": "euclidean"},
}


class Drive:
    """A slow drive towards a cloud of n points, which enter the map in `ANCHORS` groups."""

    def __init__(self, n: int, **options: str) -> None:
        self.rng, self.frame = np.random.default_rng(n), 0
        self.points = self.cloud(n)
        self.ids = np.arange(n)
        self.slam = StereoEKF(CAMERA, NOISE, **options)  # type: ignore[arg-type]
        self.slam.reset(linear_velocity=(0, 0, SPEED))
        for group in range(1, ANCHORS + 1):
            self.slam.update(self.observe(n * group // ANCHORS))
            self.slam.predict(DT)
            self.frame += 1

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
        began = time.perf_counter()
        self.slam.predict(DT)
        report = self.slam.update(observation)
        elapsed = time.perf_counter() - began
        assert len(report.updated) + len(report.initialised) > 0.9 * len(self.points)
        return elapsed


def turnover_share(n: int, repeats: int, **options: str) -> float:
    """Share of a frame's cost that goes into landmarks leaving and entering, once every landmark has been replaced."""
    drive, count = Drive(n, **options), max(1, round(TURNOVER * n))
    plain, busy = [], []
    for repeat in range(n // count + repeats):
        drive.replace(count)
        busy_time, plain_time = drive.step(), drive.step()
        if repeat >= n // count:
            busy.append(busy_time)
            plain.append(plain_time)
    return 1.0 - float(np.median(plain) / np.median(busy))


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


def filterpy_step(rows: int, states: int) -> Callable[[], float]:
    """Predict + update of filterpy's EKF at these sizes, with H given."""
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


def isam2_step(n: int) -> Callable[[], float]:
    """One frame of GTSAM's iSAM2 on the same drive: the update alone, not the making of its factors."""
    from gtsam.symbol_shorthand import L, X

    rng = np.random.default_rng(n)
    points = CAMERA.backproject(rng.uniform((400, 100, 5), (900, 300, 40), (n, 3)))
    K = gtsam.Cal3_S2Stereo(CAMERA.fx, CAMERA.fy, 0.0, CAMERA.cx, CAMERA.cy, CAMERA.baseline)
    pixel = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
    motion = gtsam.noiseModel.Isotropic.Sigma(6, 0.1)
    ahead = gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, SPEED * DT]))
    isam, frame = gtsam.ISAM2(), 0

    def step() -> float:
        nonlocal frame
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        values.insert(X(frame), gtsam.Pose3(gtsam.Rot3(), np.array([0.0, 0.0, SPEED * DT * frame])))
        if frame == 0:
            graph.add(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)))
            for i, point in enumerate(points):
                values.insert(L(i), point)
        else:
            graph.add(gtsam.BetweenFactorPose3(X(frame - 1), X(frame), ahead, motion))
        u, v, d = (CAMERA.project(points - (0.0, 0.0, SPEED * DT * frame)) + rng.standard_normal((n, 3))).T
        for i in range(n):
            seen = gtsam.StereoPoint2(u[i], u[i] - d[i], v[i])
            graph.add(gtsam.GenericStereoFactor3D(seen, pixel, X(frame), L(i), K))
        frame += 1
        began = time.perf_counter()
        isam.update(graph, values)
        return time.perf_counter() - began

    return step


def measure(n: int, repeats: int) -> dict[str, float]:
    """Median seconds a frame of everything, at n landmarks."""
    shared = 12 + 3 * n + 3 * ANCHORS
    steps = {"yardstick": yardstick(n)}
    steps |= {name: Drive(n, **options).step for name, options in FILTERS.items()}
    slow = {
        "filterpy EKF, shared state": filterpy_step(3 * n, shared),
        "filterpy EKF, 6-D state": filterpy_step(3 * n, 12 + 6 * n),
    }
    if gtsam is not None:
        slow["GTSAM iSAM2"] = isam2_step(n)
        slow["GTSAM iSAM2"]()  # the first frame makes the map
    times: dict[str, list[float]] = {name: [] for name in (*steps, *slow)}
    for repeat in range(repeats // BURST):
        for name, step in steps.items():
            times[name] += [step() for _ in range(BURST)]
        for name, step in slow.items():
            if repeat < SLOW_FRAMES:
                times[name].append(step())
    return {name: float(np.median(t)) for name, t in times.items()}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="+", default=[25, 50, 100, 200])
    parser.add_argument("--repeats", type=int, default=60)
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    arguments = parser.parse_args()
    table = Table(title="median ms of predict + update (ratio to the yardstick), one BLAS thread")
    summary: dict[str, dict[str, object]] = {}
    with threadpool_limits(1):
        for n in arguments.sizes:
            seconds = measure(n, arguments.repeats)
            floor = seconds["yardstick"]
            share = turnover_share(n, arguments.repeats, **FILTERS[SHARED])
            summary[str(n)] = {
                "milliseconds": {name: 1e3 * s for name, s in seconds.items()},
                "ratio_to_yardstick": {name: s / floor for name, s in seconds.items()},
                "speedup_of_shared_anchors": {name: s / seconds[SHARED] for name, s in seconds.items()},
                "turnover_share_of_shared_anchors": share,
            }
            if not table.columns:
                for head in ("n", *seconds, "turnover"):
                    table.add_column(head, justify="right")
            cells = [f"{1e3 * s:.2f} ({s / floor:.2f})" for s in seconds.values()]
            table.add_row(str(n), *cells, f"{100 * share:.0f} %")
    Console(width=200).print(table)
    if arguments.json:
        arguments.json.write_text(json.dumps({"sizes": summary}, indent=2) + "\n")


if __name__ == "__main__":
    main()
