"""The Python in the manual is real: every import in it exists, and pages that stand on their own run (about 25 s)."""

import ast
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    path.relative_to(ROOT).as_posix(): path for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
}
NOT_RUN = {
    "docs/baselines.md": "an excerpt: the drive is yours",
    "docs/benchmark.md": "an excerpt: of runs that take minutes",
    "docs/environment.md": "needs the renderer gl",
    "docs/image_sequences.md": "needs a recording",
    "docs/rendering.md": "needs the renderer gl",
    "docs/statistics.md": "an excerpt: of runs that take minutes",
    "docs/front_end.md": "needs a recording",
    "docs/policies.md": "a drive of minutes, and an excerpt",
}
"""Pages whose blocks are not run, and why; their imports are checked all the same."""
OPTIONAL = ("pandas", "polars", "minari", "rerun")


def blocks(path):
    """The Python blocks of a page with the line each begins at."""
    text = path.read_text(encoding="utf-8")
    for match in re.finditer(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        yield text.count("\n", 0, match.start(1)) + 1, match[1]


WITH_CODE = [name for name, path in PAGES.items() if any(blocks(path))]


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


@pytest.mark.parametrize("name", [name for name in WITH_CODE if name not in NOT_RUN])
def test_a_page_runs_from_top_to_bottom(name, tmp_path, monkeypatch):
    if name == "docs/active_perception.md":
        pytest.importorskip("minari", reason="needs minari (extra rl)")
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "page"}
    for line, code in blocks(PAGES[name]):
        exec(compile("\n" * (line - 1) + code, name, "exec"), names)


def test_pages_that_are_not_run_are_there():
    assert set(NOT_RUN) <= set(WITH_CODE)
