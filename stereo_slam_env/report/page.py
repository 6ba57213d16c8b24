"""The page that reports are written on: self-contained, light and dark, printable, with live tables and figures."""

from __future__ import annotations

import json
import logging
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from matplotlib.figure import Figure

from stereo_slam_env.report.charts.figures import in_page_colours, inline_svg, on_white, save_png, svg_of
from stereo_slam_env.report.charts.interactive import plotly_figure
from stereo_slam_env.report.charts.style import WIDTH_INCHES

_log = logging.getLogger(__name__)


def page(*, title: str, subtitle: str, body: str) -> str:
    """Put a body into the page that all reports share.

    Parameters
    ----------
    title, subtitle : str
        Plain text.
    body : str
        Markup: sections, `figure_block`s, `table`s (of `page_tables`). Tables of class "sortable" sort.

    Returns
    -------
    str
        The HTML document; it needs no other file and no network. Figures are interactive where the package plotly
        is installed, else the page says how to get it.
    """
    with_charts = 'class="chart-data"' in body
    library = _plotly_library() if with_charts else None
    missing = with_charts and library is None
    return Template(_resource("page.html")).substitute(
        title=escape(title),
        subtitle=escape(subtitle),
        css=_resource("page.css"),
        body=body,
        note=_STATIC_NOTE if missing else "",
        library=f"<script>{library}</script>" if library else "",
        script=_resource("page.js"),
    )


def figure_block(figure: Figure, name: str, description: str, folder: Path) -> str:
    """Save a figure as PNG and SVG, and return it as markup for a page.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Drawn with the colours of `style`; labels of its artists name the series (see `interactive`).
    name : str
        Of the files, and of the figure in the page: letters, digits, "_" and "-", unique in the page.
    description : str
        One sentence, plain text: the caption, and what a screen reader says.
    folder : Path
        Where `<name>.png` and `<name>.svg` go, beside the page: links in the page are relative to its parent.

    Returns
    -------
    str
        A `<figure>` with the drawing inline and, where it can be read as one, its interactive chart.
    """
    folder.mkdir(parents=True, exist_ok=True)
    save_png(figure, folder / f"{name}.png")
    svg = svg_of(figure)
    (folder / f"{name}.svg").write_text(on_white(svg), encoding="utf-8")
    drawing = inline_svg(svg, name, description)
    share = min(figure.get_figwidth() / WIDTH_INCHES, 1.0)
    place = escape(f"{folder.name}/{name}", quote=True)
    links = f'<a href="{place}.png" download>PNG</a><a href="{place}.svg" download>SVG</a>'
    return (
        f'<figure id="figure-{name}"><div class="scroll"><div class="stage" style="--share: {share:.3f}">{drawing}'
        f"</div></div><figcaption><span>{escape(description)}</span>"
        f'<span class="files">{links}</span></figcaption>{_chart_data(figure, name)}</figure>'
    )


def _chart_data(figure: Figure, name: str) -> str:
    try:
        chart = plotly_figure(figure, drawn=True)
    except ValueError as reason:
        _log.debug("%s stays a drawing: %s", name, reason)
        return ""
    # Inside a script element "<" could end it.
    text = json.dumps(chart, ensure_ascii=False, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f'<script type="application/json" class="chart-data">{in_page_colours(text)}</script>'


_STATIC_NOTE = (
    '<p class="quiet screen">The figures are drawings here. With <code>pip install "stereo-slam-env[report]"</code> '
    "and the report written again they can be zoomed, read off and switched.</p>"
)


@cache
def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


@cache
def _plotly_library() -> str | None:
    try:
        from plotly.offline import get_plotlyjs
    except ImportError:
        return None
    return str(get_plotlyjs()).replace("</script", "<\\/script")
