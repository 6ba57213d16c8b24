"""Kill a benchmark again and again, whenever it is; what was finished must stay, and the end must be the same.

    python benchmarks/kill_anywhere.py                     # 200 kills of a run in one process, some minutes
    python benchmarks/kill_anywhere.py --kills 30 --jobs 2  # of one with workers, which take longer to start

A run of 12 short trials is started, killed with SIGKILL after a random time, and started again at once, until it has
been killed so many times; every finished one is begun anew. Every other kill is of the whole process group, as when the
machine goes down; the others are of the main process alone, as when memory runs out, and its children are left behind.
After each kill: every trial and bound that was finished before is still there, byte for byte (a trial run twice would
have other times in it), and no file is half written. When a run ends by itself, its time series are those of a run that
nobody disturbed, each trial is counted once, and nothing of the killed ones is left.
"""

from __future__ import annotations

import multiprocessing
import os
import random
import shutil
import signal
import sqlite3
import tempfile
import time
from contextlib import closing
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
from rich.progress import track

from harness import arguments
from stereo_slam_env.benchmark import run_benchmark
from stereo_slam_env.benchmark.storage.run_files import load_run
from stereo_slam_env.files.folders import CLAIM

SCENARIO = """
name = "killed"
kind = "reference"
seeds = 4
frames = 5
gate = false
filters = ["inverse-depth", "dual-bearing", "euclidean"]
options = { name = "short_turn" }
"""


@dataclass
class Tally:
    """What happened."""

    kills: int = 0
    of_main_process_alone: int = 0
    finished_runs: int = 0
    results_checked: int = 0


def start(scenario: Path, out: Path, jobs: int) -> BaseProcess:
    """Start the benchmark without its report, in a process group of its own; nothing has to be imported again."""
    process = multiprocessing.get_context("fork").Process(target=_run, args=(scenario, out, jobs))
    process.start()
    while process.is_alive() and os.getpgid(process.ident or 0) == os.getpgrp():
        time.sleep(0.001)
    return process


def _run(scenario: Path, out: Path, jobs: int) -> None:
    os.setsid()
    run_benchmark(scenario, out, jobs=jobs)


def results(out: Path) -> dict[Path, bytes]:
    """The finished trials and bounds."""
    return {path: path.read_bytes() for kind in ("trials/*/*.npz", "bounds/*.npz") for path in sorted(out.glob(kind))}


def positions(out: Path) -> dict[str, np.ndarray]:
    """What the filters estimated; raises where a file is damaged."""
    return {str(path.relative_to(out)): load_run(path).run.positions for path in sorted(out.glob("trials/*/*.npz"))}


def check_finished(out: Path, expected: dict[str, np.ndarray]) -> None:
    """Raise an AssertionError where a run that came to its end is not like an undisturbed one."""
    found = positions(out)
    assert found.keys() == expected.keys()
    assert all(np.array_equal(found[name], expected[name]) for name in expected), "another result"
    with closing(sqlite3.connect(out / "trials.sqlite")) as database:
        counted = [series for (series,) in database.execute("SELECT series FROM trials")]
    assert sorted(counted) == sorted(expected), "a trial is missing, or counted twice"
    left = [str(path.relative_to(out)) for path in out.rglob(".*") if path.name != CLAIM]
    assert not left, f"of a killed run is left: {left}"


def disturb(kills: int, jobs: int, seed: int = 0) -> Tally:
    """Kill until there were so many kills; raises AssertionError where something was lost."""
    rng, tally = random.Random(seed), Tally()
    with tempfile.TemporaryDirectory() as folder:
        scenario, out = Path(folder) / "killed.toml", Path(folder) / "run"
        scenario.write_text(SCENARIO)
        began = time.monotonic()
        undisturbed = start(scenario, Path(folder) / "undisturbed", jobs)
        undisturbed.join()
        longest = time.monotonic() - began
        assert undisturbed.exitcode == 0
        expected = positions(Path(folder) / "undisturbed")
        check_finished(Path(folder) / "undisturbed", expected)
        for _ in track(range(kills), "kills"):
            while not killed(start(scenario, out, jobs), rng.uniform(0.0, 0.7 * longest), out, tally):
                check_finished(out, expected)
                shutil.rmtree(out)
    return tally


def killed(running: BaseProcess, after: float, out: Path, tally: Tally) -> bool:
    """Kill it after a time, s, and see that nothing was lost; False where it came to its end before."""
    before = results(out)
    running.join(after)
    if running.exitcode is not None:
        assert running.exitcode == 0, "the run failed"
        tally.finished_runs += 1
        return False
    if tally.kills % 2:
        os.kill(running.ident or 0, signal.SIGKILL)
        tally.of_main_process_alone += 1
    else:
        os.killpg(running.ident or 0, signal.SIGKILL)
    running.join()
    now = results(out)
    assert all(now.get(path) == content for path, content in before.items()), "a finished result was lost or made again"
    positions(out)
    tally.kills += 1
    tally.results_checked += len(now)
    return True


def main() -> None:
    """Kill, and say what was left."""
    given = arguments(__doc__, kills=200, jobs=1)
    tally = disturb(given.kills, given.jobs)
    print(
        f"{tally.kills} kills, {tally.of_main_process_alone} of them of the main process alone: no finished result was "
        f"lost, changed or made again ({tally.results_checked} checked), no file damaged; {tally.finished_runs} runs "
        f"came to their end in between, with the results of an undisturbed one, each trial counted once"
    )


if __name__ == "__main__":
    main()
