"""A table of figures as one value, and how it is printed on the screen and as LaTeX; pages print it by `on_page`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.table import Table as ScreenTable
from rich.text import Text

from stereo_slam_env.evaluation.figures import UNKNOWN, readable

if TYPE_CHECKING:  # only pages need it
    from markupsafe import Markup

Tone = Literal["", "good", "fair", "bad", "none"]


@dataclass(frozen=True)
class Column:
    """A heading."""

    heading: str
    """First and second line."""
    unit: str = ""
    """First and second line."""
    explanation: str = ""
    """Shown when hovering."""
    kind: Literal["number", "text", "words"] = "number"
    """The "number" (right), "text" (left) or "words" (left, may wrap)."""
    link: str = ""
    """Relative address behind the unit."""


@dataclass(frozen=True)
class TableCell:
    """Cell of a table."""

    text: str
    """Plain text."""
    key: float | str | None = ""
    """What sorting goes by; None sorts to the end, "" takes the text."""
    tone: Tone = ""
    """The "good", "fair", "bad", "none" (quiet) or ""."""
    dot: str = ""
    """Drawing colour of a dot before the text (of a filter)."""
    link: str = ""
    """Relative address."""
    note: str = ""
    """A second line below it."""
    note_tone: Tone = "none"
    """Its tone."""
    mark: Markup | None = None
    """Drawn beside an answer."""

    @property
    def words(self) -> str:
        """The text in one line, with the note in brackets."""
        return f"{self.text} ({self.note})" if self.note else self.text


@dataclass(frozen=True)
class Table:
    """Rows of cells below headings, laid out once and printed on the page, on the screen and as LaTeX.

    Raises
    ------
    ValueError
        A row has not as many cells as there are columns.
    """

    columns: Sequence[Column]
    """Headings of the columns."""
    rows: Sequence[Sequence[TableCell | str]]
    """One cell a column; a str is plain text. The first cell names the row."""
    look: Literal["", "wide", "answers"] = ""
    """Layout on the page: "wide" takes its width; "answers" are in large type, a mark beside and a note below."""
    block: int = 0
    """Rows between two blank lines on the screen; 0: none."""
    latex: str = ""
    """Name of the LaTeX file beside the page, without ending; empty: none."""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"rows must have {len(self.columns)} cells each, got one with {len(row)}")

    @property
    def cells(self) -> list[list[TableCell]]:
        """Rows of cells, plain text included."""
        return [[TableCell(cell) if isinstance(cell, str) else cell for cell in row] for row in self.rows]


def number(value: float | None, form: str = ".3g", unit: str = "", tone: Tone = "") -> TableCell:
    """Cell of a number, which may be unknown (None, NaN)."""
    if value is None or not np.isfinite(value):
        return TableCell(UNKNOWN, None, "none")
    text = format(value, form) if form.endswith("d") else readable(value, form)
    return TableCell(f"{text}{unit}".replace("-", "−"), float(value), tone)


def known(value: float) -> float | None:
    """What sorting goes by: the value, or None where it is not known."""
    return value if np.isfinite(value) else None


def filter_cell(name: str, colours: Mapping[str, str], link: str = "") -> TableCell:
    """Cell of a filter's name with the dot of its colour."""
    return TableCell(name, name, dot=colours[name], link=link)


def show_table(console: Console, table: Table) -> None:
    """Print a table on the screen: as many columns at once as it is wide, each lot beside the names of the rows."""
    cells = table.cells
    rows = [[cell.words for cell in row] for row in cells]
    headings = [", ".join(filter(None, (column.heading, column.unit))) for column in table.columns]
    least, most = [], []
    for k, (column, heading) in enumerate(zip(table.columns, headings, strict=True)):
        texts = [row[k] for row in rows]
        word = max(cell_len(word) for text in (heading, *texts, " -") for word in text.split())
        whole = max(map(cell_len, texts), default=0)
        wraps = column.kind == "words" or k == 0
        least.append(max(word, min(_NAMES_WRAP_AT, whole) if wraps else whole))
        most.append(max(whole, cell_len(heading)))
    columns_left = list(range(1, len(headings)))
    while columns_left:
        placed = [0]
        while columns_left and (len(placed) == 1 or _width([*placed, columns_left[0]], least) <= console.width):
            placed.append(columns_left.pop(0))
        spare = console.width - _width(placed, least)
        printed = ScreenTable(box=None, pad_edge=False, header_style="bold")
        for k in placed:
            width = least[k] + min(max(spare, 0), most[k] - least[k])
            spare -= width - least[k]
            is_number = k > 0 and table.columns[k].kind == "number"
            printed.add_column(escape(headings[k]), justify="right" if is_number else "left", width=width)
        for number_of_row, row in enumerate(rows):
            if table.block and number_of_row and number_of_row % table.block == 0:
                printed.add_row()
            tones = [_SCREEN_TONES.get(cell.tone, "default") for cell in cells[number_of_row]]
            printed.add_row(*(Text(row[k], tones[k]) for k in placed))
        console.print(printed, highlight=False)
        if columns_left:
            console.print()


_SCREEN_TONES = {"good": "green", "fair": "yellow", "bad": "red", "none": "dim"}
_NAMES_WRAP_AT = 24
"""Names of rows and other words are wrapped, in a narrow console, but to no less."""


def _width(columns: Sequence[int], widths: Sequence[int]) -> int:
    """Width of some columns and of the gaps between them."""
    return sum(widths[k] + 2 for k in columns) - 2


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


def latex_table(table: Table) -> str:
    """A `tabular` of a table: lines of headings and units, then the rows."""
    alignment = "".join("r" if column.kind == "number" and i else "l" for i, column in enumerate(table.columns))
    heads = [[column.heading for column in table.columns], [column.unit for column in table.columns]]
    lines = [
        r"% needs \usepackage{booktabs}",
        rf"\begin{{tabular}}{{{alignment}}}",
        r"\toprule",
        *(_row(head) for head in heads if any(head)),
        r"\midrule",
        *(_row([cell.words for cell in row]) for row in table.cells),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _row(cells: Sequence[str]) -> str:
    return " & ".join(map(latex_text, cells)) + r" \\"
