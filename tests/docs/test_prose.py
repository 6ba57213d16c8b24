"""Prose of the manual is wrapped at 100 columns, and the command is written in one way (< 1 s)."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
NOT_PROSE = re.compile(
    r"^```.*?^```|^\$\$.*?^\$\$|^(?: *[|#>!<]| {4})[^\n]*|^[^\n]*\]\([^\n]*", re.DOTALL | re.MULTILINE
)
"""Code, equations, tables, headings, quotations, pictures, and lines that an address makes long."""


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_lines_are_short(path):
    text = NOT_PROSE.sub("", path.read_text(encoding="utf-8"))
    assert [line for line in text.splitlines() if len(line) > 100] == []


def test_the_first_block_of_the_readme_holds_the_two_commands_that_set_up():
    first = re.search(r"^```\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)[1]
    assert [line.partition("  ")[0] for line in first.splitlines()[:3]] == [
        "make bench",
        "make test",
        "source .venv/bin/activate",
    ]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_command_is_written_in_one_way(path):
    text = path.read_text(encoding="utf-8")
    assert re.findall(r"\S*bin/(?:stereo-slam|pip)\b.*|python -m stereo_slam_env\.cli.*", text) == []
