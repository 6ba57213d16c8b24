"""Colours, limits, axes and what a panel makes of its data (2 s)."""

import re
from importlib.resources import files

import numpy as np
import pytest

from stereo_slam_env.report.charts.axes import (
    CSS_VARIABLES,
    PALETTE,
    Axis,
    filter_colours,
    log_ticks,
    shared_limit,
    short_number,
    spread_out,
)
from stereo_slam_env.report.charts.drawing import Chart, Curve, Panel, figure
from stereo_slam_env.report.charts.nees import pose_error_chart
from stereo_slam_env.report.page import inline_svg

from .reading import panels, values


def drawn(curve):
    panel = Panel(Axis(0, 1), Axis(0, 1), 200, 100)
    panel.lines([curve])
    return panels(figure([panel]))[0].rows("lines")[0]


def test_a_filter_keeps_its_colour_in_any_company_and_order():
    alone = filter_colours(["euclidean"])
    crowd = filter_colours(["mine", "euclidean", "inverse-depth"])
    assert alone["euclidean"] == crowd["euclidean"]
    assert crowd == filter_colours(["inverse-depth", "mine", "euclidean"])
    assert crowd["mine"] not in (crowd["euclidean"], crowd["inverse-depth"])


def test_as_many_filters_as_colours_are_told_apart():
    names = ["inverse-depth", "dual-bearing", "euclidean", *(f"plugin-{i}" for i in range(len(PALETTE) - 3))]
    assert len(set(filter_colours(names).values())) == len(PALETTE)


def test_of_one_hue_lines_differ_in_their_dashes_and_dots_in_their_shape():
    colours = filter_colours(f"plugin-{i}" for i in range(12)).values()
    panel = Panel(Axis(0, 1), Axis(0, 1), 200, 100)
    panel.lines(Curve(colour, [0, 1], [0, 1], colour) for colour in colours)
    panel.dots(Curve(colour, [0, 1], [0, 1], colour) for colour in colours)
    (read,) = panels(figure([panel]))
    lines = {tuple(layer["mark"]["strokeDash"]) for layer in read.layers("lines")}
    assert len(lines) == len(read.layers("lines")) == 2
    assert {layer["mark"]["shape"] for layer in read.layers("dots")} == {"circle", "square"}
    assert len(read.rows("lines")) == len(read.rows("dots")) == 12
    css = files("stereo_slam_env.report").joinpath("page.css").read_text(encoding="utf-8")
    assert set(CSS_VARIABLES.values()) <= set(re.findall("(--[a-z]+(?:-[0-9]+)?):", css))


def test_a_diverged_filter_does_not_set_the_limit():
    limit = shared_limit({"a": 1.0, "b": 1.5, "c": 400.0})
    assert limit.upper == 1.5
    assert limit.beyond == {"c": 400.0}


def test_two_that_go_beyond_are_named_and_more_are_counted():
    """The names of many would run into the title of the panel."""
    two = shared_limit({"a": 1.0, "b": 40.0, "c": 400.0})
    assert two.note(" m") == "↑ b to 40 m, c to 400 m"
    assert shared_limit({**two.beyond, "a": 1.0, "d": 90.0}).note(" m") == "↑ 3 filters to 400 m at the most"


def test_filters_of_the_same_size_all_fit():
    assert shared_limit({"a": 1.0, "b": 9.0}) == (9.0, {})


@pytest.mark.parametrize("peaks", [{}, {"a": np.nan}, {"a": 0.0}])
def test_a_limit_without_data_is_harmless(peaks):
    assert shared_limit(peaks) == (1.0, {})


@pytest.mark.parametrize(("value", "text"), [(0.0834, "0.083"), (27.2, "27"), (146_000, "150,000"), (1.4e9, "1.4·10⁹")])
def test_short_numbers_have_two_digits_that_count(value, text):
    assert short_number(value) == text


def test_labels_that_want_one_place_are_moved_apart_evenly():
    places = spread_out([0.5, 0.5, 0.5, 0.9], 0.1)
    assert np.diff(places).min() >= 0.1 - 1e-9
    assert places[:3] == pytest.approx([0.4, 0.5, 0.6])
    assert places[3] == 0.9


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [(0.1, 40.0, [0.1, 0.2, 0.5, 1, 2, 5, 10, 20]), (0.9, 1.5, [0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5]), (1e-3, 1e6, 10)],
)
def test_a_log_axis_has_a_few_round_numbers(low, high, ticks):
    found = log_ticks(low, high)
    assert len(found) <= 12
    assert (len(found) == ticks) if isinstance(ticks, int) else found == pytest.approx(ticks)


