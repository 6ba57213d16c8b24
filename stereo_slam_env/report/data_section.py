"""The data of a report: links to tables, settings, recordings and trajectories that lie beside the page."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from markupsafe import Markup

from stereo_slam_env.report.page import part
from stereo_slam_env.report.page_tables import Column, TableCell, table

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
