"""What lies beside a page and is linked from it: tables as LaTeX, recordings, trajectories; its contents and key."""

import re
from urllib.parse import unquote

import pytest

from stereo_slam_env.benchmark import FilterChoice, Scenario, run_benchmark
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.study import Cell, Study
from stereo_slam_env.report.benchmark_report import write_report_of
from stereo_slam_env.report.page import on_page
from stereo_slam_env.report.table import Column, Table, TableCell, latex_text

from .test_run_report import Page, without_library

SCENARIO = Scenario(
    "tiny",
    ReferenceSource("short_turn", {"landmarks": 12}),
    filters=(FilterChoice("in_and-out", "inverse-depth"), FilterChoice("theirs", "euclidean")),
    seeds=(0, 1),
    frames=6,
    gate=None,
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    cells = tuple(Cell(f"gate-{gate}", {"gate": gate}, SCENARIO) for gate in (0.9, 0.99))
    study = Study("two gates", cells)
    return run_benchmark(study, tmp_path_factory.mktemp("data") / "run", jobs=1, write_report=write_report_of)


@pytest.fixture(scope="module")
def pages(finished):
    return [finished.report, *finished.report.parent.glob("cells/*/report.html")]


def test_every_link_leads_to_a_file_or_a_place_of_the_page(pages):
    assert len(pages) == 3
    for path in pages:
        page = Page(without_library(path))
        for link in page.links:
            assert link[1:] in page.ids if link.startswith("#") else (path.parent / unquote(link)).is_file(), link


def test_recordings_and_trajectories_are_linked(pages):
    for path in pages[1:]:
        links = Page(without_library(path)).links
        for ending, count in ((".npz", 2), ("/truth.tum", 2), ("/theirs.tum", 2), ("summary.csv", 1)):
            assert sum(link.endswith(ending) for link in links) == count
        assert all((path.parent / link).is_file() for link in links if link.endswith((".npz", "theirs.tum")))


def test_the_contents_name_every_section_in_order(pages):
    for path in pages:
        markup = without_library(path)
        contents = re.search('<nav class="contents.*?</nav>', markup)[0]
        assert re.findall(">([^<]+)</a>", contents) == re.findall("<h2>(.*?)</h2>", markup)


def test_the_key_has_the_colour_of_every_filter_and_says_what_colours_mean(pages):
    for path in pages:
        key = re.search('<div class="colours.*?</div>', without_library(path))[0]
        for words in ("in_and-out", "theirs", "overconfident", "too cautious", "not significant"):
            assert words in key
        assert key.count("--colour: var(--series-") == 2


def test_tables_are_latex_too(pages):
    names = {"accuracy", "consistency", "cost", "pairs"}
    assert {path.stem for path in pages[1].parent.glob("tables/*.tex")} == names
    assert {path.stem for path in pages[0].parent.glob("tables/*.tex")} == {"scenarios", "figures"}
    text = (pages[1].parent / "tables" / "accuracy.tex").read_text(encoding="utf-8")
    head, *_, last = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert head.startswith("Filter & Position error & Rotation error")
    assert last.startswith("theirs & ")
    assert r"in\_and-out & " in text
    (kinds,) = re.findall(r"\\begin{tabular}{(\w+)}", text)
    rows = [line for line in text.splitlines() if line.endswith(r"\\")]
    assert {len(re.findall(r"(?<!\\)&", row)) + 1 for row in rows} == {len(kinds)}
    assert [text.count(rule) for rule in (r"\toprule", r"\midrule", r"\bottomrule")] == [1, 1, 1]


def test_only_what_has_an_ideal_is_said_to_have_one(pages):
    text = (pages[1].parent / "tables" / "consistency.tex").read_text(encoding="utf-8")
    head, unit, *_ = [line.rstrip("\\ ").split(" & ") for line in text.splitlines() if line.endswith("\\\\")]
    ideals = {name: words.strip() for name, words in zip(head, unit, strict=True)}
    assert {name for name, words in ideals.items() if "ideal 1" in words} == {
        name for name in ideals if "NEES /" in name or "NIS" in name
    }
    assert ideals["Frames not scored"] == ""


def test_every_sign_of_the_tables_has_its_latex():
    assert latex_text("1.7·10⁻⁹") == r"1.7$\cdot$10$^{-}$$^{9}$"
    assert latex_text("−3 % of σ ≤ 2 × 4° – a_b & {c} #1 \\x ^ ~ $") == (
        r"$-$3 \% of $\sigma$ $\leq$ 2 $\times$ 4$^\circ$ -- a\_b \& \{c\} \#1 \textbackslash{}x "
        r"\textasciicircum{} \textasciitilde{} \$"
    )


def test_no_table_of_a_report_has_a_sign_that_latex_does_not_know(pages):
    for path in pages:
        for file in path.parent.glob("tables/*.tex"):
            assert file.read_text(encoding="utf-8").isascii(), file


def test_a_note_of_a_cell_stands_in_brackets(tmp_path):
    on_page(Table([Column("a"), Column("b", "m")], [["x", TableCell("1", note="2")]], latex="t"), tmp_path)
    assert r"x & 1 (2) \\" in (tmp_path / "tables/t.tex").read_text()


def test_what_is_wide_can_be_scrolled_by_keys_and_shows_it(pages):
    markup = without_library(pages[1])
    assert markup.count('<div class="scroll" tabindex="0">') == len(re.findall("<table|<figure", markup))
    assert "local" in re.search(r"\.scroll {.*?}", markup, re.DOTALL)[0]  # shadows that the contents cover at the ends
