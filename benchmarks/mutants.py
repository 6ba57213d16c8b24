"""Share of small faults in the code that the tests nearest to it find (mutation testing, by Cosmic Ray's operators).

    pip install cosmic-ray
    python benchmarks/mutants.py                          # 300 mutants of all rooms; about an hour of one core
    python benchmarks/mutants.py --rooms statistics --count 40 --seed 3
    python benchmarks/mutants.py --list                   # the sample alone

A sample with a seed of the mutants of each room, in proportion to how many there are. Each is written into a copy of
the project, and the tests of its room are run until one fails; kernels are run as plain Python, so that a change of
them needs no compiling. What survives is printed as a diff: it is to be read, and to be killed by a test or judged to
make no difference. Annotations and texts are not mutated. Ends with 1 where a smaller share than `--least` was killed.
"""

from __future__ import annotations

import argparse
import difflib
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("filters", "stereo_slam_env", "tests", "examples", "docs", "benchmarks", "templates", "pyproject.toml")


@dataclass(frozen=True)
class Room:
    """Files that are mutated together, and the tests that are to find it."""

    files: tuple[str, ...]
    """Patterns, from the root of the project."""
    tests: tuple[str, ...]
    """Files and folders of tests; first those that are quick."""
    compiled: bool = True
    """Whether the tests use compiled kernels, none of which is mutated."""


ROOMS = {
    "evaluation": Room(
        ("stereo_slam_env/evaluation/*.py",),
        ("tests/stereo_slam_env/evaluation", "tests/stereo_slam_env/test_loop.py", "tests/stereo_slam_env/test_api.py"),
    ),
    "statistics": Room(
        ("stereo_slam_env/benchmark/statistics/*.py",),
        ("tests/stereo_slam_env/benchmark/statistics", "tests/stereo_slam_env/report"),
    ),
    "loop": Room(
        ("stereo_slam_env/loop.py",), ("tests/stereo_slam_env/test_loop.py", "tests/stereo_slam_env/test_api.py")
    ),
    "monitor": Room(
        ("filters/monitor.py",), ("tests/filters/test_monitor.py", "tests/stereo_slam_env/evaluation/test_alarms.py")
    ),
    "engine": Room(
        ("filters/engine/compiled/*.py", "filters/engine/*.py"),
        (
            *(f"tests/filters/engine/test_{name}.py" for name in ("dense", "exact_numbers", "storage", "textbook")),
            "tests/filters/engine/test_golden.py",
        ),
        compiled=False,
    ),
    "parts": Room(
        tuple(f"filters/{room}/*.py" for room in ("landmarks", "measurements", "motions", "errors", "updates")),
        (
            *(f"tests/filters/{room}" for room in ("landmarks", "measurements", "motions", "updates", "errors")),
            "tests/filters/test_jacobians.py",
            "tests/filters/engine/test_exact_numbers.py",
            "tests/filters/engine/test_textbook.py",
        ),
    ),
}
ARITHMETIC = {"Add": "Sub", "Sub": "Add", "Mul": "Div", "Div": "Mul", "Pow": "Mul", "FloorDiv": "Mul", "Mod": "Add"}
COMPARISONS = {"Lt": "LtE Gt", "LtE": "Lt Gt", "Gt": "GtE Lt", "GtE": "Gt Lt", "Eq": "NotEq", "NotEq": "Eq"}
OPERATORS = (
    *(f"core/ReplaceBinaryOperator_{a}_{b}" for a, b in ARITHMETIC.items()),
    *(f"core/ReplaceComparisonOperator_{a}_{b}" for a, others in COMPARISONS.items() for b in others.split()),
    *(f"core/ReplaceComparisonOperator_{a}_{b}" for a, b in (("Is", "IsNot"), ("IsNot", "Is"))),
    *(f"core/ReplaceUnaryOperator_{name}" for name in ("USub_UAdd", "Delete_USub", "Delete_Not", "Delete_Invert")),
    *(f"core/Replace{name}" for name in ("AndWithOr", "OrWithAnd", "TrueWithFalse", "FalseWithTrue")),
    *("core/NumberReplacer", "core/ReplaceBreakWithContinue", "core/ReplaceContinueWithBreak"),
)
"""One or two changes a place, of those that a person could make by mistake."""
SIGNATURES = ("parameters", "param", "argument", "annassign", "tfpdef")
"""What stands where an operator would and is none: the star of a signature, the bar of an annotation."""


