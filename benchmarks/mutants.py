"""Share of small faults in the code that the tests nearest to it find (mutation testing, by Cosmic Ray's operators).

    pip install cosmic-ray coverage
    python benchmarks/mutants.py                          # 300 mutants of all rooms; an hour or two of one core
    python benchmarks/mutants.py --rooms statistics --count 40 --seed 3 --results statistics.jsonl
    python benchmarks/mutants.py --list                   # the sample alone

A sample with a seed of the mutants of each room, in proportion to how many there are. Each is written into a copy of
the project. There, those tests of its room that reach the changed statement are run, quick ones first, until one fails
or they take three times the processor time that they take without it. Kernels are mutated where they run as plain
Python, so that no change needs compiling. What survives is printed as a diff: it is to be read, and to be killed by a
test or judged to make no difference. Annotations and texts are not mutated. `--results` keeps what was found: the same
command goes on where it was ended. `--limit` is that of one run of tests, seconds; `--budget` that of processor time
for the tests of one mutant: the quickest that reach it are run. Ends with 1 where a smaller share than `--least`
percent was killed.
"""

from __future__ import annotations

import ast
import difflib
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest

from harness import arguments

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("filters", "stereo_slam_env", "tests", "examples", "docs", "benchmarks", "templates", "pyproject.toml")


