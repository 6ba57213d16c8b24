"""Cost of a filter's frame (predict + update) in a batch, against the same filters one by one.

    python benchmarks/batch_speed.py                # half a minute
    python benchmarks/batch_speed.py --iterations 2

25 landmarks of which 10 are replaced in every frame, six-dimensional inverse depth (some 170 rows of P). Everything is
measured in turns, in one process with one BLAS thread, so the ratios hold on a noisy machine. Wall time, because
threads are among what is compared: run it on idle cores. 20 % quantile over frames.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from filters import FilterBatch, Start, StereoEKF, StereoNoise, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA

NOISE = StereoNoise.independent_pixels(1.0)
LANDMARKS, REPLACED, DT = 25, 10, 0.1
COUNTS = (1, 8, 32, 128)


def stream(seed: int, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """What a camera that stands still sees of a cloud that is replaced bit by bit: ids and (u, v, d)."""
    rng = np.random.default_rng(seed)
    fresh = rng.uniform((400.0, 100.0, 5.0), (900.0, 300.0, 40.0), (LANDMARKS + REPLACED * frames, 3))
    ids = np.arange(LANDMARKS) + REPLACED * np.arange(frames)[:, None]
    return ids, fresh[ids] + rng.multivariate_normal(np.zeros(3), NOISE.R, ids.shape)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=1, help="passes of each update")
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--filters", type=int, nargs="+", default=COUNTS)
    arguments = parser.parse_args()
    streams = [stream(seed, arguments.frames) for seed in range(max(arguments.filters))]
    ids, uvd = (np.array(arrays) for arrays in zip(*streams, strict=True))

    def make() -> StereoEKF:
        slam = StereoEKF(CAMERA, NOISE, landmark="inverse-depth", iterations=arguments.iterations)
        slam.reset(Start())
        return slam

    def alone() -> Callable[[int], None]:
        slam = make()

        def step(frame: int) -> None:
            slam.predict(DT)
            slam.update(StereoObservation(ids[0, frame], uvd[0, frame]))

        return step

    def together(count: int, threads: int) -> Callable[[int], None]:
        batch = FilterBatch(make, count, threads)
        batch.reset(Start())

        def step(frame: int) -> None:
            batch.step_arrays(DT, ids[:count, frame], uvd[:count, frame])

        return step

    steps = {("one by one", 1): alone()}
    for count in arguments.filters:
        for threads in (1, 2) if count > 1 else (1,):
            steps[f"batch of {count}, {threads} thread{'s' * (threads > 1)}", count] = together(count, threads)
    times: dict[tuple[str, int], list[float]] = {key: [] for key in steps}
    with threadpool_limits(1):
        for frame in range(arguments.frames):
            for (label, count), step in steps.items():
                began = time.perf_counter()
                step(frame)
                times[label, count].append((time.perf_counter() - began) / count)
    cost = {label: float(np.quantile(t[len(t) // 5 :], 0.2)) for (label, _), t in times.items()}
    table = Table(title=f"a filter's frame, {arguments.iterations} iteration(s)")
    for head in ("", "us", "times the rate of one by one"):
        table.add_column(head, justify="right" if head else "left")
    for label, seconds in cost.items():
        table.add_row(label, f"{1e6 * seconds:.0f}", f"{cost['one by one'] / seconds:.1f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
