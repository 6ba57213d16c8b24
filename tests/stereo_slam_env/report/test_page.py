"""The page that reports are written on, and its tables (about 2 s)."""

import re
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from stereo_slam_env.report import page as page_module
from stereo_slam_env.report.charts.style import PALETTE, styled
from stereo_slam_env.report.page import figure_block, page
from stereo_slam_env.report.page_tables import Cell, Column, filter_cell, number, table


@styled
def line():
    figure = Figure(figsize=(5.2, 2))
    figure.subplots().plot([0, 1], [0, 1], color=PALETTE[0], label="a")
    return figure


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


def test_a_figure_without_a_chart_stays_a_drawing(tmp_path):
    figure = Figure(figsize=(3, 2))
    figure.subplots().imshow(np.zeros((2, 2)))
    markup = figure_block(figure, "image", "A picture.", tmp_path / "figures")
    assert "<svg" in markup
    assert "chart-data" not in markup


def test_data_in_a_page_cannot_end_its_script(tmp_path):
    figure = Figure(figsize=(3, 2))
    figure.subplots().plot([0, 1], label="</script><script>alert(1)</script>")
    markup = figure_block(figure, "evil", "x", tmp_path / "figures")
    assert markup.count("</script>") == 1


def test_title_and_subtitle_are_escaped_and_the_page_points_nowhere(block):
    markup = page(title="a < b", subtitle="<i>", body=block[0]).replace(page_module._plotly_library() or "-", "")
    assert "<title>a &lt; b</title>" in markup
    assert "&lt;i&gt;" in markup
    assert not re.search(r'(src|href)="(https?:)?//|@import', markup)


def test_without_plotly_the_page_says_how_to_get_it(block, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    page_module._plotly_library.cache_clear()
    markup = page(title="t", subtitle="s", body=block[0])
    page_module._plotly_library.cache_clear()
    assert "stereo-slam-env[report]" in markup
    assert len(markup) < 200_000


def test_a_page_without_figures_carries_no_library():
    assert len(page(title="t", subtitle="s", body="<p>x</p>")) < 50_000


def test_a_table_sorts_by_values_and_shows_text():
    colours = {"mine": PALETTE[3]}
    rows = [[filter_cell("mine", colours), number(1234.5678), number(-2.0, ".1f", " %", "bad"), Cell("<b>")]]
    markup = table([Column("Filter", kind="text"), Column("A", "m", "what A is"), Column("B"), Column("C")], rows)
    assert 'data-value="1234.5678">1.23e+03<' in markup
    assert 'class="bad" data-value="-2.0">−2.0 %<' in markup
    assert "--colour: var(--series-3)" in markup
    assert "&lt;b&gt;" in markup
    assert 'title="what A is"' in markup


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_what_is_not_known_is_a_dash_and_sorts_last(value):
    assert number(value) == Cell("–", None, "none")
    assert 'data-value="">–<' in table([Column("A"), Column("B")], [["x", number(value)]])


def test_a_row_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match="2 cells each, got one with 1"):
        table([Column("A"), Column("B")], [["x"]])
