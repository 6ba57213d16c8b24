"""The command `stereo-slam paper`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereo_slam_env.cli.parts import (
    Interrupted,
    JobsOption,
    OutOption,
    console,
    new_directory,
    show_place,
)

if TYPE_CHECKING:
    from stereo_slam_env.paper import Claim


def paper(
    quick: Annotated[bool, typer.Option("--quick", help="Three minutes: most intervals are then too wide.")] = False,
    seeds: Annotated[
        int | None, typer.Option("--seeds", help="Long drives for each noise.", min=1, show_default="20")
    ] = None,
    turns: Annotated[
        int | None, typer.Option("--turns", help="Short turns for each noise.", min=1, show_default="200")
    ] = None,
    jobs: JobsOption = 2,
    out: OutOption = None,
    real: Annotated[
        list[Path] | None,
        typer.Option("--real", help="A real drive, as `replay` takes it; may be given several times."),
    ] = None,
    karlsruhe: Annotated[
        Path | None,
        typer.Option("--karlsruhe", help="Folder of 2009_09_08_drive_0010 and 2009_09_08_drive_0015, to judge too."),
    ] = None,
    figure: Annotated[
        str | None,
        typer.Option("--figure", help="Only one figure and its sentences: 1 to 6, nees or speed.", show_default="all"),
    ] = None,
) -> None:
    """Run the paper's experiments again and judge its claims: figures, a table, one report (half an hour)."""
    from stereo_slam_env.paper import FULL, QUICK, run_paper
    from stereo_slam_env.report.console import progress_bar

    settings = QUICK if quick else FULL
    if seeds is not None:
        settings = dataclasses.replace(settings, drive_seeds=seeds)
    if turns is not None:
        settings = dataclasses.replace(settings, turn_seeds=turns)
    directory = out or new_directory("paper")
    try:
        with progress_bar(console(stderr=True), "parts") as progress:
            result = run_paper(
                directory,
                settings,
                jobs=jobs,
                real=real or (),
                karlsruhe=karlsruhe,
                figure=figure,
                progress=progress,
            )
    except KeyboardInterrupt:
        raise Interrupted(directory) from None
    _show_claims(result.claims)
    for note in (settings.remark, *result.notes):
        if note:
            typer.echo(note)
    show_place(result.report)


def _show_claims(claims: Sequence[Claim]) -> None:
    """The table: claim, and the verdict in each place."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from stereo_slam_env.paper.claims import PLACES, ClaimVerdict

    colours = {
        ClaimVerdict.HOLDS: "green",
        ClaimVerdict.HOLDS_ONLY_IF: "yellow",
        ClaimVerdict.DOES_NOT_HOLD: "red",
        ClaimVerdict.NOT_SHOWN: "dim",
    }
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for heading, ratio in (("section", 1), ("claim", 4), *((name.lower(), 2) for name in PLACES.values())):
        table.add_column(heading, ratio=ratio)
    for claim in claims:
        places = [claim.at(place) for place in PLACES]
        verdicts = [f"[{colours[at.verdict]}]{at.verdict.value if at.findings else '–'}[/]" for at in places]
        table.add_row(claim.sentence.section, claim.sentence.claim, *(v.replace(" if", " if ...") for v in verdicts))
    console().print(table, highlight=False)
