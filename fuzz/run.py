"""Fuzz every reader of files: data sets, images, recordings, runs, scenario files, networks.

    python fuzz/run.py --inputs 1000000                   # guided by coverage; needs the extra fuzz
    python fuzz/run.py --seconds 600 --targets euroc,scenario
    python fuzz/run.py --engine random --inputs 20000     # without guidance, without atheris, deterministic

Each input is a small valid folder with one file changed: other bytes (the check sums of images and archives put right,
or not), nothing, a folder, a link out of it, a pipe, a socket, a device without end or a file larger than the disk in
its place. Reading it may raise a `ValueError` of one line and nothing
else, within 1 s of processor time and 500 MB; a link must not be followed, and no scenario file may name code.
The exit code is 1 where an input did otherwise; inputs and traces of those are kept in --out.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from filters.contract.extras import install_command  # noqa: E402
from fuzz.harness import Harness, limited_memory  # noqa: E402 (the folder of a script is not that of its package)
from fuzz.mutations import mutated  # noqa: E402
from fuzz.targets import targets  # noqa: E402

_MEMORY = Path("/dev/shm")


def main() -> int:
    """Run, show what was done, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [target.name for target in targets()]
    parser.add_argument("--inputs", type=int, default=1_000_000, help="how many")
    parser.add_argument("--seconds", type=int, default=0, help="stop after so long; 0: no limit")
    parser.add_argument("--targets", default=",".join(names), help="names, separated by commas")
    parser.add_argument(
        "--engine", choices=("guided", "random"), default="guided" if find_spec("atheris") else "random"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=None, help="folder for findings and corpus")
    given = parser.parse_args()
    chosen = given.targets.split(",")
    if unknown := set(chosen) - set(names):
        parser.error(f"targets must be of {', '.join(names)}, got {', '.join(sorted(unknown))}")
    if given.engine == "guided" and find_spec("atheris") is None:
        parser.error(f"--engine guided needs atheris: {install_command('fuzz')}, or take --engine random")
    out = Path(given.out or tempfile.mkdtemp(prefix="fuzz-"))
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=_MEMORY if _MEMORY.is_dir() else None, prefix="fuzz-") as folder:
        work = guided if given.engine == "guided" else unguided
        state = work(chosen, given.inputs, given.seconds, given.seed, out, Path(folder))
    return show(state, out)


def guided(chosen: list[str], inputs: int, seconds: int, seed: int, out: Path, folder: Path) -> dict[str, object]:
    """Let atheris do it, in a process of its own; one that dies of an input is started again."""
    settings = out / "settings.json"
    told = {
        "targets": chosen,
        "inputs": inputs,
        "seconds": seconds,
        "seed": seed,
        "out": str(out),
        "folder": str(folder),
    }
    settings.write_text(json.dumps(told))
    subprocess.run([sys.executable, str(ROOT / "fuzz" / "guided.py"), str(settings)], cwd=ROOT, check=False)
    state: dict[str, object] = json.loads((out / "state.json").read_text())
    return state


def unguided(chosen: list[str], inputs: int, seconds: int, seed: int, out: Path, folder: Path) -> dict[str, object]:
    """Mutations in turn over all targets."""
    harness = Harness(tuple(target for target in targets() if target.name in chosen), folder)
    rng, began, slowest = random.Random(seed), time.monotonic(), 0.0
    seeds = [harness.seeds(number) for number in range(len(harness.targets))]
    counts: Counter[str] = Counter()
    known: set[tuple[str, str]] = set()
    for k in range(inputs):
        if seconds and time.monotonic() - began > seconds:
            break
        number = k % len(seeds)
        data = mutated(rng.choice(seeds[number]), seeds[number], rng)
        started = time.process_time()
        with limited_memory():
            finding = harness.run(data)
        slowest = max(slowest, time.process_time() - started)
        counts[harness.targets[number].name] += 1
        if finding is not None and finding.key not in known:
            known.add(finding.key)
            place = out / f"finding-{len(known):03d}"
            place.with_suffix(".input").write_bytes(data)
            place.with_suffix(".txt").write_text(f"{finding.target} {finding.file}\n{finding.what}\n{finding.trace}\n")
    spent = time.monotonic() - began
    return {"inputs": sum(counts.values()), "seconds": spent, "slowest_s": slowest, "by_target": dict(counts)}


def show(state: dict[str, object], out: Path) -> int:
    """What was run and found; the exit code."""
    console, table = Console(), Table("target", "inputs")
    by_target = state["by_target"]
    assert isinstance(by_target, dict)
    for name, count in sorted(by_target.items()):
        table.add_row(name, f"{count:,}")
    console.print(table)
    inputs, seconds = int(str(state["inputs"])), float(str(state["seconds"]))
    console.print(f"{inputs:,} inputs in {seconds:.0f} s ({inputs / max(seconds, 1e-9):.0f} a second)")
    console.print(f"the slowest took {float(str(state['slowest_s'])):.2f} s of processor time")
    findings = sorted([*out.glob("finding-*.txt"), *out.glob("crash-*")])
    for path in findings:
        console.print(f"\n{path}", style="red", highlight=False)
        if path.suffix == ".txt":
            console.print(path.read_text(errors="replace"), markup=False, highlight=False)
    console.print(f"{len(findings)} findings in {out}")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
