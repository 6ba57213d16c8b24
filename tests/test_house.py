"""The house stays within its budgets of lines, files and words, `[tool.house]` of pyproject.toml (5 s).

Lines are those of code, without blank ones, comments and docstrings. A budget falls with each issue and is never
raised without saying what it buys.
"""

import ast
import re
import tomllib
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
HOUSE = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["house"]
BY_GRAMMAR = set(HOUSE["names-by-grammar"])
OPENINGS = re.compile(r"^(" + "|".join(HOUSE["openings"]) + r")\b")
PERSONS = re.compile(r"\b(nobody|somebody|whoever|anybody|no one)\b", re.IGNORECASE)
FEW_WORDS = 3
SHOWN = 20
"""Places that a message names."""


@cache
def house():
    """Lines of code by room and file, and the places of each kind of word."""
    rooms, places = defaultdict(dict), defaultdict(list)
    for package in ("filters", "stereo_slam_env"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            parts = name.split("/")
            text = path.read_text(encoding="utf-8")
            tree = ast.parse(text)
            rooms["/".join(parts[:2]) if len(parts) > 2 else parts[0]][name] = code_lines(text, tree)
            for kind, line, words in wording(tree):
                places[kind].append(f"{name}:{line}: {words}")
    return rooms, places


def code_lines(text, tree):
    """Lines that are no docstring, comment or blank."""
    documented = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            documented.update(range(node.lineno, node.end_lineno + 1))
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    return sum(bool(line) and not line.startswith("#") and number not in documented for number, line in lines)


def wording(tree):
    """Kind, line and words of what the language of DESIGN speaks against."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
            first = (ast.get_docstring(node) or "").split("\n")[0]
            line = getattr(node, "lineno", 1)
            if OPENINGS.search(first):
                yield "openings", line, first[:80]
            if first and len(first.split()) <= FEW_WORDS:
                yield "short", line, first
            if PERSONS.search(first):
                yield "persons", line, first[:80]
            if first.startswith("See `"):
                yield "see", line, first[:80]
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in BY_GRAMMAR:
            yield "names", node.lineno, node.id


def test_every_room_has_a_budget():
    assert sorted(HOUSE["rooms"]) == sorted(house()[0])


@pytest.mark.parametrize("room", sorted(HOUSE["rooms"]))
def test_a_room_keeps_its_budget(room):
    files, (lines, count) = house()[0][room], HOUSE["rooms"][room]
    largest = ", ".join(f"{name} {size}" for name, size in sorted(files.items(), key=lambda item: -item[1])[:SHOWN])
    assert sum(files.values()) <= lines, f"{room} has {sum(files.values())} lines of code: {largest}"
    assert len(files) <= count, f"{room} has {len(files)} files: {', '.join(files)}"


def test_the_house_keeps_its_budget():
    sizes = [size for files in house()[0].values() for size in files.values()]
    assert sum(sizes) <= HOUSE["lines"]
    assert len(sizes) <= HOUSE["files"]


@pytest.mark.parametrize("kind", sorted(HOUSE["words"]))
def test_words_only_get_better(kind):
    places, limit = house()[1][kind], HOUSE["words"][kind]
    shown = "\n".join(places[:SHOWN])
    assert len(places) <= limit, f"{len(places)} {kind} where {limit} are allowed, such as\n{shown}"


def test_the_manual_keeps_its_budget():
    pages = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md"]
    words = {page.relative_to(ROOT).as_posix(): len(page.read_text(encoding="utf-8").split()) for page in pages}
    longest = ", ".join(f"{name} {count}" for name, count in sorted(words.items(), key=lambda item: -item[1])[:SHOWN])
    assert sum(words.values()) <= HOUSE["manual-words"], longest
