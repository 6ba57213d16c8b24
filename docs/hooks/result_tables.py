"""Tables of results, made from the packets in `results/` when the site is built: no figure of them is typed.

    <!-- table: reference-turn filters=inverse-depth,dual-bearing columns=rmse,nees -->

Without `filters` each of them has a row; `cell=NAME` chooses the cell of a packet that has several. Of the CSV file
`active_policies` worlds are the cells and policies the filters.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping
from math import sqrt
from pathlib import Path
from typing import TypeVar

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import Files
from mkdocs.structure.pages import Page

RESULTS = Path(__file__).resolve().parents[2] / "results"
LINE = re.compile(r"^<!-- table: (\S+)((?: \w+=\S+)*) -->$", re.MULTILINE)
COLUMNS = {
    "nees": ("pose NEES / 6", "pose_anees"),
    "nis": ("NIS / dof", "nis"),
    "rmse": ("position RMSE, m", "position_rmse_m"),
    "ate": ("rigid ATE, m", "ate_rigid_m"),
    "end_drift": ("error at the end, % of the path", "end_drift_percent"),
    "final_error": ("true error at the end, m", "final_position_error_m"),
    "true": ("change of the true error, %", "true"),
    "claimed": ("change of the predicted sigma, %", "claimed"),
}
"""Name -> title, and the figure of the packet: a mean over the drives, of an RMSE its root mean square."""
Found = TypeVar("Found")
Cells = dict[str, dict[str, dict[str, str]]]
"""Cell -> filter -> figure, as it is shown."""


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put each table in the place of its line; one that cannot be made ends the build."""
    return LINE.sub(lambda line: table(line, page.file.src_uri), markdown)


def table(line: re.Match[str], page: str) -> str:
    """The Markdown of a line: a row for each filter, a column for each figure, and what they are from."""

    def one_of(known: Mapping[str, Found], name: str, what: str) -> Found:
        if name not in known:
            raise PluginError(f"{page}: {line[0]} has no {what} {name!r}, but {', '.join(known)}")
        return known[name]

    path = one_of({path.stem: path for path in sorted(RESULTS.iterdir())}, line[1], "packet")
    settings = {"cell": "", "filters": "", "columns": "", **dict(re.findall(r"(\w+)=(\S+)", line[2]))}
    cells, again = _of_policies(path) if path.suffix == ".csv" else _of_filters(path)
    systems = one_of(cells, settings["cell"] or next(iter(cells)), "cell")
    columns = [one_of(COLUMNS, name, "column") for name in settings["columns"].split(",")]
    rows = [["", *(title for title, _ in columns)], ["---"] * (1 + len(columns))]
    for name in settings["filters"].split(",") if settings["filters"] else systems:
        figures = one_of(systems, name, "filter")
        rows.append([figures["name"], *(one_of(figures, key, "figure") for _, key in columns)])
    of = f"*{figures['drives']} drives, from `results/{path.name}`; `{again}` runs them again.*"
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + f"\n\n{of}"


def _of_filters(path: Path) -> tuple[Cells, str]:
    cells: Cells = {}
    packet = json.loads(path.read_text(encoding="utf-8"))
    options = {choice["label"]: choice["options"] for choice in packet["study"]["cells"][0]["scenario"]["filters"]}
    for cell in packet["cells"]:
        for name, trials in cell["trials"].items():
            stated = [] if "+" in name else [f"{key}={value}" for key, value in options.get(name, {}).items()]
            figures = {key: _mean(key, trials[key]) for _, key in COLUMNS.values() if key in trials}
            figures |= {"name": f"`{' '.join([name, *stated])}`", "drives": str(len(trials["recording"]))}
            cells.setdefault(cell["name"], {})[name] = figures
    return cells, f"stereo-slam verify results/{path.name} --all"


def _mean(key: str, values: list[float | None]) -> str:
    power = 2 if key in ("position_rmse_m", "ate_rigid_m") else 1
    there = [value**power for value in values if value is not None]
    mean = sum(there) / max(len(there), 1) / (6 if key == "pose_anees" else 1)
    return _digits(sqrt(mean) if power == 2 else mean) if there else "–"


def _of_policies(path: Path) -> tuple[Cells, str]:
    worlds: Cells = {}
    for row in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        for key in ("true", "claimed"):
            value, low, high = (_digits(float(row[key + end])) for end in ("", "_low", "_high"))
            row[key] = f"{value} ({low} to {high})"
        row |= {"name": f"`{row['policy']}`", "final_position_error_m": _digits(float(row["final_position_error_m"]))}
        worlds.setdefault(f"{row['world']}+{row['belief']}", {})[row["policy"]] = row
    return worlds, "python benchmarks/active_policies.py"


def _digits(value: float) -> str:
    return f"{value:#.3g}".rstrip(".")
