"""A figure that stands twice in the manual is the same in both places (< 1 s).

Pages that sum up, of the results and of each filter, and the README take their figures from the sections that they
link to; each of them must stand there, rounded if need be.
"""

import re
from pathlib import Path

import pytest

from filters import available_filters

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted((DOCS / "filters").glob("*.md"))
ROW = re.compile(r"^\| (?P<what>.+?) \| (?P<figures>.+?) \| \[.+?\]\((?P<page>.+?)#(?P<anchor>.+?)\) \|$", re.MULTILINE)
LINK = re.compile(r"\]\((?P<page>[^)#\s:]+\.md)#(?P<anchor>[\w-]+)\)")
"""To a section: in a whole page any number stands somewhere."""
NUMBER = re.compile(r"\d[\d,.]*(?:e-?\d+)?")
NO_FIGURE = re.compile(r"\]\([^)]*\)|`[^`]*`|KITTI \d\d|NEES ?/ ?[36]|§ [\d.]+|95 %|(?<=[≥≤] )[\d.]+ px")
"""Addresses, code, and numbers that belong to a name or are a choice, in the prose of summaries."""
SUMMARIES = {
    DOCS / "results.md": None,
    ROOT / "README.md": ("A result",),
}
"""Pages that sum up, and which of their sections; None: all."""


def section(page, anchor):
    """The text of a page from the heading of that anchor, included, to the next one of its rank."""
    text = page.read_text(encoding="utf-8")
    for heading in re.finditer(r"^(#+) (.+)$", text, re.MULTILINE):
        slug = re.sub(r"[^\w\s-]", "", heading[2].lower()).strip().replace(" ", "-")
        if re.sub(r"-+", "-", slug) == anchor:
            rest = text[heading.end() :]
            end = re.search(rf"^#{{1,{len(heading[1])}}} ", rest, re.MULTILINE)
            return heading[2] + (rest[: end.start()] if end else rest)
    raise AssertionError(f"no heading for {page}#{anchor}")


def numbers(text):
    return {number.rstrip(".,") for number in NUMBER.findall(text)}


def stands(number, there):
    """Whether a number is one of those there, or one of them rounded to its decimal places."""
    places = len(number.partition("e")[0].partition(".")[2])
    plain = (other.replace(",", "") for other in there if other.count(".") < 2)
    return number in there or any(f"{float(other):.{places}f}" == number.replace(",", "") for other in plain)


def unfounded(text, page):
    """Figures of a text that stand in none of the sections that it links to."""
    links = list(LINK.finditer(text))
    sections = " ".join(section((page.parent / link["page"]).resolve(), link["anchor"]) for link in links)
    text, there = NO_FIGURE.sub("", text), numbers(NO_FIGURE.sub("", sections))
    return sorted(number for number in numbers(text) if not stands(number, there))


def _summaries():
    for page, wanted in SUMMARIES.items():
        for part in re.split(r"^## ", page.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
            title = part.splitlines()[0]
            if wanted is None or title in wanted:
                yield pytest.param(page, part, id=f"{page.stem}: {title}")


SECTIONS = list(_summaries())


def test_each_filter_of_the_package_has_a_page():
    assert {path.stem.replace("_", "-") for path in PAGES} >= set(available_filters())


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_figures_are_those_that_were_measured(path):
    rows = list(ROW.finditer(path.read_text(encoding="utf-8")))
    assert len(rows) >= 2
    for row in rows:
        there = numbers(section((path.parent / row["page"]).resolve(), row["anchor"]))
        unknown = numbers(row["figures"]) - there
        assert unknown == set(), f"{row['what']}: {unknown} not in {row['page']}#{row['anchor']}"


@pytest.mark.parametrize(("page", "part"), SECTIONS)
def test_a_summary_has_the_figures_of_the_sections_that_it_links_to(page, part):
    assert LINK.search(part), "no link to where it was measured"
    assert unfounded(part, page) == []


def test_another_figure_would_be_found():
    """Each figure of a summary, a little larger: it stands by chance in one long section or the other."""
    found = []
    for page, part in (case.values for case in SECTIONS):
        for number in sorted(numbers(NO_FIGURE.sub("", part))):
            if re.fullmatch(r"\d*\.\d{2,}", number):
                other = f"{float(number) * 1.07:.{len(number.partition('.')[2])}f}"
                found.append(other in unfounded(part.replace(number, other), page))
    assert len(found) > 20
    assert sum(found) > 0.4 * len(found)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_a_page_tells_strengths_and_failures(path):
    text = path.read_text(encoding="utf-8")
    for heading in ("## Measured", "## Strengths", "## Failures", "**Take it**"):
        assert heading in text
