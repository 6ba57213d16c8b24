"""Each filter has a page, and every figure on it stands in the section it is taken from (< 1 s)."""

import re
from pathlib import Path

import pytest

from filters import available_filters

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = sorted((DOCS / "filters").glob("*.md"))
ROW = re.compile(r"^\| (?P<what>.+?) \| (?P<figures>.+?) \| \[.+?\]\((?P<page>.+?)#(?P<anchor>.+?)\) \|$", re.MULTILINE)
NUMBER = re.compile(r"\d[\d,.]*(?:e-?\d+)?")


def section(page, anchor):
    """The text of a page from the heading of that anchor to the next one of its rank."""
    text = (DOCS / "filters" / page).resolve().read_text(encoding="utf-8")
    for heading in re.finditer(r"^(#+) (.+)$", text, re.MULTILINE):
        slug = re.sub(r"[^\w\s-]", "", heading[2].lower()).strip().replace(" ", "-")
        if re.sub(r"-+", "-", slug) == anchor:
            rest = text[heading.end() :]
            end = re.search(rf"^#{{1,{len(heading[1])}}} ", rest, re.MULTILINE)
            return rest[: end.start()] if end else rest
    raise AssertionError(f"no heading for {page}#{anchor}")


def numbers(text):
    return {number.rstrip(".,") for number in NUMBER.findall(text)}


def test_each_filter_of_the_package_has_a_page():
    assert {path.stem.replace("_", "-") for path in PAGES} >= set(available_filters())


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_figures_are_those_that_were_measured(path):
    rows = list(ROW.finditer(path.read_text(encoding="utf-8")))
    assert len(rows) >= 2
    for row in rows:
        unknown = numbers(row["figures"]) - numbers(section(row["page"], row["anchor"]))
        assert unknown == set(), f"{row['what']}: {unknown} not in {row['page']}#{row['anchor']}"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_page_tells_strengths_and_failures(path):
    text = path.read_text(encoding="utf-8")
    for heading in ("## Measured", "## Strengths", "## Failures", "**Take it**"):
        assert heading in text
