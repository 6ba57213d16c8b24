"""From a figure to a file or into a page."""

from __future__ import annotations

import io
import re
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from stereo_slam_env.report.charts.style import BAND, GRID, INK, MUTED, PALETTE, style_context

PNG_DPI = 160

CSS_VARIABLES = {INK: "--ink", MUTED: "--muted", GRID: "--grid", BAND: "--band"} | {
    colour: f"--series-{i}" for i, colour in enumerate(PALETTE)
}
"""Drawing colour -> name of the CSS variable that takes its place in a page."""


def save_png(figure: Figure, path: Path) -> None:
    """Write the figure on white."""
    with style_context():
        figure.savefig(path, format="png", dpi=PNG_DPI, facecolor="white", pil_kwargs={"compress_level": 1})


def svg_of(figure: Figure) -> str:
    """Draw the figure as an SVG document, with its texts as text, on no background."""
    buffer = io.StringIO()
    with style_context():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def on_white(svg: str) -> str:
    """The SVG document with a white sheet below everything."""
    start = svg.index("<svg")
    end = svg.index(">", start) + 1
    return f'{svg[:end]}\n <rect width="100%" height="100%" fill="#ffffff"/>{svg[end:]}'


def in_page_colours(text: str) -> str:
    """Let the CSS variables of the page take the place of the drawing colours."""
    for colour, variable in CSS_VARIABLES.items():
        text = text.replace(colour, f"var({variable})")
    return text


def inline_svg(svg: str, name: str, description: str) -> str:
    """Turn an SVG document into an `<svg>` element that takes colours and font from the page around it.

    Parameters
    ----------
    svg : str
        From `svg_of`, drawn with the colours of `style`.
    name : str
        Prefix of the ids inside, unique in the page.
    description : str
        What a screen reader says, plain text.

    Returns
    -------
    str
        Markup without any reference to the outside.
    """
    markup = svg[svg.index("<svg") :]
    markup = re.sub(r"<metadata>.*?</metadata>", "", markup, flags=re.DOTALL)
    used = set(re.findall(r'(?:xlink:href="|url\()#(\w+)', markup))
    markup = re.sub(r' id="([^"]*)"', lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", markup)
    markup = re.sub(r'xlink:href="#(\w+)"', rf'href="#{name}-\1"', markup)
    markup = re.sub(r"url\(#(\w+)\)", rf"url(#{name}-\1)", markup)
    view_box = re.search(r'viewBox="[^"]*"', markup)
    assert view_box is not None
    head = f'<svg role="img" aria-label="{escape(description)}" {view_box[0]}>'
    return in_page_colours(re.sub(r"^<svg[^>]*>", lambda _: head, markup))
