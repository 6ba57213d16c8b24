"""Many small trials in lock-step against one by one: frames a second on one core, and how equal the results are.

    python benchmarks/trials_speed.py                              # three minutes
    python benchmarks/trials_speed.py --trials 64 --landmarks 25
    python benchmarks/trials_speed.py --json trials.json

Every trial drives past its own points and measures n of them in every frame; landmarks leave and enter "one by one"
(each with 3 % a frame, as on the reference drive) or "in groups" (refilled to n when a third is gone, as the landmark
sensor does). Measured in turns, a frame of all trials together, then the same frame of a few of them one by one; both
times hold the whole step, predict and update with everything that is done to the observations, in CPU time of one
thread, so that other processes on the machine count for little. "Differs by" is the largest difference in pose and its
covariance between the two ways after the last frame.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from filters import StereoEKF, StereoEKFTrials, StereoNoise, StereoObservation
from filters.conformance import REFERENCE_CAMERA as CAMERA

NOISE = StereoNoise.independent_pixels(1.0)
DT, SPEED = 0.1, 0.05  # slow, so that landmarks leave when they are told to
TURNOVER = 0.03
ALONE = 3  # trials run one by one
WARM_UP = 30  # frames, until the anchors are as many as they stay
CASES = (
    ("inverse-depth", "one by one"),
    ("inverse-depth", "in groups"),
    ("shared-anchor", "one by one"),
    ("shared-anchor", "in groups"),
    ("euclidean", "one by one"),
)


def observations(n: int, seed: int, turnover: str) -> Iterator[StereoObservation]:
    """What one trial sees, frame after frame."""
    rng = np.random.default_rng(seed)
    points, ids, newest, frame = np.zeros((n, 3)), np.full(n, -1), 0, 0
    gone = np.ones(n, dtype=bool)
    while True:
        here = np.array([0.0, 0.0, SPEED * DT * frame])
        if turnover == "one by one" or gone.sum() > n // 3 or frame == 0:
            points[gone] = CAMERA.backproject(rng.uniform((400, 100, 5), (900, 300, 40), (gone.sum(), 3))) + here
            ids = np.where(gone, newest + np.cumsum(gone) - 1, ids)
            newest, gone = newest + int(gone.sum()), np.zeros(n, dtype=bool)
        seen = ~gone
        errors = rng.multivariate_normal(np.zeros(3), NOISE.R, int(seen.sum()))
        yield StereoObservation(ids[seen], CAMERA.project(points[seen] - here) + errors)
        gone |= rng.uniform(size=n) < TURNOVER
        frame += 1


def measure(landmark: str, turnover: str, n: int, trials: int, frames: int) -> dict[str, float]:
    """Mean seconds a frame and trial, both ways, and the largest difference."""

    def ekf() -> StereoEKF:
        return StereoEKF(CAMERA, NOISE, landmark=landmark)

    start = {"linear_velocity": (0.0, 0.0, SPEED)}
    together, alone = StereoEKFTrials(ekf(), trials), [ekf() for _ in range(min(ALONE, trials))]
    together.reset([start] * trials)
    for slam in alone:
        slam.reset(**start)
    sequences = [observations(n, seed, turnover) for seed in range(trials)]
    times: dict[str, list[float]] = {"together": [], "one by one": []}
    for _ in range(WARM_UP + frames):
        seen = [next(sequence) for sequence in sequences]
        began = time.thread_time()
        together.predict(DT)
        together.update(seen)
        times["together"].append((time.thread_time() - began) / trials)
        for slam, own in zip(alone, seen, strict=False):
            began = time.thread_time()
            slam.predict(DT)
            slam.update(own)
            times["one by one"].append(time.thread_time() - began)
    pose = together.pose
    differences = [
        np.abs(getattr(pose, name)[b] - getattr(slam.pose, name)).max()
        for b, slam in enumerate(alone)
        for name in ("position", "orientation", "covariance")
    ]
    return {
        "together": float(np.mean(times["together"][WARM_UP:])),
        "one by one": float(np.mean(times["one by one"][WARM_UP * len(alone) :])),
        "difference": float(max(differences)),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, nargs="+", default=[8, 64, 128])
    parser.add_argument("--landmarks", type=int, nargs="+", default=[10, 25, 30])
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    arguments = parser.parse_args()
    table = Table(title="frames a second on one core, one BLAS thread: together against one by one (ratio)")
    for head in ("landmark", "landmarks enter", "n", "one by one", *(f"{b} trials" for b in arguments.trials)):
        table.add_column(head, justify="right")
    table.add_column("differs by", justify="right")
    figures = []
    with threadpool_limits(1):
        for landmark, turnover in CASES:
            for n in arguments.landmarks:
                cells, rates, worst = [], [], 0.0
                for trials in arguments.trials:
                    seconds = measure(landmark, turnover, n, trials, arguments.frames)
                    figures.append({"landmark": landmark, "enter": turnover, "n": n, "trials": trials, **seconds})
                    ratio = seconds["one by one"] / seconds["together"]
                    cells.append(f"{1 / seconds['together']:.0f} ({ratio:.1f})")
                    rates.append(1 / seconds["one by one"])
                    worst = max(worst, seconds["difference"])
                table.add_row(landmark, turnover, str(n), f"{np.median(rates):.0f}", *cells, f"{worst:.0e}")
    Console(width=160).print(table)
    if arguments.json:
        arguments.json.write_text(json.dumps({"figures": figures}, indent=2) + "\n")


if __name__ == "__main__":
    main()
