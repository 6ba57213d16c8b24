"""Tables of a page: aligned, sortable by any column, the first column fixed while the rest scrolls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

import numpy as np

from stereo_slam_env.report.charts.figures import CSS_VARIABLES

Tone = Literal["", "good", "fair", "bad", "none"]

UNKNOWN = "–"
"""What a cell without a value shows."""


@dataclass(frozen=True)
class Column:
    """A heading.

    Attributes
    ----------
    heading, unit : str
        First and second line.
    explanation : str
        Shown when hovering.
    kind : str
        "number" (right), "text" (left) or "words" (left, may wrap).
    link : str
        Relative address behind the unit.
    """

    heading: str
    unit: str = ""
    explanation: str = ""
    kind: Literal["number", "text", "words"] = "number"
    link: str = ""


@dataclass(frozen=True)
class Cell:
    """What a table says at one place.

    Attributes
    ----------
    text : str
        Plain text.
    key : float or str, optional
        What sorting goes by; None sorts to the end, "" takes the text.
    tone : str
        "good", "fair", "bad", "none" (quiet) or "".
    dot : str
        Drawing colour of a dot before the text (of a filter).
    link : str
        Relative address.
    note : str
        A second line below it.
    note_tone : str
        Its tone.
    """

    text: str
    key: float | str | None = ""
    tone: Tone = ""
    dot: str = ""
    link: str = ""
    note: str = ""
    note_tone: Tone = "none"


def number(value: float | None, form: str = ".3g", unit: str = "", tone: Tone = "") -> Cell:
    """Cell of a number, which may be unknown (None, NaN)."""
    if value is None or not np.isfinite(value):
        return Cell(UNKNOWN, None, "none")
    text = format(value, form) if abs(value) < 10_000 or form.endswith("d") else f"{value:.1e}"
    return Cell(f"{text}{unit}".replace("-", "−"), float(value), tone)


def filter_cell(name: str, colours: Mapping[str, str], link: str = "") -> Cell:
    """Cell of a filter's name with the dot of its colour."""
    return Cell(name, name, dot=colours[name], link=link)


def table(columns: Sequence[Column], rows: Sequence[Sequence[Cell | str]], *, wide: bool = False) -> str:
    """Markup of a sortable table.

    Parameters
    ----------
    columns : sequence of Column
        Headings.
    rows : sequence of rows
        One cell a column; a str is plain text. The first cell names the row.
    wide : bool
        Takes the width of the page.

    Raises
    ------
    ValueError
        A row has not as many cells as there are columns.
    """
    for row in rows:
        if len(row) != len(columns):
            raise ValueError(f"rows must have {len(columns)} cells each, got one with {len(row)}")
    heads = "".join(_head(column) for column in columns)
    body = "".join(f"<tr>{_row(columns, row)}</tr>" for row in rows)
    kind = "sortable wide" if wide else "sortable"
    return (
        f'<div class="scroll"><table class="{kind}"><thead><tr>{heads}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _head(column: Column) -> str:
    title = f' title="{escape(column.explanation)}"' if column.explanation else ""
    kind = "" if column.kind == "number" else f' class="{column.kind}"'
    below = escape(column.unit) or "&nbsp;"
    # A heading is a button: a link inside it would not be valid.
    link = f'<a href="{escape(column.link)}">report</a>' if column.link else ""
    return f'<th scope="col"{kind}{title}>{escape(column.heading)}<small>{link or below}</small></th>'


def _row(columns: Sequence[Column], row: Sequence[Cell | str]) -> str:
    return "".join(_cell(cell, column, first=i == 0) for i, (cell, column) in enumerate(zip(row, columns, strict=True)))


def _cell(cell: Cell | str, column: Column, *, first: bool) -> str:
    cell = Cell(cell) if isinstance(cell, str) else cell
    content = escape(cell.text)
    if cell.link:
        content = f'<a href="{escape(cell.link)}">{content}</a>'
    if cell.note:
        content += f'<small class="{cell.note_tone}">{escape(cell.note)}</small>'
    kinds: list[str] = [kind for kind in ("" if column.kind == "number" else column.kind, cell.tone) if kind]
    style = ""
    if cell.dot:
        kinds.append("filter")
        variable = CSS_VARIABLES.get(cell.dot)
        style = f' style="--colour: {f"var({variable})" if variable else escape(cell.dot)}"'
    shown = f' class="{" ".join(kinds)}"' if kinds else ""
    key = cell.text if cell.key == "" else "" if cell.key is None else str(cell.key)
    tag = 'th scope="row"' if first else "td"
    return f'<{tag}{shown}{style} data-value="{escape(key)}">{content}</{tag.split()[0]}>'
