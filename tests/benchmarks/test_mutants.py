"""The nearest tests of a mutant: those that reach the changed statement."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
MONITOR = "filters/monitor.py"


@pytest.fixture(scope="module")
def mutants() -> ModuleType:
    sys.path.insert(0, str(BENCHMARKS))  # as when it is run
    return importlib.import_module("mutants")


CODE = """\
LEVEL = 0.95

def ratio(a, b=2.0):
    if (
        b == 0.0
    ):
        return a
    return sum(
        (a, 1.0),
    ) / b
"""


@pytest.mark.parametrize(
    ("line", "first", "last", "on_call"),
    [(1, 1, 1, False), (3, 3, 3, False), (5, 4, 6, True), (7, 7, 7, True), (9, 8, 10, True)],
    ids=["constant", "default", "condition", "body", "second line of an expression"],
)
def test_a_statement_is_found_by_any_of_its_lines(
    mutants: ModuleType, line: int, first: int, last: int, on_call: bool
) -> None:
    lines, called = mutants.statement(CODE, line)
    assert (lines[0], lines[-1], called) == (first, last, on_call)


def test_tests_that_reach_the_statement_are_run_the_quick_first(mutants: ModuleType) -> None:
    code = (mutants.ROOT / MONITOR).read_text().splitlines()
    line = next(number for number, text in enumerate(code, 1) if text.startswith("        return "))
    seconds = {"": 1.0, "slow.py::test_a": 9.0, "quick.py::test_b": 0.2, "quick.py::test_c": 0.1, "far.py::test_d": 0.0}
    known = mutants.Clean(seconds, {MONITOR: {line: {"slow.py", "quick.py::test_b"}, line + 1: {"quick.py::test_c"}}})
    on_call = mutants.Mutant("monitor", MONITOR, "core/NumberReplacer", line, "")
    assert known.nearest(on_call) == ["quick.py::test_b", "slow.py::test_a"]
    assert known.nearest(on_call, budget=1.0) == ["quick.py::test_b"]
    on_import = mutants.Mutant("monitor", MONITOR, "core/NumberReplacer", 1, "")
    assert known.nearest(on_import) == ["quick.py::test_c", "quick.py::test_b", "slow.py::test_a", "far.py::test_d"]
