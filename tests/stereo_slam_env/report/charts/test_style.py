"""One look for all figures (< 1 s)."""

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from stereo_slam_env.report.charts.figures import inline_svg, svg_of
from stereo_slam_env.report.charts.style import (
    PALETTE,
    EndLabel,
    filter_colours,
    label_ends,
    shared_limit,
    short_number,
    styled,
)


def test_a_filter_keeps_its_colour_in_any_company_and_order():
    alone = filter_colours(["euclidean"])
    crowd = filter_colours(["mine", "euclidean", "inverse-depth"])
    assert alone["euclidean"] == crowd["euclidean"]
    assert crowd == filter_colours(["inverse-depth", "mine", "euclidean"])
    assert crowd["mine"] not in (crowd["euclidean"], crowd["inverse-depth"])


def test_as_many_filters_as_colours_are_told_apart():
    names = ["inverse-depth", "dual-bearing", "euclidean", *(f"plugin-{i}" for i in range(len(PALETTE) - 3))]
    assert len(set(filter_colours(names).values())) == len(PALETTE)


def test_a_diverged_filter_does_not_set_the_limit():
    limit = shared_limit({"a": 1.0, "b": 1.5, "c": 400.0})
    assert limit.upper == 1.5
    assert limit.beyond == {"c": 400.0}


def test_filters_of_the_same_size_all_fit():
    assert shared_limit({"a": 1.0, "b": 9.0}) == (9.0, {})


@pytest.mark.parametrize("peaks", [{}, {"a": np.nan}, {"a": 0.0}])
def test_a_limit_without_data_is_harmless(peaks):
    assert shared_limit(peaks) == (1.0, {})


@pytest.mark.parametrize(("value", "text"), [(0.0834, "0.083"), (27.2, "27"), (146_000, "150,000"), (1.4e9, "1.4e+09")])
def test_short_numbers_have_two_digits_that_count(value, text):
    assert short_number(value) == text


def test_labels_of_lines_that_end_together_do_not_overlap():
    figure = Figure(figsize=(5, 3))
    ax = figure.add_axes((0.1, 0.1, 0.7, 0.8))
    ax.set(xlim=(0, 1), ylim=(0, 1))
    label_ends(ax, [EndLabel(f"line {i}", 0.5 + 1e-3 * i, "black") for i in range(4)], gap_points=12)
    heights = sorted(text.xy[1] for text in ax.texts)
    assert np.diff(heights).min() * 0.8 * 3 * 72 >= 12 - 1e-9
    assert np.mean(heights) == pytest.approx(0.5, abs=0.01)


def test_style_leaves_the_settings_of_the_caller_alone():
    before = dict(mpl.rcParams)
    styled(Figure)()
    assert dict(mpl.rcParams) == before


def test_inline_svg_takes_its_colours_from_the_page_and_points_nowhere():
    @styled
    def plot():
        figure = Figure(figsize=(3, 2))
        figure.subplots().plot([0, 1], [0, 1], color=PALETTE[0])
        return figure

    markup = inline_svg(svg_of(plot()), "line", "a line")
    assert markup.startswith("<svg role=")
    assert "var(--series-0)" in markup
    assert PALETTE[0] not in markup
    assert "http" not in markup
    assert 'id="line-' in markup
    assert inline_svg(svg_of(plot()), "line", "a line") == markup
