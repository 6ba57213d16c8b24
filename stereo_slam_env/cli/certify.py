"""The command `stereo-slam certify`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from stereo_slam_env.cli.parts import console, one_line_errors

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stereo_slam_env.benchmark.certificate import Certificate

VERSION = 1


def certify(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(help="Presets or scenario files.", show_default="reference-turn turn gaze", metavar="SCENARIO"),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="Write the certificate here, as JSON.")] = None,
    ways: Annotated[
        str | None, typer.Option("--ways", help="Some of the ways, separated by commas.", show_default="all")
    ] = None,
    seeds: Annotated[int, typer.Option("--seeds", help="Recordings of each scenario.", min=1)] = 2,
    frames: Annotated[int, typer.Option("--frames", help="Frames of each recording.", min=2)] = 20,
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Folder of the real recordings a scenario asks for.", envvar="STEREO_SLAM_DATA"),
    ] = None,
) -> None:
    """Run scenarios again, in other processes, vectors and clusters, and certify that every bit is the same."""
    with one_line_errors():
        from stereo_slam_env.benchmark.campaign import as_study
        from stereo_slam_env.benchmark.certificate import DEFAULT_SCENARIOS, WAYS
        from stereo_slam_env.benchmark.certificate import certify as certificates_of
        from stereo_slam_env.benchmark.storage.store import versions
        from stereo_slam_env.files.atomic import write_atomically
        from stereo_slam_env.report.console import progress_bar

        chosen = WAYS if ways is None else tuple(way.strip() for way in ways.split(","))
        studies = [as_study(scenario, data=data) for scenario in scenarios or DEFAULT_SCENARIOS]
        found: list[Certificate] = []
        for study in studies:
            with progress_bar(console(stderr=True), f"ways of {study.name}") as progress:
                found += certificates_of(study, chosen, seeds=seeds, frames=frames, progress=progress)
        _show(found)
        if out is not None:
            about = {"version": VERSION, "seeds": seeds, "frames": frames, "versions": versions()}
            text = json.dumps({**about, "certificates": [one.as_dict() for one in found]}, indent=2) + "\n"
            write_atomically(out, lambda stream: stream.write(text.encode()))
            typer.echo(f"certificate: {out.resolve()}")
    if not all(certificate.holds for certificate in found):
        raise typer.Exit(1)


def _show(certificates: Sequence[Certificate]) -> None:
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("scenario", "hash", "parts", "ways", ""):
        table.add_column(heading)
    for one in certificates:
        verdict = "[green]the same every way[/green]" if one.holds else "[red]not the same[/red]"
        table.add_row(escape(one.scenario), one.sha256[:16], str(len(one.parts)), str(len(one.found)), verdict)
    console().print(table, highlight=False)
    for one in certificates:
        for way, part in one.differences:
            typer.echo(f"{one.scenario}: {part} differs in the way {way!r}")
    for way, reason in (certificates[0].not_run if certificates else {}).items():
        typer.echo(f"not run: {way}: {reason}")
