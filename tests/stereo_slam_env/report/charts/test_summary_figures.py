"""Figures of accuracy, map, consistency, cost and factors draw for every run and show what they say (about 8 s)."""

import io
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure

from stereo_slam_env.benchmark.statistics.attribution import attribute_runs
from stereo_slam_env.evaluation.landmark_statistics import RangeError
from stereo_slam_env.report.charts.accuracy import plot_efficiency, plot_error_against_bound, plot_segment_errors
from stereo_slam_env.report.charts.consistency import plot_consistency
from stereo_slam_env.report.charts.cost import plot_cost
from stereo_slam_env.report.charts.factor_figures import FactorResponse, plot_effects, plot_factor
from stereo_slam_env.report.charts.interactive import plotly_figure
from stereo_slam_env.report.charts.map_figures import plot_depth_convergence, plot_landmark_errors
from stereo_slam_env.report.charts.style import filter_colours

from ....synthetic_runs import THREE, THREE_ONE_DIVERGING, Behaviour, changed, make_bounds, make_runs, scored


@cache
def summaries(case):
    runs = {
        "three filters": lambda: make_runs(frames=60),
        "one diverging": lambda: make_runs(THREE_ONE_DIVERGING, frames=60),
        "one filter, one run": lambda: make_runs(THREE[:1], seeds=[3], frames=60),
    }[case]()
    return scored(runs, bounds=make_bounds(runs))[0]


PLOTS = {
    "segments": plot_segment_errors,
    "efficiency": plot_efficiency,
    "landmarks": plot_landmark_errors,
    "convergence": plot_depth_convergence,
    "consistency": plot_consistency,
    "cost": plot_cost,
}


@pytest.mark.parametrize("case", ["three filters", "one diverging", "one filter, one run"])
@pytest.mark.parametrize("name", PLOTS)
def test_every_figure_draws_without_a_warning_and_as_a_chart(name, case):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = PLOTS[name](summaries(case))
        figure.savefig(io.BytesIO(), format="svg")
    assert isinstance(figure, Figure)
    series = {entry["name"] for entry in plotly_figure(figure, drawn=True)["layout"]["meta"]["series"]}
    assert {s.filter_name for s in summaries(case)} <= series


def test_a_figure_of_partly_known_summaries_leaves_the_rest_out():
    first, *others = summaries("three filters")
    poor = replace(first, rpe=(), landmark_by_range=(), depth_convergence=(), consistency={})
    poor = changed(poor, memory_mb=None, efficiency_percent=None, ms_predict=None, ms_update=None, state_size=None)
    for plot in PLOTS.values():
        plot([poor, *others]).savefig(io.BytesIO(), format="svg")


def test_the_limit_lies_below_the_errors_it_was_made_from():
    runs = make_runs(frames=60)
    position = plot_error_against_bound(runs, make_bounds(runs, share=0.5)).axes[0]
    lines = {line.get_label(): line.get_ydata() for line in position.lines}
    assert set(lines) == {*(b.name for b in THREE), "limit"}
    assert np.nanmean(lines["limit"]) < np.nanmean(lines["inverse-depth"])


def test_a_limit_of_no_recording_is_refused():
    runs = make_runs(seeds=[0], frames=20)
    with pytest.raises(ValueError, match="at least one of the runs"):
        plot_error_against_bound(runs, {})


def test_the_depth_bias_has_its_standard_error():
    ranges = tuple(RangeError(10.0 * i, 10.0 * (i + 1), 100, 0.5, 0.1 * i, 0.02 * (i + 1), 3.0) for i in range(3))
    bias = plot_landmark_errors([replace(summaries("three filters")[0], landmark_by_range=ranges)]).axes[1]
    ends = [segment[:, 1] for segment in bias.containers[0].lines[2][0].get_segments()]
    np.testing.assert_allclose(ends, [(-0.02, 0.02), (0.06, 0.14), (0.14, 0.26)], atol=1e-12)


def test_a_common_band_is_drawn_once():
    three = summaries("three filters")
    mean = plot_consistency(three).axes[0]
    assert len(mean.collections) < len(three) * len(three[0].consistency) + len(three)


def test_the_bar_of_a_filter_has_its_colour_and_the_length_of_its_time():
    three = summaries("three filters")
    colours = filter_colours(s.filter_name for s in three)
    time = plot_cost(three).axes[0]
    for s in three:
        bars = [c.patches[0] for c in time.containers if c.get_label().startswith(s.filter_name)]
        assert sum(bar.get_width() for bar in bars) == pytest.approx(s.ms_predict + s.ms_update)
    series = plotly_figure(time.get_figure())["layout"]["meta"]["series"]
    assert {entry["name"]: entry["colour"] for entry in series} == colours


@pytest.mark.parametrize("levels", [(0.5, 1.0, 8.0), ("independent pixels", "independent u, v, d", "measured")])
def test_a_factor_has_a_line_or_points_for_each_filter(levels):
    means = {"a": np.array([1.0, 2.0, 3.0]), "b": np.array([2.0, np.nan, 4.0])}
    lows, highs = ({name: factor * values for name, values in means.items()} for factor in (0.9, 1.1))
    figure = plot_factor("sigma (px)", levels, [FactorResponse("Position RMSE (m)", means, lows, highs)])
    spec = plotly_figure(figure)
    assert [len(trace["y"]) for trace in spec["data"]] == [3, 2]
    assert spec["data"][0]["mode"] == ("lines+markers" if levels[0] == 0.5 else "markers")
    assert spec["data"][0]["error_y"]["array"] == pytest.approx([0.1, 0.2, 0.3])


def test_effects_are_told_from_what_is_not_shown():
    factors = {"landmark": ("inverse-depth", "euclidean"), "error": ("so3", "quaternion")}
    filters = [
        Behaviour(f"{landmark}+{error}", 0.1, milliseconds=4.0 if landmark == "euclidean" else 8.0)
        for landmark in factors["landmark"]
        for error in factors["error"]
    ]
    attribution = attribute_runs(factors, scored(make_runs(filters, range(8), frames=40))[1])
    figure = plot_effects(attribution)
    names = {entry["name"] for entry in plotly_figure(figure)["layout"]["meta"]["series"]}
    assert names == {"effect shown", "no effect shown"}
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["Position error", "Pose NEES / 6", "Time"]
