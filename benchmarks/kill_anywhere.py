"""Kill a benchmark again and again, whenever it is; what was finished must stay, and the end must be the same.

    python benchmarks/kill_anywhere.py                     # 30 kills, 3 min on two idle cores
    python benchmarks/kill_anywhere.py --kills 200

A run of 12 short trials is started, killed with SIGKILL (the whole process group) after a random time, and started
again, until it has been killed so many times; every finished one is begun anew. After each kill: every trial that was
finished before is still there, byte for byte, and no file of the run is half written. When a run ends by itself, its
time series are those of a run that nobody disturbed.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from stereo_slam_env.benchmark.run_archive import load_run

SCENARIO = """
name = "killed"
kind = "reference"
seeds = 4
frames = 5
gate = false
filters = ["inverse-depth", "dual-bearing", { name = "euclidean", options = { min_disparity = 5.0 } }]
options = { name = "short_turn" }
"""


@dataclass
class Tally:
    """What happened."""

    kills: int = 0
    finished_runs: int = 0
    trials_kept: int = 0


def start(scenario: Path, out: Path, jobs: int) -> subprocess.Popen[bytes]:
    """Start the benchmark without its report, in a process group of its own."""
    code = "import sys; from stereo_slam_env.benchmark import run; "
    code += "run(sys.argv[1], sys.argv[2], jobs=int(sys.argv[3]), report=False)"
    command = [sys.executable, "-c", code, str(scenario), str(out), str(jobs)]
    return subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def trials(out: Path) -> dict[Path, bytes]:
    """The finished trials."""
    return {path: path.read_bytes() for path in sorted(out.glob("trials/*/*.npz"))}


def positions(out: Path) -> dict[str, np.ndarray]:
    """What the filters estimated; raises where a file is damaged."""
    return {str(path.relative_to(out)): load_run(path)[0].positions for path in trials(out)}


def disturb(kills: int, jobs: int, seed: int = 0) -> Tally:
    """Kill until there were so many kills; raises AssertionError where something was lost."""
    rng, tally = random.Random(seed), Tally()
    with tempfile.TemporaryDirectory() as folder:
        scenario = Path(folder) / "killed.toml"
        scenario.write_text(SCENARIO)
        began = time.monotonic()
        undisturbed = start(scenario, Path(folder) / "undisturbed", jobs)
        _, err = undisturbed.communicate()
        longest = time.monotonic() - began
        assert undisturbed.returncode == 0, err.decode()
        expected, out = positions(Path(folder) / "undisturbed"), Path(folder) / "run"
        while tally.kills < kills:
            before = trials(out)
            running = start(scenario, out, jobs)
            try:
                running.wait(timeout=rng.uniform(0.3 * longest, longest))
            except subprocess.TimeoutExpired:
                os.killpg(running.pid, signal.SIGKILL)
                running.communicate()
                tally.kills += 1
                now = trials(out)
                assert all(now.get(path) == content for path, content in before.items()), "a finished trial was lost"
                positions(out)
                tally.trials_kept += len(now)
                continue
            assert running.returncode == 0, running.communicate()[1].decode()
            found = positions(out)
            assert found.keys() == expected.keys()
            assert all(np.array_equal(found[name], expected[name]) for name in expected), "another result"
            tally.finished_runs += 1
            shutil.rmtree(out)
    return tally


def main() -> None:
    """Kill, and say what was left."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    tally = disturb(arguments.kills, arguments.jobs)
    Console().print(
        f"{tally.kills} kills: no finished trial was lost or changed ({tally.trials_kept} checked), no file damaged; "
        f"{tally.finished_runs} runs came to their end in between, with the results of an undisturbed one"
    )


if __name__ == "__main__":
    main()
