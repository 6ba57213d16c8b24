"""The commands `submit`, `verify` and `gate`: results that can be handed in, checked, and guarded."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereo_slam_env.cli.parts import JobsOption, JsonOption, console, show_json

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


def submit(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.", metavar="RUN")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Where the packet goes, JSON.", show_default="RUN.json, here")
    ] = None,
) -> None:
    """Make a small packet of a run, to be handed in: study, versions, digests of the recordings, figures."""
    from filters.contract.foreign_text import plain
    from stereo_slam_env.benchmark.packets import packet_of, require_no_other, write_packet
    from stereo_slam_env.files.folders import require_writable

    path = Path(f"{run.resolve().name}.json") if out is None else out
    if path.suffix != ".json":
        raise ValueError(f"--out must end in .json, got {path}")
    require_writable(path.parent)
    require_no_other(path)
    packet = packet_of(run)
    write_packet(path, packet)
    for sentence in packet["missing"]:
        typer.echo(f"missing: {plain(sentence)}")
    typer.echo(f"packet: {path.resolve()} ({path.stat().st_size / 1000.0:.0f} kB)")


def verify(
    packet: Annotated[Path, typer.Argument(help="What `submit` wrote.", metavar="PACKET.json")],
    seeds: Annotated[int, typer.Option("--seeds", help="Recordings of a cell that are run again.", min=1)] = 2,
    cells: Annotated[int, typer.Option("--cells", help="Cells of a grid that are run again.", min=1)] = 1,
    everything: Annotated[bool, typer.Option("--all", help="Run all of it again.")] = False,
    data: Annotated[
        Path | None, typer.Option("--data", help="Folder of the real recordings.", envvar="STEREO_SLAM_DATA")
    ] = None,
    jobs: JobsOption = 2,
    draw: Annotated[
        int | None,
        typer.Option("--draw", help="Draw the part of an earlier check.", show_default="random", min=0),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Keep the repetition there.", show_default="not kept")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a part of a packet again: do measurements and figures agree? Exit code 1 where they do not."""
    from filters.contract.foreign_text import plain
    from stereo_slam_env.benchmark.packets import read_packet
    from stereo_slam_env.benchmark.packets import verify as verified
    from stereo_slam_env.report.console import progress_bar

    content = read_packet(packet)
    with tempfile.TemporaryDirectory() as scratch, progress_bar(console(stderr=True), "steps") as progress:
        found = verified(
            content,
            Path(scratch) / "run" if out is None else out,
            seeds=seeds,
            cells=cells,
            everything=everything,
            data=data,
            jobs=jobs,
            draw=draw,
            progress=progress,
        )
    if as_json:
        show_json(found.as_dict())
    else:
        for sentence in content["missing"]:
            typer.echo(f"note: {plain(sentence)}")
        typer.echo(found.words)
    if not found.agrees:
        raise typer.Exit(1)


def gate(
    baseline: Annotated[Path, typer.Argument(help="A packet, or a folder of packets.", metavar="BASELINE.json")],
    runs: Annotated[
        list[Path], typer.Argument(help="Run directories or packets; several are runs of the same.", metavar="RUN...")
    ],
    limit: Annotated[
        float, typer.Option("--limit", help="Percent that is worse where runs are too few for a test.", min=0.0)
    ] = 5.0,
    time: Annotated[bool, typer.Option("--time", help="Look at the time, too: on one machine only.")] = False,
    markdown: Annotated[
        Path | None, typer.Option("--markdown", help="Write the table there, too.", metavar="FILE.md")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Guard results in continuous integration: exit code 1 where something is worse than in the baseline."""
    from stereo_slam_env.benchmark.gate import gate as gated
    from stereo_slam_env.files.folders import write_atomically

    found = gated(_packets([baseline]), _packets(runs), limit_percent=limit, with_time=time)
    if markdown is not None:
        write_atomically(markdown, lambda stream: stream.write(found.as_markdown().encode()))
    if as_json:
        show_json(found.as_dict())
    else:
        typer.echo(found.as_markdown(), nl=False)
    if not found.passed:
        raise typer.Exit(1)


def _packets(places: Sequence[Path]) -> list[Mapping[str, Any]]:
    """The packets that paths name: a packet, a run, or a folder of packets."""
    from stereo_slam_env.benchmark.packets import packet_of, read_packet
    from stereo_slam_env.benchmark.storage.settings import SETTINGS, STUDY

    found: list[Mapping[str, Any]] = []
    for place in places:
        is_run = (place / STUDY).exists() or (place / SETTINGS).exists()
        inside = sorted(place.glob("*.json")) if place.is_dir() and not is_run else []
        if is_run:
            found.append(packet_of(place))
        elif place.is_dir() and not inside:
            raise ValueError(f"{place} holds neither a run nor packets: give what `stereo-slam submit` wrote")
        else:
            found += map(read_packet, inside or [place])
    return found