@dataclass(frozen=True)
class Room:
    """Files that are mutated together, and the tests that are to find it."""

    files: tuple[str, ...]
    """Patterns, from the root of the project."""
    tests: tuple[str, ...]
    """Files and folders of tests."""
    compiled: bool = True
    """Whether the tests use compiled kernels, none of which is mutated. Of the engine what compiles is left out."""
    only: str = ""
    """Expression by which pytest chooses among the tests: those that are slow as plain Python are left out."""


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
    "simulator": Room(
        ("stereo_slam_env/simulator/*.py",),
        ("tests/stereo_slam_env/simulator",),
        compiled=False,
        only="not (grazes or differs or moving_bodies_hide or thousand or recorded or with_samples or plain_python)",
    ),
    "sensing": Room(
        ("stereo_slam_env/sensing/*.py",),
        ("tests/stereo_slam_env/sensing", "tests/studies/faults/test_catalogue.py"),
    ),
    "envs": Room(
        ("stereo_slam_env/envs/*.py",),
        ("tests/stereo_slam_env/envs",),
    ),
    "datasets": Room(("stereo_slam_env/datasets/*.py",), ("tests/stereo_slam_env/datasets",)),
    "frontend": Room(("stereo_slam_env/frontend/*.py",), ("tests/stereo_slam_env/frontend",)),
    "engine": Room(
        (
            *(f"filters/kernels/{name}.py" for name in ("correction", "covariance", "frame", "gating")),
            *(f"filters/kernels/{name}.py" for name in ("landmarks", "linearisation", "prediction", "process_noise")),
            *(f"filters/kernels/{name}.py" for name in ("recipe", "records", "retraction", "sigma_points", "entries")),
            *(f"filters/engine/{name}.py" for name in ("engine", "frames", "recipes", "row")),
        ),
        (
            *(f"tests/filters/engine/test_{name}.py" for name in ("dense", "exact_numbers", "storage", "textbook")),
            *(f"tests/filters/engine/test_{name}.py" for name in ("golden", "gauge_walk", "consensus", "gating")),
            *(f"tests/filters/engine/test_{name}.py" for name in ("batch", "drift", "extreme_input", "heavy_tails")),
            *(f"tests/filters/stranger/test_{name}.py" for name in ("blocks", "late_clock", "kernels")),
            *(
                f"tests/filters/state/test_{name}.py"
                for name in ("clones", "added_variables", "variables", "joint_jacobians")
            ),
            *(f"tests/filters/errors/test_{name}.py" for name in ("errors", "first_estimates")),
            "tests/filters/landmarks/test_hybrid.py",
            "tests/filters/motions/test_gravity.py",
            "tests/filters/updates/test_unscented.py",
        ),
        compiled=False,
        only="not (conforms or monte_carlo or better or (believes_what_it_did and not shared-anchor))",
    ),
    "parts": Room(
        (
            *(f"filters/{room}/*.py" for room in ("landmarks", "measurements", "motions")),
            *(f"filters/{name}.py" for name in ("errors",)),
        ),
        (
            *(f"tests/filters/{room}" for room in ("landmarks", "measurements", "motions", "updates", "errors")),
            "tests/filters/test_jacobians.py",
            "tests/filters/state/test_joint_jacobians.py",
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
NO_OPERATORS = ("parameters", "param", "argument", "annassign", "tfpdef", "dictorsetmaker", "star_expr")
"""Where what looks like an operator is none: the star of a signature or of a list, the bar of an annotation."""


@dataclass(frozen=True)
class Mutant:
    """One small change of one file."""

    room: str
    path: str
    operator: str
    line: int
    content: str

    def __str__(self) -> str:
        lines = difflib.unified_diff((ROOT / self.path).read_text().splitlines(), self.content.splitlines(), n=0)
        return "\n".join([f"{self.path} {self.operator}", *list(lines)[2:]])


def sample(rooms: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """`count` mutants of the rooms in an order that the seed fixes, at most one for each place of a file."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    operators = {name: get_operator(name)() for name in OPERATORS}
    places: dict[tuple[str, Any], list[tuple[str, str, int]]] = {}
    for room in rooms:
        for path in sorted(path for pattern in ROOMS[room].files for path in ROOT.glob(pattern)):
            nodes, file = list(ast_nodes(get_ast(path.read_text()))), path.relative_to(ROOT).as_posix()
            for name, operator in operators.items():
                found_by = ((node, position) for node in nodes for position in operator.mutation_positions(node))
                for occurrence, (node, position) in enumerate(found_by):
                    if node.parent is None or node.parent.type not in NO_OPERATORS:
                        places.setdefault((file, position), []).append((room, name, occurrence))
    random.seed(seed)
    order = random.sample(sorted(places, key=str), len(places))
    found: list[Mutant] = []
    for file, position in order:
        code, (room, name, occurrence) = (ROOT / file).read_text(), random.choice(places[file, position])
        content = mutate_code(code, operators[name], occurrence)
        if content is not None and content != code:
            found.append(Mutant(room, file, name, position[0][0], content))
        if len(found) == count:
            break
    return found


@dataclass(frozen=True)
class Clean:
    """The tests of a room without a mutant."""

    seconds: dict[str, float]
    """Processor time of each test; under "" that of starting and collecting."""
    reach: dict[str, dict[int, set[str]]]
    """Tests that run a line of a file, or the file or folder of tests whose fixture does."""

    def nearest(self, mutant: Mutant, budget: float = np.inf) -> list[str]:
        """Tests that run the changed statement, in the order in which to run them; all tests, if it runs on import.

        Of these the quickest that together take no more than the budget, s.
        """
        lines, on_call = statement((ROOT / mutant.path).read_text(), mutant.line)
        reach = self.reach.get(mutant.path, {})
        by_statement = tuple(set().union(*(reach.get(line, ()) for line in lines)))
        by_file = tuple(set().union(*reach.values()) - {""})
        tests = [test for test in self.seconds if test]
        if on_call and by_statement:
            tests = [test for test in tests if test.startswith(by_statement)]
        if budget < np.inf:
            tests.sort(key=self.seconds.__getitem__)
            spent = np.cumsum([self.seconds[test] for test in tests])
            tests = tests[: max(1, int(np.searchsorted(spent, budget)))]
        file = {test: test.partition("::")[0] for test in tests}
        seconds: Counter[str] = Counter()
        for test in tests:
            seconds[file[test]] += self.seconds[test]
        return sorted(
            tests, key=lambda test: (not test.startswith(by_file), seconds[file[test]], file[test], self.seconds[test])
        )


def statement(code: str, line: int) -> tuple[range, bool]:
    """Lines of the innermost statement at a line, without its body, and whether it is run in calls of a function."""
    around = [
        node
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or node.lineno)
    ]
    inner = around[-1]
    last = inner.body[0].lineno - 1 if hasattr(inner, "body") else inner.end_lineno or inner.lineno
    functions = (node for node in around if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return range(inner.lineno, max(last, line) + 1), any(node.body[0].lineno <= line for node in functions)


class Recording:
    """Plugin of pytest: which test runs which lines of `files`, and for how long, is written to `out`."""

    def __init__(self, files: Sequence[str], out: str) -> None:
        from coverage import Coverage

        self.out, self.test, self.seconds = Path(out), "", dict[str, float]()
        self.coverage = Coverage(data_file=None, include=list(files))
        self.coverage.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        """Of one test."""
        began = time.process_time()
        self.seconds.setdefault("", began)
        self.test = item.nodeid
        self.coverage.switch_context(self.test)
        try:
            return (yield)
        finally:
            self.seconds[self.test] = time.process_time() - began

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, request: pytest.FixtureRequest) -> Generator[None, object, object]:
        """Of what tests share: all of them reach it."""
        self.coverage.switch_context(request.node.nodeid)
        try:
            return (yield)
        finally:
            self.coverage.switch_context(self.test)

    def pytest_sessionfinish(self) -> None:
        """Write it."""
        self.coverage.stop()
        data = self.coverage.get_data()
        reach = {file: data.contexts_by_lineno(file) for file in data.measured_files()}
        self.out.write_text(json.dumps({"seconds": self.seconds, "reach": reach}))


class Choice:
    """Plugin of pytest: the chosen tests in their order, after those that there are only with the mutant."""

    def __init__(self, chosen: Sequence[str], known: Iterable[str], seconds: int) -> None:
        self.order, self.known = {test: k for k, test in enumerate(chosen)}, set(known)
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Take the others out."""
        taken = [item for item in items if item.nodeid in self.order or item.nodeid not in self.known]
        items[:] = sorted(taken, key=lambda item: self.order.get(item.nodeid, -1))


def pytest_configure(config: pytest.Config) -> None:
    """Register the plugin that `MUTANTS_TASK` asks for, where pytest loads this file as one."""
    task = json.loads(Path(os.environ["MUTANTS_TASK"]).read_text())
    config.pluginmanager.register(Recording(**task) if "out" in task else Choice(**task))


def copied(folder: Path) -> Path:
    """Make the folder a copy of what is tested."""
    folder.mkdir()
    for name in COPIED:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy2
        copy(ROOT / name, folder / name)
    return folder


def run_tests(copy: Path, room: Room, tests: Iterable[str], task: dict[str, Any], limit: float) -> int:
    """Exit code of pytest in a copy of the project, with one of the plugins; 1 where the limit of time was reached."""
    note = copy / "task.json"
    note.write_text(json.dumps(task))
    options = ["-x", "-q", "-p", "mutants", "-p", "no:randomly", "-m", "not slow"]
    command = [sys.executable, "-m", "pytest", *options, "-k", room.only, *tests]
    path = os.pathsep.join([str(copy), str(copy / "benchmarks"), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "MUTANTS_TASK": str(note)}
    if not room.compiled:
        environment["NUMBA_DISABLE_JIT"] = "1"
    try:
        run = subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=limit, check=False)
    except subprocess.TimeoutExpired:
        return 1
    if run.returncode and "out" in task:
        sys.exit(f"the tests fail without a mutant:\n{run.stdout.decode()[-3000:]}")
    return run.returncode


def clean(copy: Path, room: Room, limit: float) -> Clean:
    """What the tests of a room reach, and their times."""
    out = copy / "clean.json"
    run_tests(copy, room, room.tests, {"files": [str(copy / files) for files in room.files], "out": str(out)}, limit)
    if not out.exists():
        sys.exit(f"the tests took more than {limit:g} s without a mutant: give a larger --limit")
    found = json.loads(out.read_text())
    reach = {
        Path(file).relative_to(copy).as_posix(): {int(line): set(tests) for line, tests in lines.items()}
        for file, lines in found["reach"].items()
    }
    return Clean(found["seconds"], reach)


def tried(mutant: Mutant, copy: Path, known: Clean, limit: float, budget: float) -> int:
    """Exit code of the tests that reach the mutant, in a copy of the project; 0 where it survives."""
    target, tests = copy / mutant.path, known.nearest(mutant, budget)
    seconds = 10 + round(3.0 * sum(known.seconds[test] for test in ("", *tests)))
    task = {"chosen": tests, "known": list(known.seconds), "seconds": seconds}
    files = dict.fromkeys(test.partition("::")[0] for test in tests)
    original = target.read_text()
    try:
        target.write_text(mutant.content)
        return run_tests(copy, ROOMS[mutant.room], files, task, limit)
    finally:
        target.write_text(original)


def main() -> None:
    """Sample, test, and print what survived."""
    given = arguments(
        __doc__,
        rooms=list(ROOMS),
        count=300,
        seed=0,
        least=85.0,
        limit=1200.0,
        budget=np.inf,
        jobs=1,
        results=Path,
        list=False,
    )
    chosen = sample(given.rooms, given.count, given.seed)
    if given.list:
        print("\n".join(map(str, chosen)))
        return
    known: dict[str, int] = {}
    if given.results and given.results.exists():
        results = map(json.loads, given.results.read_text().splitlines())
        known = {result["mutant"]: result["code"] for result in results}
    untested = [mutant for mutant in chosen if str(mutant) not in known]
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(given.jobs) as pool:
        copies: SimpleQueue[Path] = SimpleQueue()
        for job in range(given.jobs):
            copies.put(copied(Path(folder, str(job))))
        rooms = {mutant.room for mutant in untested}
        without = {room: clean(Path(folder, "0"), ROOMS[room], given.limit) for room in sorted(rooms)}

        def tested(mutant: Mutant) -> tuple[int, float]:
            copy, began = copies.get(), time.perf_counter()
            try:
                code = tried(mutant, copy, without[mutant.room], given.limit, given.budget)
                return code, time.perf_counter() - began
            finally:
                copies.put(copy)

        for mutant, (code, seconds) in zip(untested, pool.map(tested, untested), strict=True):
            known[str(mutant)] = code
            if given.results:
                with given.results.open("a") as file:
                    print(json.dumps({"mutant": str(mutant), "code": code, "seconds": seconds}), file=file)
    for mutant in chosen:
        if known[str(mutant)] == 0:
            print(f"survived: {mutant}")
    for room, count in Counter(mutant.room for mutant in chosen).items():
        print(f"{room}: {sum(known[str(mutant)] != 0 for mutant in chosen if mutant.room == room)} of {count} killed")
    share = 100.0 * sum(known[str(mutant)] != 0 for mutant in chosen) / max(1, len(chosen))
    print(f"{share:.1f} % of {len(chosen)} killed (seed {given.seed})")
    sys.exit(share < given.least)


if __name__ == "__main__":
    main()
