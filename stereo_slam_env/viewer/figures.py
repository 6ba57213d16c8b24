"""From a figure to a file or into a page."""

from __future__ import annotations

import io
import re
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from stereo_slam_env.viewer.style import BAND, GRID, INK, MUTED, PALETTE, style_context

PNG_DPI = 160

CSS_VARIABLES = {INK: "--ink", MUTED: "--muted", GRID: "--grid", BAND: "--band"} | {
    colour: f"--series-{i}" for i, colour in enumerate(PALETTE)
}
"""Drawing colour -> name of the CSS variable that takes its place in a page."""


def save_png(figure: Figure, path: Path) -> None:
    """Write the figure on white."""
    with style_context():
        figure.savefig(path, format="png", dpi=PNG_DPI, facecolor="white")


def save_svg(figure: Figure, path: Path) -> None:
    """Write the figure on white, with its texts as text."""
    with style_context():
        figure.savefig(path, format="svg", facecolor="white", metadata={"Date": None})


def in_page_colours(text: str) -> str:
    """Let the CSS variables of the page take the place of the drawing colours."""
    for colour, variable in CSS_VARIABLES.items():
        text = text.replace(colour, f"var({variable})")
    return text


def inline_svg(figure: Figure, name: str, description: str) -> str:
    """Turn the figure into an `<svg>` element that takes colours and font from the page around it.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Drawn with the colours of `style`.
    name : str
        Prefix of the ids inside, unique in the page.
    description : str
        What a screen reader says, plain text.

    Returns
    -------
    str
        Markup without any reference to the outside.
    """
    buffer = io.StringIO()
    with style_context():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    markup = buffer.getvalue()
    markup = markup[markup.index("<svg") :]
    markup = re.sub(r"<metadata>.*?</metadata>", "", markup, flags=re.DOTALL)
    used = set(re.findall(r'(?:xlink:href="|url\()#(\w+)', markup))
    markup = re.sub(r' id="([^"]*)"', lambda m: f' id="{name}-{m[1]}"' if m[1] in used else "", markup)
    markup = re.sub(r'xlink:href="#(\w+)"', rf'href="#{name}-\1"', markup)
    markup = re.sub(r"url\(#(\w+)\)", rf"url(#{name}-\1)", markup)
    view_box = re.search(r'viewBox="[^"]*"', markup)
    assert view_box is not None
    head = f'<svg role="img" aria-label="{escape(description)}" {view_box[0]}>'
    return in_page_colours(re.sub(r"^<svg[^>]*>", lambda _: head, markup))
