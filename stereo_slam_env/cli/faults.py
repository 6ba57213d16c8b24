"""The command `stereo-slam faults`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereo_slam_env.cli.parts import console, one_line_errors

if TYPE_CHECKING:
    from stereo_slam_env.studies.faults import FaultMatrix


def faults(
    names: Annotated[list[str] | None, typer.Argument(metavar="[FAULT]...", help="Which; none: all.")] = None,
    filters: Annotated[
        str, typer.Option("--filters", help="Names, separated by commas.", metavar="A,B")
    ] = "inverse-depth,dual-bearing,euclidean",
    seeds: Annotated[int, typer.Option("--seeds", help="Drives of each fault and filter.", min=1)] = 3,
    jobs: Annotated[int, typer.Option("--jobs", help="Processes.", min=1)] = 2,
    out: Annotated[
        Path | None, typer.Option("--out", help="Directory for faults.json and faults.md.", show_default="none")
    ] = None,
    show: Annotated[bool, typer.Option("--list", help="Only say which faults there are.")] = False,
) -> None:
    """Feed filters what goes wrong in the field: who copes, who diverges, who is told; exit code 1 if one breaks."""
    with one_line_errors():
        from stereo_slam_env.benchmark.running.backends import Backend
        from stereo_slam_env.benchmark.scenarios.scenario import filter_choice
        from stereo_slam_env.report.console import progress_bar
        from stereo_slam_env.studies.faults import FAULTS, run_matrix

        if show:
            width = max(map(len, FAULTS))
            for name, fault in FAULTS.items():
                typer.echo(f"{name:<{width}}  {fault.line}")
            return
        choices = [filter_choice(name.strip()) for name in filters.split(",")]
        with progress_bar(console(stderr=True), "drives") as progress:
            matrix = run_matrix(choices, tuple(names or FAULTS), seeds, Backend(jobs=jobs), progress)
        if out is not None:
            _write(out, matrix)
        _show(matrix)
        if out is not None:
            typer.echo(f"results: {out.resolve()}")
    if matrix.broken:
        raise typer.Exit(1)


def _write(out: Path, matrix: FaultMatrix) -> None:
    from stereo_slam_env.files.atomic import write_atomically

    figures = json.dumps(matrix.as_dict(), indent=1) + "\n"
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / "faults.json", lambda file: file.write(figures.encode()))
    write_atomically(out / "faults.md", lambda file: file.write(matrix.as_markdown().encode()))


def _show(matrix: FaultMatrix) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("fault", *matrix.filters, "first alarm"):
        table.add_column(heading)
    for row in matrix.rows():
        table.add_row(*map(escape, row))
    console().print(table, highlight=False)
    for line in matrix.sentences():
        typer.echo(line)
