"""Prose of the manual is wrapped at 100 columns, so that a change shows in a few lines (< 1 s)."""

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
