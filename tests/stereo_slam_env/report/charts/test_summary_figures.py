"""Figures of accuracy, map, consistency, cost and factors draw for every run and show what they say (about 8 s)."""

import warnings
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.attribution import attribute_runs
from stereo_slam_env.evaluation.figures import FIGURES
from stereo_slam_env.evaluation.landmark_statistics import RangeError
from stereo_slam_env.report.charts.accuracy import plot_efficiency, plot_error_against_bound, plot_segment_errors
from stereo_slam_env.report.charts.axes import filter_colours
from stereo_slam_env.report.charts.factors import FactorResponse, plot_changes, plot_cost, plot_effects, plot_factor
from stereo_slam_env.report.charts.nees import (
    plot_consistency,
    plot_depth_convergence,
    plot_landmark_errors,
)

from ....synthetic_runs import THREE, THREE_ONE_DIVERGING, Behaviour, changed, make_bounds, make_runs, scored
from .reading import panels, series_of, values


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
def test_every_figure_draws_without_a_warning_and_offers_its_filters(name, case):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chart = PLOTS[name](summaries(case))
        assert "NaN" not in chart.svg()
    assert {s.filter_name for s in summaries(case)} <= set(series_of(chart))


def test_a_figure_of_partly_known_summaries_leaves_the_rest_out():
    first, *others = summaries("three filters")
    poor = replace(first, rpe=(), landmark_by_range=(), depth_convergence=(), consistency={})
    poor = changed(poor, memory_mb=None, efficiency_percent=None, ms_predict=None, ms_update=None, state_size=None)
    for plot in PLOTS.values():
        assert plot([poor, *others]).svg().startswith("<svg")


def test_the_limit_lies_below_the_errors_it_was_made_from():
    runs = make_runs(frames=60)
    position = panels(plot_error_against_bound(runs, make_bounds(runs, share=0.5)))[0]
    lines = {name: values(row) for name, row in position.curves().items()}
    assert set(lines) == {*(b.name for b in THREE), "limit"}
    assert np.nanmean(lines["limit"]) < np.nanmean(lines["inverse-depth"])


def test_a_limit_of_no_recording_is_refused():
    runs = make_runs(seeds=[0], frames=20)
    with pytest.raises(ValueError, match="at least one of the runs"):
        plot_error_against_bound(runs, {})


def test_the_depth_bias_has_its_standard_error():
    ranges = tuple(RangeError(10.0 * i, 10.0 * (i + 1), 100, 0.5, 0.1 * i, 0.02 * (i + 1), 3.0) for i in range(3))
    bias = panels(plot_landmark_errors([replace(summaries("three filters")[0], landmark_by_range=ranges)]))[1]
    (row,) = bias.rows("intervals")
    np.testing.assert_allclose(values(row, "low"), [-0.02, 0.06, 0.14], atol=1e-9)
    np.testing.assert_allclose(values(row, "high"), [0.02, 0.14, 0.26], atol=1e-9)


def test_a_common_band_is_drawn_once():
    three = summaries("three filters")
    assert len(panels(plot_consistency(three))[0].rows("boxes")) < len(three) * len(three[0].consistency)


def test_the_bar_of_a_filter_has_its_colour_and_the_length_of_its_time():
    three = summaries("three filters")
    chart = plot_cost(three)
    bars = panels(chart)[0].rows("boxes")
    colours = filter_colours(s.filter_name for s in three)
    for s in three:
        own = [bar for bar in bars if bar["key"] == s.filter_name]
        assert sum(bar["x1"] - bar["x0"] for bar in own) == pytest.approx(s.ms_predict + s.ms_update, rel=1e-3)
        assert {bar["colour"] for bar in own} == {colours[s.filter_name]}
    assert series_of(chart) == colours


def test_bars_say_what_the_table_says():
    three = summaries("three filters")
    three = [replace(s, figures={**s.figures, "state_size": 255.0 - 18 * k}) for k, s in enumerate(three)]
    drawn = panels(plot_cost(three))
    for panel, name, unit in zip(drawn, ("ms_per_frame", "state_size"), (" ms", ""), strict=False):
        assert {FIGURES[name].text(s.figures[name]) + unit for s in three} <= set(panel.words())


@pytest.mark.parametrize("levels", [(0.5, 1.0, 8.0), ("independent pixels", "independent u, v, d", "measured")])
def test_a_factor_has_a_line_or_points_for_each_filter(levels):
    means = {"a": np.array([1.0, 2.0, 3.0]), "b": np.array([2.0, np.nan, 4.0])}
    lows, highs = ({name: factor * values for name, values in means.items()} for factor in (0.9, 1.1))
    (panel,) = panels(plot_factor("sigma (px)", levels, [FactorResponse("Position RMSE (m)", means, lows, highs)]))
    a, b = panel.rows("dots")
    assert (len(a["y"]), len(b["y"])) == (3, 2)
    assert len(panel.rows("lines")) == (2 if levels[0] == 0.5 else 0)
    assert values(panel.rows("intervals")[0], "high") == pytest.approx([1.1, 2.2, 3.3])


def test_effects_are_told_from_what_is_not_shown():
    factors = {"landmark": ("inverse-depth", "euclidean"), "error": ("so3", "quaternion")}
    filters = [
        Behaviour(f"{landmark}+{error}", 0.1, milliseconds=4.0 if landmark == "euclidean" else 8.0)
        for landmark in factors["landmark"]
        for error in factors["error"]
    ]
    attribution = attribute_runs(factors, scored(make_runs(filters, range(8), frames=40))[1])
    chart = plot_effects(attribution)
    assert set(series_of(chart)) == {"effect shown", "no effect shown"}
    shown = panels(chart)
    assert [panel.title for panel in shown] == ["Position error", "Pose NEES / 6", "Time"]
    assert {row["key"] for row in shown[2].rows("dots")} == {"effect shown", "no effect shown"}


def test_a_change_stands_right_of_the_line_where_it_grew():
    changes = [
        SimpleNamespace(filter_name="mine", measure="time", interval_percent=(10.0, 30.0)),
        SimpleNamespace(filter_name="mine", measure="unknown", interval_percent=None),
    ]
    (panel,) = panels(plot_changes(changes))
    (row,) = panel.rows("dots")
    assert values(row, "x") == pytest.approx([np.sqrt(1.1 * 1.3)], rel=1e-4)
    assert panel.x[0] < 1.0 < panel.x[1]
