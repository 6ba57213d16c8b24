"""The command `stereo-slam paper`: the paper's experiments again, and its claims judged."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereo_slam_env.cli.parts import Interrupted, console, one_line_errors, show_place

if TYPE_CHECKING:
    from stereo_slam_env.studies.paper import Claim


def paper(
    quick: Annotated[bool, typer.Option("--quick", help="A minute's worth: most intervals are then too wide.")] = False,
    seeds: Annotated[
        int | None, typer.Option("--seeds", help="Long drives for each noise.", min=1, show_default="20")
    ] = None,
    turns: Annotated[
        int | None, typer.Option("--turns", help="Short turns for each noise.", min=1, show_default="200")
    ] = None,
    jobs: Annotated[int, typer.Option("--jobs", help="Processes, one BLAS thread each.", min=1)] = 2,
    out: Annotated[
        Path | None, typer.Option("--out", help="Directory; an interrupted run in it is resumed.", show_default="new")
    ] = None,
    karlsruhe: Annotated[
        Path | None,
        typer.Option("--karlsruhe", help="Folder of 2009_09_08_drive_0010 and 2009_09_08_drive_0015, to judge too."),
    ] = None,
) -> None:
    """Run the paper's experiments again and judge its claims: figures, a table, one report (15 minutes)."""
    with one_line_errors():
        from stereo_slam_env.report.console import progress_bar
        from stereo_slam_env.studies.paper import FULL, QUICK, run_paper
        from stereo_slam_env.studies.paper.karlsruhe import HOW_TO_GET_IT

        settings = QUICK if quick else FULL
        if seeds is not None:
            settings = dataclasses.replace(settings, drive_seeds=seeds)
        if turns is not None:
            settings = dataclasses.replace(settings, turn_seeds=turns)
        stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
        directory = Path("runs") / f"paper-{stamp}" if out is None else out
        try:
            with progress_bar(console(stderr=True), "parts") as progress:
                result = run_paper(directory, settings, jobs=jobs, karlsruhe_path=karlsruhe, progress=progress)
        except KeyboardInterrupt:
            raise Interrupted(directory) from None
        _show(result.claims)
        if karlsruhe is None:
            typer.echo(HOW_TO_GET_IT)
        show_place(result.report)


def _show(claims: Sequence[Claim]) -> None:
    """The table: claim, measured, verdict."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from stereo_slam_env.studies.paper.claims import Verdict
    from stereo_slam_env.studies.paper.report import measured_range

    colours = {
        Verdict.HOLDS: "green",
        Verdict.HOLDS_ONLY_IF: "yellow",
        Verdict.DOES_NOT_HOLD: "red",
        Verdict.NOT_SHOWN: "dim",
    }
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading, ratio in (("section", 1), ("claim", 5), ("measured", 2), ("verdict", 4)):
        table.add_column(heading, ratio=ratio)
    for claim in claims:
        verdict = f"[{colours[claim.verdict]}]{claim.says}[/]"
        table.add_row(claim.sentence.section, claim.sentence.claim, measured_range(claim.findings), verdict)
    console().print(table, highlight=False)
