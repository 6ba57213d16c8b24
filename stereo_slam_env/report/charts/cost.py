"""Figures of cost: time by stage, size of the state, memory."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.report.charts.style import MUTED, WIDTH_INCHES, filter_colours, name_rows, short_number, styled


@styled
def plot_cost(summaries: Sequence[FilterSummary]) -> Figure:
    """Median time of predict and update, dimension of the state and growth of the memory of each filter.

    Parameters
    ----------
    summaries : sequence of FilterSummary
        Panels without a value in any of them are left out.

    Returns
    -------
    matplotlib.figure.Figure
    """
    colours = filter_colours(s.filter_name for s in summaries)
    with_size = any(s.state_size is not None for s in summaries)
    with_memory = any(s.memory_mb for s in summaries)
    figure = Figure(figsize=(WIDTH_INCHES, 0.95 + 0.4 * len(summaries)))
    height = figure.get_figheight()
    widths = [2.0] + [1.0] * (with_size + with_memory)
    figure.subplots_adjust(left=0.15, right=0.97, top=1 - 0.36 / height, bottom=0.4 / height, wspace=0.1)
    panels = list(figure.subplots(1, len(widths), width_ratios=widths, sharey=True, squeeze=False)[0])
    _draw_time(panels[0], summaries, colours)
    sizes = [("State, dimension", [s.state_size for s in summaries])] if with_size else []
    sizes += [("Memory (MB)", [s.memory_mb for s in summaries])] if with_memory else []
    for ax, (title, values) in zip(panels[1:], sizes, strict=True):
        ax.set_title(title)
        for row, (s, value) in enumerate(zip(summaries, values, strict=True)):
            if value is not None:
                ax.barh([row], [value], height=0.5, color=colours[s.filter_name], label=s.filter_name)
                ax.annotate(short_number(value), (value, row), (4, 0), textcoords="offset points", va="center")
        ax.set_xlim(0, 1.25 * max((v for v in values if v is not None), default=1.0) or 1.0)
        ax.tick_params(labelleft=False)
        ax.grid(visible=False, axis="y")
    panels[0].set_ylim(len(summaries) - 0.5, -0.5)
    name_rows(panels[0], [s.filter_name for s in summaries], colours)
    return figure


def _draw_time(ax: Axes, summaries: Sequence[FilterSummary], colours: dict[str, str]) -> None:
    ax.set_title("Median time a frame, pale: predict (ms)")
    for row, s in enumerate(summaries):
        if s.ms_per_frame is None:
            continue
        colour, predict = colours[s.filter_name], s.ms_predict or 0.0
        update = s.ms_update if s.ms_update is not None else s.ms_per_frame
        if predict:
            ax.barh([row], [predict], height=0.5, color=colour, alpha=0.45, label=f"{s.filter_name} | predict")
        ax.barh([row], [update], left=[predict], height=0.5, color=colour, label=f"{s.filter_name} | update")
        total = f"{short_number(s.ms_per_frame)} ms"
        ax.annotate(total, (predict + update, row), (5, 0), textcoords="offset points", va="center", color=MUTED)
    longest = max((s.ms_per_frame for s in summaries if s.ms_per_frame is not None), default=1.0)
    ax.set_xlim(0, 1.15 * longest)
