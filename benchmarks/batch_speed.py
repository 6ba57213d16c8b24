"""Cost of a filter's frame (predict + update) in a batch, against the same filters one by one.

    python benchmarks/batch_speed.py                # a minute
    python benchmarks/batch_speed.py --iterations 2

25 landmarks of which 10 are replaced in every frame, six-dimensional inverse depth (some 170 rows of P). Everything is
measured in turns, in one process with one BLAS thread, so the ratios hold on a noisy machine. Processor time, 20 %
quantile over frames; and wall time, which says what two threads are worth where two cores are idle.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from filters import FilterBatch, Start, StereoEKF, StereoNoise, StereoObservation
from filters.checks.conformance import REFERENCE_CAMERA as CAMERA
from harness import arguments, in_turns, show, undisturbed

NOISE = StereoNoise.independent_pixels(1.0)
LANDMARKS, REPLACED, DT = 25, 10, 0.1
COUNTS = [1, 8, 64]
ONE_BY_ONE = "one by one"


def stream(seed: int, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """What a camera that stands still sees of a cloud that is replaced bit by bit: ids and (u, v, d)."""
    rng = np.random.default_rng(seed)
    fresh = rng.uniform((400.0, 100.0, 5.0), (900.0, 300.0, 40.0), (LANDMARKS + REPLACED * frames, 3))
    ids = np.arange(LANDMARKS) + REPLACED * np.arange(frames)[:, None]
    return ids, fresh[ids] + rng.multivariate_normal(np.zeros(3), NOISE.R, ids.shape)


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, iterations=1, frames=150, filters=COUNTS)
    streams = [stream(seed, given.frames) for seed in range(max(given.filters))]
    ids, uvd = (np.array(arrays) for arrays in zip(*streams, strict=True))

    def make() -> StereoEKF:
        slam = StereoEKF(CAMERA, NOISE, landmark="inverse-depth", iterations=given.iterations)
        slam.reset(Start())
        return slam

    def one_by_one(count: int) -> Callable[[], None]:
        filters, frames = [make() for _ in range(count)], iter(range(given.frames))

        def step() -> None:
            frame = next(frames)
            for b, slam in enumerate(filters):
                slam.predict(DT)
                slam.update(StereoObservation(ids[b, frame], uvd[b, frame]))

        return step

    def together(count: int, threads: int) -> Callable[[], None]:
        batch, frames = FilterBatch(make, count, threads), iter(range(given.frames))
        batch.reset(Start())

        def step() -> None:
            frame = next(frames)
            batch.step_arrays(DT, ids[:count, frame], uvd[:count, frame])

        return step

    most = max(given.filters)
    steps, counts = {ONE_BY_ONE: one_by_one(most)}, {ONE_BY_ONE: most}
    for count in given.filters:
        for threads in (1, 2) if count > 1 else (1,):
            label = f"batch of {count}, {threads} thread{'s' * (threads > 1)}"
            steps[label], counts[label] = together(count, threads), count
    costs = []
    with threadpool_limits(1):
        in_turns(steps, given.frames // 5)  # the map fills
        for clock in (time.process_time, time.perf_counter):
            times = in_turns(steps, 2 * given.frames // 5, clock=clock)
            costs.append({label: undisturbed(t) / counts[label] for label, t in times.items()})
    rows = [
        (label, *(f"{1e6 * cost[label]:.0f} ({cost[label] / cost[ONE_BY_ONE]:.2f})" for cost in costs))
        for label in steps
    ]
    title = f"us of a filter's frame (ratio to one by one), {given.iterations} iteration(s)"
    show(title, ("", "processor time", "wall time"), rows)


if __name__ == "__main__":
    main()
