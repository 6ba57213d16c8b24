"""Code in the manual is real: imports exist, pages and scenarios run, and what comes out is what they say (2 min)."""

import ast
import importlib
import re
from pathlib import Path

import pytest

from stereo_slam_env.benchmark import run_benchmark

from .what_pages_show import GIVEN, SHOWS, diverged_and_failed

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    path.relative_to(ROOT).as_posix(): path for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
OPTIONAL = ("pandas", "polars", "rerun")
SHORTER = {
    "README.md": ('scenario="turn", seeds=6', 'scenario="reference-turn", seeds=2'),
    "docs/benchmark.md": ('run_benchmark("quick", ', 'run_benchmark("reference-turn", '),
    "docs/your_data.md": ("first=100, last=200", "first=0, last=3"),
}
"""A piece of code that takes minutes or a long recording, and what is run in its place."""


def blocks(path, language="python"):
    """The blocks of a page in a language, with the line each begins at."""
    text = path.read_text(encoding="utf-8")
    for match in re.finditer(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        yield text.count("\n", 0, match.start(1)) + 1, match[1]


WITH_CODE = [name for name, path in PAGES.items() if any(blocks(path))]
SCENARIOS = [
    pytest.param(code, id=f"{name}:{line}")
    for name, path in PAGES.items()
    for line, code in blocks(path, "toml")
    if re.search("^kind = ", code, re.MULTILINE)
]


def imported(code):
    """(module, name or None) of everything that a block imports."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, None) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.module, alias.name) for alias in node.names)


@pytest.mark.parametrize("name", WITH_CODE)
def test_what_a_page_imports_exists(name):
    for line, code in blocks(PAGES[name]):
        for module, attribute in imported(code):
            if module.split(".")[0] in OPTIONAL:
                continue
            found = importlib.import_module(module)
            if attribute is not None and not hasattr(found, attribute):
                importlib.import_module(f"{module}.{attribute}")  # a module, or the failure to be seen
            assert found is not None, f"{name}:{line}"


@pytest.mark.parametrize("name", WITH_CODE)
def test_a_page_runs_from_top_to_bottom_and_shows_what_it_says(name, tmp_path, monkeypatch, capsys):
    if name == "docs/vector.md":
        pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page", **GIVEN.get(name, dict)()}
    for line, code in blocks(PAGES[name]):
        exec(compile("\n" * (line - 1) + code.replace(*SHORTER.get(name, ("", ""))), name, "exec"), names)
    SHOWS[name](names, capsys.readouterr().out)


@pytest.mark.parametrize("code", SCENARIOS)
def test_a_scenario_of_the_manual_is_an_example_of_filters_that_work(code, tmp_path):
    """2 seeds of 40 frames of each cell."""
    (tmp_path / "mine.toml").write_text("frames = 40\n" + re.sub("^frames = .*\n", "", code, flags=re.MULTILINE))
    run_benchmark(tmp_path / "mine.toml", tmp_path / "out", seeds=[0, 1])
    diverged, failed = diverged_and_failed(tmp_path / "out")
    assert diverged <= 0.25
    assert failed == 0


def test_nothing_is_expected_of_pages_that_are_not_there():
    assert set(GIVEN) | set(SHORTER) <= set(SHOWS) == set(WITH_CODE)
    assert all(any(piece in code for _, code in blocks(PAGES[name])) for name, (piece, _) in SHORTER.items())
    assert len(SCENARIOS) >= 2
