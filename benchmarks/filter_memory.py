"""Memory of a filter over a long drive: it must not grow.

    python benchmarks/filter_memory.py                         # 100,000 frames, some minutes
    python benchmarks/filter_memory.py --frames 20000

Landmarks leave and enter all the time, odd ones are missed, some are outliers, and now and then every belief is read.
Prints ten times on the way what the process holds (RSS), how many objects Python keeps, and the size of P.
"""

from __future__ import annotations

import argparse
import gc
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from filters import Start, StereoEKF, StereoNoise, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA

NOISE = StereoNoise.independent_pixels(1.0)
DT, SPEED, VISIBLE = 0.1, 1.0, 12


def resident_megabytes() -> float:
    """RSS of this process (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def main() -> None:
    """Drive and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=100_000)
    arguments = parser.parse_args()
    table = Table(title="memory on the way")
    for head in ("frame", "process, MB", "objects", "rows of P", "landmarks"):
        table.add_column(head, justify="right")
    rng = np.random.default_rng(0)
    slam = StereoEKF(CAMERA, NOISE, landmark="shared-anchor")
    slam.reset(Start(linear_velocity=(0, 0, SPEED)))
    ids, p_w = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    next_id, every = 0, max(1, arguments.frames // 10)
    with threadpool_limits(1):
        for frame in range(arguments.frames + 1):
            position = np.array([0.0, 0.0, SPEED * DT * frame])
            stays = (p_w - position)[:, 2] > 4.0
            stays &= rng.uniform(size=len(stays)) > 0.02
            missing = VISIBLE + int(rng.integers(-2, 3)) - int(stays.sum())
            uvd = rng.uniform((400, 100, 10), (900, 300, 40), (max(0, missing), 3))
            p_w = np.vstack([p_w[stays], CAMERA.backproject(uvd) + position])
            ids = np.concatenate([ids[stays], next_id + np.arange(len(uvd))])
            next_id += len(uvd)
            errors = rng.multivariate_normal(np.zeros(3), NOISE.R, len(ids))
            errors[rng.uniform(size=len(ids)) < 0.02] += 30.0
            slam.predict(DT)
            slam.update(StereoObservation(ids, CAMERA.project(p_w - position) + errors))
            if frame % 20 == 0:
                assert np.isfinite(slam.pose.covariance).all()
                assert len(slam.landmarks.ids) == len(slam.forecast().ids)
            if frame % every == 0:
                gc.collect()
                kept, size = len(gc.get_objects()), len(slam.state.P)
                landmarks = len(slam.landmarks.ids)
                table.add_row(f"{frame:,}", f"{resident_megabytes():.1f}", f"{kept:,}", str(size), str(landmarks))
    Console(width=120).print(table)


if __name__ == "__main__":
    main()
