"""Equations of the manual, typeset when the site is built.

The pages hold LaTeX between dollar signs, which plain viewers of the repository typeset too. docutils turns it into
MathML, which browsers draw by themselves: the site needs no script and no font for it.
"""

from __future__ import annotations

import html
import re

from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

_MATRIX = re.compile(r"<mo>\[</mo>\s*<mtable>(.*?)</mtable>\s*<mo>\]</mo>", re.DOTALL)
"""A matrix in brackets. Only fonts for mathematics have brackets that grow, so the style sheet draws them."""
_LATEX = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
"""What the extension `pymdownx.arithmatex` leaves: inline in a span, a display in a block of its own."""


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn the LaTeX of a page into MathML; what cannot be typeset ends the build with its page and text."""

    def typeset(found: re.Match[str]) -> str:
        display = found[1] == "div"
        latex = html.unescape(found[2]).strip()
        try:
            drawn = tex2mathml(latex, as_block=display)
        except MathError as error:
            raise PluginError(f"{page.file.src_uri}: {error} in the equation {latex}") from error
        drawn = _MATRIX.sub(r'<mtable class="matrix">\1</mtable>', drawn)
        return f'<div class="equation">{drawn}</div>' if display else drawn

    return _LATEX.sub(typeset, content)
