"""How much faster a benchmark is on two cores than on one, and what a process for each trial costs.

    python benchmarks/runner_scaling.py                  # 3 min on two idle cores

The same trials (pure geometry, 8 drives of 133 m, two filters and the bound) with one job and with two, in turns;
wall-clock time of the whole run, tables included. The ratio is the median of the rounds. Below it, the time of an
empty trial in a process of its own against one in this process. Target: 1.8 on two cores.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

from harness import arguments, show
from stereo_slam_env.benchmark import Scenario, run_benchmark
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.running.isolation import run_isolated
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice

FILTERS = (filter_choice("inverse-depth"), filter_choice("dual-bearing"))


def seconds(scenario: Scenario, jobs: int) -> float:
    """Wall-clock time of the run."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        run_benchmark(scenario, Path(folder) / "out", jobs=jobs)
        return time.perf_counter() - began


def cost_of_a_process(repetitions: int = 20) -> float:
    """Seconds that a process of its own adds to a trial."""
    run_isolated(lambda tell: None, silence_limit=60.0)  # starts the server
    began = time.perf_counter()
    for _ in range(repetitions):
        run_isolated(lambda tell: None, silence_limit=60.0)
    return (time.perf_counter() - began) / repetitions


def main() -> None:
    """Measure and print."""
    given = arguments(__doc__, rounds=3, frames=300, seeds=8, jobs=2)
    source, drives = ReferenceSource("long_drive"), tuple(range(given.seeds))
    scenario = Scenario("scaling", source, filters=FILTERS, seeds=drives, frames=given.frames, gate=None)
    seconds(scenario, given.jobs)  # so that the processes of the pool are there, as in any longer run
    rounds = [(seconds(scenario, 1), seconds(scenario, given.jobs)) for _ in range(given.rounds)]
    rows = [
        (str(number), f"{one:.1f}", f"{many:.1f}", f"{one / many:.2f}") for number, (one, many) in enumerate(rounds)
    ]
    median = statistics.median(one / many for one, many in rounds)
    show(f"median ratio {median:.2f}", ("round", "1 job, s", f"{given.jobs} jobs, s", "ratio"), rows)
    print(f"a process of its own costs {1000 * cost_of_a_process():.0f} ms a trial")


if __name__ == "__main__":
    main()
