"""The page that reports are written on, and its tables (about 2 s)."""

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from markupsafe import Markup
from PIL import Image

from stereo_slam_env.files.folders import LIST
from stereo_slam_env.report import page as page_module
from stereo_slam_env.report.charts.axes import PALETTE, Axis
from stereo_slam_env.report.charts.drawing import Curve, Panel, figure
from stereo_slam_env.report.page import figure_block, html_page, on_page, part, write_page
from stereo_slam_env.report.table import Column, Table, TableCell, filter_cell, number


def line(name="a", width=500):
    panel = Panel(Axis(0, 1), Axis(0, 1), width, 200)
    panel.lines([Curve(name, [0, 1], [0, 1], PALETTE[0])])
    return figure([panel], {name: PALETTE[0]})


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page") / "figures"
    return figure_block(line(), "line", "A <line> & more.", folder), folder


def test_a_figure_is_saved_as_png_and_svg_beside_the_page(block):
    markup, folder = block
    with Image.open(folder / "line.png") as image:
        assert image.width > 700
    svg = (folder / "line.svg").read_text(encoding="utf-8")
    assert PALETTE[0] in svg
    assert 'fill="#ffffff"' in svg
    assert 'href="figures/line.png"' in markup
    assert 'href="figures/line.svg"' in markup


def test_a_figure_is_in_the_page_as_drawing_and_as_chart_in_the_colours_of_the_page(block):
    markup, _ = block
    assert markup.count("<svg") == 1
    assert markup.count('class="chart-data"') == 1
    assert markup.count("var(--series-0)") >= 2
    assert PALETTE[0] not in markup
    assert "A &lt;line&gt; &amp; more." in markup


def test_no_control_characters_reach_a_page():
    nasty = "a\x1b]0;owned\x07\x9b2J\u202egnp"
    page = html_page(title=nasty, subtitle=nasty, body=Markup("<p>{}</p>").format(nasty))
    assert not set(page) & set("\x1b\x07\x9b\u202e")
    assert "a\N{REPLACEMENT CHARACTER}]0;owned" in page
    assert page.encode()


def test_a_page_is_written_whole_or_stays_as_it_was(tmp_path, monkeypatch):
    write_page(tmp_path / "new" / "p.html", title="one", subtitle="", contents=[])
    before = (tmp_path / "new" / "p.html").read_text("utf-8")

    def fails(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fails)
    with pytest.raises(OSError, match="No space left"):
        write_page(tmp_path / "new" / "p.html", title="two", subtitle="", contents=[])
    assert (tmp_path / "new" / "p.html").read_text("utf-8") == before
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"p.html", LIST}


def test_data_in_a_page_cannot_end_its_script(tmp_path):
    markup = figure_block(line("</script><script>alert(1)</script>"), "evil", "x", tmp_path / "figures")
    assert markup.count("</script>") == 1


def test_title_and_subtitle_are_escaped_and_the_page_points_nowhere(block):
    markup = html_page(title="a < b", subtitle="<i>", body=block[0]).replace(page_module._vega() or "-", "")
    assert "<title>a &lt; b</title>" in markup
    assert "&lt;i&gt;" in markup
    assert not re.search(r'(src|href)="(https?:)?//|@import', markup)


def test_a_page_with_figures_carries_the_script_for_them_once(block):
    markup = html_page(title="t", subtitle="s", body=block[0] + block[0])
    assert markup.count("vegaEmbed=") == 1
    assert len(markup) < 1_200_000


def test_the_script_is_kept_and_a_folder_that_cannot_be_written_does_not_matter(tmp_path, monkeypatch):
    made = []
    monkeypatch.setattr(page_module.vl_convert, "javascript_bundle", lambda snippet: made.append(snippet) or "x")
    monkeypatch.setattr(page_module, "_KEPT_LIBRARY", tmp_path / "kept.js")
    for place in (tmp_path / "kept.js", tmp_path / "kept.js", tmp_path / "kept.js" / "under a file"):
        monkeypatch.setattr(page_module, "_KEPT_LIBRARY", place)
        page_module._vega.cache_clear()
        assert page_module._vega() == "(() => {x})();"
    page_module._vega.cache_clear()
    assert len(made) == 2


def test_a_page_without_figures_carries_no_library():
    assert len(html_page(title="t", subtitle="s", body="<p>x</p>")) < 50_000


def test_a_table_sorts_by_values_and_shows_text():
    colours = {"mine": PALETTE[3]}
    rows = [[filter_cell("mine", colours), number(1234.5678), number(-2.0, ".1f", " %", "bad"), TableCell("<b>")]]
    markup = on_page(
        Table([Column("Filter", kind="text"), Column("A", "m", "what A is"), Column("B"), Column("C")], rows)
    )
    assert 'data-value="1234.5678">1,230<' in markup
    assert 'class="bad" data-value="-2.0">−2.0 %<' in markup
    assert "--colour: var(--series-3)" in markup
    assert "&lt;b&gt;" in markup
    assert 'title="what A is"' in markup


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_what_is_not_known_is_a_dash_and_sorts_last(value):
    assert number(value) == TableCell("–", None, "none")
    assert 'data-value="">–<' in on_page(Table([Column("A"), Column("B")], [["x", number(value)]]))


def test_a_row_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match="2 cells each, got one with 1"):
        on_page(Table([Column("A"), Column("B")], [["x"]]))


class Text(HTMLParser):
    """What a reader sees."""

    def __init__(self, markup):
        super().__init__()
        self.items = []
        self.feed(markup)

    def handle_data(self, data):
        self.items.append(data)


def test_settings_are_said_whatever_they_are():
    settings = {"a": {"b": 1, "c": {}}, "d": [1, 2], "e": [{"f": {"g": 2}}, {}], "h": None, "i": [], "<j>": "<k>"}
    said = [item.strip() for item in Text(part("settings", settings)).items if item.strip()]
    assert said == [*"ab1c", "none", "d", "1, 2", "e", "f g 2", "none", "h", "none", "i", "none", "<j>", "<k>"]


def test_plain_text_is_escaped_in_every_part_and_markup_is_not():
    assert part("section", "<a>", "<b>", [Markup("<p>c</p>"), "<d>"]) == Markup(
        '<section id="a"><h2>&lt;a&gt;</h2>\n<p class="quiet">&lt;b&gt;</p><p>c</p>\n&lt;d&gt;\n</section>'
    )
    assert part("items", ["<a>"]) == Markup('<ul class="failures"><li>&lt;a&gt;</li></ul>')
    assert part("items", []) == ""
