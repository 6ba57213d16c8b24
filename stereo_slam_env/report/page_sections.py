"""Tables of a page, aligned and sortable by any column; links to files that lie beside it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from markupsafe import Markup

from stereo_slam_env.files.folders import own_files, write_text
from stereo_slam_env.report.page import part
from stereo_slam_env.report.table import Column, Table, TableCell, latex_table


def on_page(table: Table, latex: Path | None = None) -> Markup:
    """Markup of a sortable table.

    Parameters
    ----------
    table : Table
        Headings and rows.
    latex : Path, optional
        File, in a folder beside the page, that the table is written to as LaTeX, too, and that is linked below it.
    """
    rows = [[replace(cell, key=_sorting_key(cell)) for cell in row] for row in table.cells]
    if latex is None:
        return part("table", table.columns, rows, table.look)
    file = f"{latex.parent.name}/{latex.name}"
    own_files(latex.parent.parent, [file])
    write_text(latex, latex_table(table))
    return part("table", table.columns, rows, table.look, file)


def _sorting_key(cell: TableCell) -> str:
    return cell.text if cell.key == "" else "" if cell.key is None else str(cell.key)


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
        block = Markup("\n").join([part("paragraph", guide), on_page(Table(headings, rows))])
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
