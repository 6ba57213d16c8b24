"""Tables as LaTeX, for papers: what the page shows, with `booktabs`."""

from __future__ import annotations

from collections.abc import Sequence

_COMMANDS = {
    **{special: f"\\{special}" for special in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    "−": "$-$",
    "–": "--",
    "×": r"$\times$",
    "±": r"$\pm$",
    "≤": r"$\leq$",
    "≥": r"$\geq$",
    "°": r"$^\circ$",
    "²": "$^2$",
    "σ": r"$\sigma$",
    "\u00a0": "~",
    "é": r"\'e",
    "·": r"$\cdot$",
    **{raised: f"$^{{{plain}}}$" for raised, plain in zip("⁻⁰¹³⁴⁵⁶⁷⁸⁹", "-013456789", strict=True)},
}


def latex_text(text: str) -> str:
    """Plain text as LaTeX: special characters are escaped, line breaks are spaces."""
    return "".join(_COMMANDS.get(character, character) for character in " ".join(text.split()))


def latex_table(alignment: str, heads: Sequence[Sequence[str]], rows: Sequence[Sequence[str]]) -> str:
    """A `tabular` with columns aligned by the letters "l" and "r": lines of headings, then the rows."""
    lines = [
        r"% needs \usepackage{booktabs}",
        rf"\begin{{tabular}}{{{alignment}}}",
        r"\toprule",
        *map(_row, heads),
        r"\midrule",
        *map(_row, rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _row(cells: Sequence[str]) -> str:
    return " & ".join(map(latex_text, cells)) + r" \\"
