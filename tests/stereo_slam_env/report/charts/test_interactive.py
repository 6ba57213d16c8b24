"""The chart says what the figure shows (about 5 s)."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from stereo_slam_env.report.charts.consistency import plot_nees
from stereo_slam_env.report.charts.interactive import plotly_figure
from stereo_slam_env.report.charts.plots import plot_error_by_run, plot_trajectory, plot_velocity
from stereo_slam_env.report.charts.style import PALETTE, EndLabel, label_ends, styled

from ....synthetic_runs import THREE, make_runs


@styled
def axes(*, scale="linear", title="Error (m)", xlabel="time (s)"):
    figure = Figure(figsize=(10.4, 3))
    ax = figure.add_axes((0.1, 0.2, 0.7, 0.7))
    ax.set(title=title, xlabel=xlabel, yscale=scale)
    return ax


def chart(ax):
    return plotly_figure(ax.get_figure())


def only_trace(ax):
    (trace,) = chart(ax)["data"]
    return trace


def test_a_line_keeps_its_values_colour_name_and_units():
    ax = axes()
    ax.plot([0, 1, 2], [1.0, np.nan, 3.123456], color=PALETTE[1], linestyle="--", label="euclidean")
    trace = only_trace(ax)
    assert trace["x"] == [0, 1, 2]
    assert trace["y"] == [1, None, 3.1235]
    assert trace["line"]["color"] == PALETTE[1]
    assert trace["line"]["dash"] == "dash"
    assert trace["name"] == "euclidean"
    assert trace["hovertemplate"] == "%{y:.4~g} m<br>at %{x:.4~g} s<extra>euclidean</extra>"


def test_limits_scales_and_places_are_those_of_the_figure():
    ax = axes(scale="log")
    ax.plot([1, 2], [0.1, 10.0])
    ax.set(xlim=(0, 4), ylim=(0.01, 100))
    layout = chart(ax)["layout"]
    assert layout["xaxis"]["range"] == [0, 4]
    assert layout["yaxis"]["type"] == "log"
    assert layout["yaxis"]["range"] == [-2, 2]
    assert layout["xaxis"]["domain"] == pytest.approx([0.1, 0.8])
    assert layout["yaxis"]["domain"] == pytest.approx([0.2, 0.9])
    assert layout["meta"]["aspect"] == pytest.approx(10.4 / 3, abs=1e-4)


def test_an_underscore_belongs_to_a_series_without_saying_anything_and_no_label_is_background():
    ax = axes()
    ax.plot([0, 1], [0, 1], label="a")
    ax.plot([0, 1], [0, 2], label="_a")
    ax.plot([0, 1], [0, 3])
    named, silent, background = chart(ax)["data"]
    assert named["name"] == silent["name"] == "a"
    assert silent["hoverinfo"] == background["hoverinfo"] == "skip"
    assert "name" not in background
    assert [series["name"] for series in chart(ax)["layout"]["meta"]["series"]] == ["a"]


def test_a_detail_is_said_and_switched_with_its_series():
    ax = axes()
    ax.plot([0, 1], [0, 1], label="a")
    ax.plot([0, 1], [0, 2], label="a | true error")
    _, detail = chart(ax)["data"]
    assert detail["name"] == "a"
    assert "<extra>a, true error</extra>" in detail["hovertemplate"]


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_a_band_lies_where_it_was_filled(scale):
    ax = axes(scale=scale)
    x = np.linspace(0, 10, 300)
    ax.fill_between(x, np.full(300, 2.0), 3.0 + np.sin(x), color="#dde3ea")
    ax.set_ylim(1, 5)
    trace = only_trace(ax)
    y = [value for value in trace["y"] if value is not None]
    assert trace["fill"] == "toself"
    assert trace["fillcolor"] == "#dde3ea"
    assert min(y) == pytest.approx(2.0, rel=1e-3)
    assert max(y) == pytest.approx(4.0, rel=1e-3)
    assert len(y) < 300


def test_lines_across_the_axes_end_at_their_limits():
    ax = axes()
    ax.set(xlim=(2, 8), ylim=(0, 1))
    ax.axhline(0.5)
    trace = only_trace(ax)
    assert trace["x"] == pytest.approx([2, 8])
    assert trace["y"] == pytest.approx([0.5, 0.5])


def test_bars_have_place_base_and_length():
    ax = axes(xlabel="time (ms)")
    ax.barh([0, 1], [3.0, 4.0], left=[1.0, 0.0], height=0.5, label="update")
    trace = only_trace(ax)
    assert (trace["type"], trace["orientation"]) == ("bar", "h")
    assert (trace["x"], trace["base"]) == ([3, 4], [1, 0])
    assert (trace["y"], trace["width"]) == ([0, 1], [0.5, 0.5])
    assert trace["hovertemplate"] == "%{x:.4~g} ms<extra>update</extra>"


def test_error_bars_say_their_interval():
    ax = axes()
    ax.errorbar([1, 2], [5.0, 6.0], yerr=[[1.0, 2.0], [0.5, 3.0]], label="a")
    trace = only_trace(ax)
    assert trace["error_y"]["array"] == pytest.approx([0.5, 3.0])
    assert trace["error_y"]["arrayminus"] == pytest.approx([1.0, 2.0])
    assert trace["customdata"] == [[4, 5.5], [4, 9]]


def test_error_bars_whose_ends_are_not_known_are_left_out():
    figure = Figure()
    ax = figure.subplots()
    ax.errorbar([1, 2, 3], [5.0, np.nan, 7.0], yerr=[[1.0, 1.0, np.nan], [2.0, 1.0, np.nan]], label="a")
    (trace,) = plotly_figure(figure)["data"]
    assert trace["error_y"]["array"] == [2.0, None, None]
    assert trace["error_y"]["arrayminus"] == [1.0, None, None]


def test_later_drawings_lie_on_top_also_where_error_bars_have_no_length():
    ax = axes()
    ax.errorbar([1, 2], [5.0, 6.0], label="a")
    ax.axhspan(4, 7, zorder=0)
    assert [trace.get("fill") for trace in chart(ax)["data"]] == ["toself", None]


def test_a_named_axis_keeps_its_names_and_is_not_said_as_a_number():
    ax = axes(title="", xlabel="error (m)")
    ax.scatter([0.1, 0.2], [0, 1], label="a")
    ax.set_yticks([0, 1], ["inverse-depth", "<b>"])
    layout, trace = chart(ax)["layout"], only_trace(ax)
    assert layout["yaxis"]["tickvals"] == [0, 1]
    assert ">inverse-depth<" in layout["yaxis"]["ticktext"][0]
    assert "&lt;b&gt;" in layout["yaxis"]["ticktext"][1]
    assert trace["hovertemplate"] == "%{x:.4~g} m<extra>a</extra>"


def test_names_are_escaped_where_they_would_be_read_as_markup():
    ax = axes(title="<i>x</i>")
    ax.plot([0, 1], [0, 1], label="<script>")
    spec = chart(ax)
    assert "<extra>&lt;script&gt;</extra>" in spec["data"][0]["hovertemplate"]
    assert spec["layout"]["annotations"][0]["text"] == "<b>&lt;i&gt;x&lt;/i&gt;</b>"


def test_the_label_at_the_end_of_a_line_carries_its_name_and_height():
    ax = axes()
    ax.plot([0, 1], [0, 1], label="a")
    ax.set(xlim=(0, 1), ylim=(0, 2))
    label_ends(ax, [EndLabel("a", 1.0, PALETTE[0])])
    note = next(note for note in chart(ax)["layout"]["annotations"] if note.get("name") == "a")
    assert (note["xref"], note["x"], note["y"]) == ("x domain", 1.0, 0.5)
    assert note["xshift"] > 0


def test_long_series_are_thinned_without_losing_a_peak():
    ax = axes()
    y = np.zeros(50_000)
    y[31_234] = 7.0
    y[100] = np.nan
    ax.plot(np.arange(50_000), y, label="a")
    trace = only_trace(ax)
    assert len(trace["y"]) < 5000
    assert max(value for value in trace["y"] if value is not None) == 7
    assert None in trace["y"]


def test_axes_that_share_a_scale_zoom_together_and_maps_keep_their_proportions():
    runs = make_runs(THREE[:2], seeds=[0, 1], frames=40)
    velocity, trajectory = (plotly_figure(plot(runs))["layout"] for plot in (plot_velocity, plot_trajectory))
    assert velocity["xaxis2"]["matches"] == velocity["xaxis3"]["matches"] == "x"
    assert trajectory["yaxis"]["scaleanchor"] == "x"


@pytest.mark.parametrize("plot", [plot_trajectory, plot_velocity, plot_error_by_run, plot_nees])
def test_every_filter_can_be_switched_and_the_chart_is_json_that_plotly_accepts(plot):
    figure = plot(make_runs(seeds=range(3), frames=40))
    spec = json.loads(json.dumps(plotly_figure(figure), allow_nan=False))
    assert {b.name for b in THREE} <= {series["name"] for series in spec["layout"]["meta"]["series"]}
    graph_objects = pytest.importorskip("plotly.graph_objects", reason="needs plotly (extra report)")
    graph_objects.Figure(spec)


def test_what_has_no_counterpart_is_refused():
    picture = axes()
    picture.imshow(np.zeros((2, 2)))
    with pytest.raises(ValueError, match="images"):
        chart(picture)
    figure = Figure()
    figure.add_subplot(projection="polar")
    with pytest.raises(ValueError, match="rectilinear"):
        plotly_figure(figure)
