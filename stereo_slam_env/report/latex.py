"""Tables as LaTeX, for papers: what the page shows, with `booktabs`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stereo_slam_env.report.page_tables import Cell, Column

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
}


def latex_text(text: str) -> str:
    """Plain text as LaTeX: special characters are escaped, line breaks are spaces."""
    return "".join(_COMMANDS.get(character, character) for character in " ".join(text.split()))


def latex_table(columns: Sequence[Column], rows: Sequence[Sequence[Cell]]) -> str:
    """A `tabular`: headings, then units where there are any, then the rows; a note stands in brackets."""
    kinds = "".join("r" if column.kind == "number" and i else "l" for i, column in enumerate(columns))
    heads = [_row([column.heading for column in columns])]
    if any(column.unit for column in columns):
        heads.append(_row([column.unit for column in columns]))
    body = [_row([f"{cell.text} ({cell.note})" if cell.note else cell.text for cell in row]) for row in rows]
    lines = [
        r"% needs \usepackage{booktabs}",
        rf"\begin{{tabular}}{{{kinds}}}",
        r"\toprule",
        *heads,
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _row(cells: Sequence[str]) -> str:
    return " & ".join(map(latex_text, cells)) + r" \\"