@dataclass(frozen=True)
class Mutant:
    """One small change of one file."""

    room: str
    path: str
    operator: str
    content: str

    @property
    def diff(self) -> str:
        """The lines that differ."""
        lines = difflib.unified_diff((ROOT / self.path).read_text().splitlines(), self.content.splitlines(), n=0)
        return "\n".join(list(lines)[2:])


def sample(rooms: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """`count` mutants of the rooms in an order that the seed fixes, at most one for each place of a file."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    operators = {name: get_operator(name)() for name in OPERATORS}
    places: dict[tuple[str, object], list[tuple[str, str, int]]] = {}
    for room in rooms:
        for path in sorted(path for pattern in ROOMS[room].files for path in ROOT.glob(pattern)):
            nodes, file = list(ast_nodes(get_ast(path.read_text()))), path.relative_to(ROOT).as_posix()
            for name, operator in operators.items():
                found_by = ((node, position) for node in nodes for position in operator.mutation_positions(node))
                for occurrence, (node, position) in enumerate(found_by):
                    if node.parent is None or node.parent.type not in SIGNATURES:
                        places.setdefault((file, position), []).append((room, name, occurrence))
    random.seed(seed)
    order = random.sample(sorted(places, key=str), len(places))
    found: list[Mutant] = []
    for file, position in order:
        code, (room, name, occurrence) = (ROOT / file).read_text(), random.choice(places[file, position])
        content = mutate_code(code, operators[name], occurrence)
        if content is not None and content != code:
            found.append(Mutant(room, file, name, content))
        if len(found) == count:
            break
    return found


def survives(mutant: Mutant, copy: Path, limit: float) -> bool:
    """Whether all tests pass with the mutant in the copy of the project; what takes too long does not."""
    target, room = copy / mutant.path, ROOMS[mutant.room]
    original = target.read_text()
    own = sorted((copy / "tests").rglob(f"test_{target.stem}*.py"))
    tests = [*(path.relative_to(copy).as_posix() for path in own), *room.tests]
    pytest = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:randomly", "-m", "not slow", *dict.fromkeys(tests)]
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    if not room.compiled:
        environment["NUMBA_DISABLE_JIT"] = "1"
    try:
        target.write_text(mutant.content)
        run = subprocess.run(pytest, cwd=copy, env=environment, capture_output=True, timeout=limit, check=False)
        return run.returncode == 0
    except subprocess.TimeoutExpired:
        return False
    finally:
        target.write_text(original)


def main() -> None:
    """Sample, test, and print what survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="+", choices=ROOMS, default=list(ROOMS))
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--least", type=float, default=85.0, help="percent that must be killed")
    parser.add_argument("--limit", type=float, default=600.0, help="seconds for the tests of one mutant")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="print the sample and test nothing")
    arguments = parser.parse_args()
    chosen = sample(arguments.rooms, arguments.count, arguments.seed)
    if arguments.list:
        print("\n".join(f"{mutant.path} {mutant.operator}\n{mutant.diff}" for mutant in chosen))
        return
    began, survivors, total = time.perf_counter(), Counter[str](), Counter(mutant.room for mutant in chosen)
    with tempfile.TemporaryDirectory() as folder:
        copies: SimpleQueue[Path] = SimpleQueue()
        for job in range(arguments.jobs):
            copy = Path(folder, str(job))
            for name in COPIED:
                place = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
                copy.mkdir(exist_ok=True)
                place(ROOT / name, copy / name)
            copies.put(copy)

        def tested(mutant: Mutant) -> bool:
            copy = copies.get()
            try:
                return survives(mutant, copy, arguments.limit)
            finally:
                copies.put(copy)

        with ThreadPoolExecutor(arguments.jobs) as pool:
            for k, (mutant, survived) in enumerate(zip(chosen, pool.map(tested, chosen), strict=True), 1):
                if survived:
                    survivors[mutant.room] += 1
                    print(
                        f"survived ({k} of {len(chosen)}): {mutant.path} {mutant.operator}\n{mutant.diff}", flush=True
                    )
    for room, count in total.items():
        print(f"{room}: {count - survivors[room]} of {count} killed")
    share = 100.0 * (1.0 - survivors.total() / max(1, len(chosen)))
    print(f"{share:.1f} % of {len(chosen)} killed in {time.perf_counter() - began:.0f} s (seed {arguments.seed})")
    sys.exit(share < arguments.least)


if __name__ == "__main__":
    main()