def test_values_have_their_place_on_linear_log_and_reversed_axes():
    assert Axis(0, 10).share(2.5) == 0.25
    assert Axis(1, 100, log=True).share(10) == pytest.approx(0.5)
    assert Axis(0, 10, reverse=True).share(2.5) == 0.75


def test_a_long_curve_is_thinned_and_keeps_its_peaks_and_gaps():
    y = np.sin(np.linspace(0, 40, 20_000))
    y[777], y[10_000] = 9.0, np.nan
    row = drawn(Curve("a", np.linspace(0, 1, len(y)), y, PALETTE[0]))
    assert len(row["y"]) < 200  # px
    assert np.nanmax(values(row)) == 9.0
    assert None in row["y"]


def test_what_is_not_known_leaves_a_gap_and_no_dot():
    curve = Curve("a", [0.0, 0.5, 1.0], [0.1, np.nan, 0.3], PALETTE[0])
    assert drawn(curve)["y"] == [0.1, None, 0.3]
    panel = Panel(Axis(0, 1), Axis(0, 1), 200, 100)
    panel.dots([curve])
    assert panels(figure([panel]))[0].rows("dots")[0]["x"] == [0.0, 1.0]


def test_a_data_set_that_two_layers_draw_is_there_once():
    panel = Panel(Axis(0, 1), Axis(0, 1), 200, 100)
    panel.lines([Curve("a", [0, 1], [0, 1], PALETTE[0])])
    spec = figure([panel]).spec
    assert len(spec["concat"][0]["layer"]) == 2  # the line, and what hovering finds
    assert len(spec["datasets"]) == 1


def test_inline_svg_takes_its_colours_from_the_page_and_points_nowhere():
    panel = Panel(Axis(0, 1), Axis(0, 1), 200, 100)
    panel.lines([Curve("a", [0, 1], [0, 1], PALETTE[0])])
    svg = figure([panel]).svg()
    markup = inline_svg(svg, "line", 'a "line"')
    assert markup.startswith('<svg role="img" aria-label="a &#34;line&#34;"')
    assert "var(--series-0)" in markup
    assert PALETTE[0] not in markup
    assert "http" not in markup
    assert "url(#line-" in markup
    assert inline_svg(figure([panel]).svg(), "line", 'a "line"') == markup


def test_words_that_look_like_markup_stay_words_in_a_drawing():
    panel = Panel(Axis(0, 1), Axis(0, 1), 200, 100, title='<b class="x">')
    markup = inline_svg(figure([panel]).svg(), "evil", "x")
    assert '&lt;b class="x"&gt;' in markup


def test_a_chart_from_elsewhere_is_drawn_too(tmp_path):
    spec = {"data": {"values": [{"a": 1}]}, "mark": "point", "encoding": {"x": {"field": "a", "type": "quantitative"}}}
    Chart(spec).save(tmp_path / "own.png", tmp_path / "own.svg")
    assert (tmp_path / "own.png").read_bytes().startswith(b"\x89PNG")
    assert 'fill="#ffffff"' in (tmp_path / "own.svg").read_text()


def test_a_curve_that_goes_far_beyond_its_panel_stays_where_a_renderer_has_coordinates(tmp_path):
    """A filter that was lost by 10^6 panels ended the process that drew its report."""
    assert np.abs(values(drawn(Curve("a", [0.0, 0.5, 1.0], [0.5, 1e9, -1e9], PALETTE[0])))).max() < 2e4
    time, sigma = np.linspace(0.0, 20.0, 200), np.tile(np.linspace(1e-6, 6.0, 200)[:, None], (1, 6))
    error = np.tile(3.1 * np.sin(time)[:, None], (1, 6))
    pose_error_chart("lost", time, error, sigma, np.full(6, 2e-6)).save(tmp_path / "lost.png")
    assert (tmp_path / "lost.png").read_bytes().startswith(b"\x89PNG")
