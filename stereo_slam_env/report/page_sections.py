"""Tables of a page, aligned and sortable by any column, and as LaTeX; links to files that lie beside it."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from stereo_slam_env.evaluation.figures import UNKNOWN, readable
from stereo_slam_env.files.folders import own_files, write_text
from stereo_slam_env.report.page import part

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


def table(
    columns: Sequence[Column],
    rows: Sequence[Sequence[TableCell | str]],
    *,
    wide: bool = False,
    answers: bool = False,
    latex: Path | None = None,
) -> Markup:
    """Markup of a sortable table.

    Parameters
    ----------
    columns : sequence of Column
        Headings.
    rows : sequence of rows
        One cell a column; a str is plain text. The first cell names the row.
    wide : bool
        Takes the width of the page.
    answers : bool
        The cells answer questions: in large type, with a mark beside and a note below.
    latex : Path, optional
        File, in a folder beside the page, that the table is written to as LaTeX, too, and that is linked below it.

    Raises
    ------
    ValueError
        A row has not as many cells as there are columns.
    """
    for row in rows:
        if len(row) != len(columns):
            raise ValueError(f"rows must have {len(columns)} cells each, got one with {len(row)}")
    look = "answers" if answers else "wide" if wide else ""
    placed = [[_placed(cell) for cell in row] for row in rows]
    if latex is not None:
        alignment = "".join("r" if column.kind == "number" and i else "l" for i, column in enumerate(columns))
        heads = [[column.heading for column in columns], [column.unit for column in columns]]
        body = [[f"{cell.text} ({cell.note})" if cell.note else cell.text for cell in row] for row in placed]
        text = latex_table(alignment, [head for head in heads if any(head)], body)
        own_files(latex.parent.parent, [f"{latex.parent.name}/{latex.name}"])
        write_text(latex, text)
    return part("table", columns, placed, look, f"{latex.parent.name}/{latex.name}" if latex is not None else "")


def _placed(cell: TableCell | str) -> TableCell:
    """A cell with what sorting goes by as text."""
    cell = TableCell(cell) if isinstance(cell, str) else cell
    return replace(cell, key=cell.text if cell.key == "" else "" if cell.key is None else str(cell.key))


_DATA_FILES = (".json", ".csv", ".parquet", ".toml", ".sqlite")
Recordings = Mapping[str, Mapping[str, Path]]
"""Files of the recordings: by the name of the seed's files, then by what they are called ("recording")."""


def data_section(out: Path, recordings: Recordings | None = None) -> Markup:
    """Section of links to the files of a run directory, as far as they are there; empty where there are none."""
    names = sorted(file.name for file in out.glob("[!.]*") if file.suffix in _DATA_FILES)
    found = _found(out, recordings or {})
    if not names and not found:
        return Markup()
    contents = [part("links", "Beside this page:", [(name, quote(name)) for name in names])] if names else []
    if found:
        columns = list(dict.fromkeys(name for row in found.values() for name in row))
        rows = [
            [
                TableCell(seed),
                *(
                    TableCell(row[name].suffix[1:], link=_address(row[name], out)) if name in row else ""
                    for name in columns
                ),
            ]
            for seed, row in found.items()
        ]
        headings = [Column("Files", kind="text"), *(Column(name, kind="text") for name in columns)]
        guide = (
            "Recordings, and trajectories as TUM has them: t x y z qx qy qz qw. Beside each lie the same poses as"
            " .kitti and, with covariances, as .square."
        )
        block = Markup("\n").join([part("paragraph", guide), table(headings, rows)])
        contents.append(part("folded", "Recordings and trajectories", block))
    return part("section", "Data", "", contents, "screen")


def _found(out: Path, recordings: Recordings) -> dict[str, dict[str, Path]]:
    """Files by seed, then by column: recordings, then trajectories, the truth first."""
    found: dict[str, dict[str, Path]] = {}
    for seed, files in recordings.items():
        there = {name: path for name, path in files.items() if path.is_file()}
        if there:
            found[seed] = there
    for path in sorted(
        out.glob("trajectories/*/*.tum"), key=lambda path: (path.parent, path.stem != "truth", path.stem)
    ):
        found.setdefault(path.parent.name, {})[path.stem] = path
    return found


def _address(path: Path, out: Path) -> str:
    return quote(Path(os.path.relpath(path, out)).as_posix())


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
