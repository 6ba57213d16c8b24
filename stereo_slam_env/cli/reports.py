"""The commands `report`, `submit`, `verify` and `paper`: results shown, compared, guarded, handed in, checked."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereo_slam_env.cli.shared_options import (
    Interrupted,
    JobsOption,
    JsonOption,
    OutOption,
    console,
    new_directory,
    show_json,
    show_place,
)

if TYPE_CHECKING:
    pass


def report(
    directory: Annotated[Path, typer.Argument(help="Directory of a finished run; with --fail-if-worse, or packets.")],
    after: Annotated[
        list[Path] | None,
        typer.Argument(help="A second run: say what is different in it.", metavar="[AFTER]", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Where the page of a comparison goes.", show_default="second run")
    ] = None,
    trajectories: Annotated[
        bool, typer.Option("--trajectories", help="Write the trajectories of all recordings that are kept, too.")
    ] = False,
    fail_if_worse: Annotated[
        bool,
        typer.Option(
            "--fail-if-worse",
            help="For continuous integration: print what is worse than in the first run; exit code 1 if anything is. "
            "Takes packets of `submit`, too, and several runs of the same.",
        ),
    ] = False,
    limit: Annotated[
        float | None,
        typer.Option("--limit", help="With it: percent that is worse if runs are too few.", min=0.0, show_default="5"),
    ] = None,
    time: Annotated[
        bool, typer.Option("--time", help="With it: judge the time, too, which depends on the machine.")
    ] = False,
    markdown: Annotated[
        Path | None, typer.Option("--markdown", help="With it: write the table there, too.", metavar="FILE.md")
    ] = None,
) -> None:
    """Write a report again, or compare two runs."""
    from stereo_slam_env.benchmark.storage.result_tables import write_results
    from stereo_slam_env.benchmark.storage.store import read_study
    from stereo_slam_env.files.folders import claimed_folder
    from stereo_slam_env.report.benchmark_report import write_report_of
    from stereo_slam_env.report.console import show_cells

    if fail_if_worse:
        if out is not None or trajectories:
            raise ValueError("--fail-if-worse writes no report: leave --out and --trajectories out")
        _fail_if_worse(directory, after or (), 5.0 if limit is None else limit, time, markdown)
        return
    if limit is not None or time or markdown is not None:
        raise ValueError("--limit, --time and --markdown need --fail-if-worse: give it, too, or leave them out")
    if after:
        if len(after) > 1:
            raise ValueError(f"one second run can be compared, got {len(after)}: several need --fail-if-worse")
        _compare(directory, after[0], out)
        return
    study = read_study(directory)
    with claimed_folder(study.root):
        results = write_results(study)
        if trajectories:
            study.write_trajectories()
        page = write_report_of(study, results)
    show_cells(console(), results)
    show_place(page)


def _compare(before: Path, after: Path, out: Path | None) -> None:
    from stereo_slam_env.benchmark import compare
    from stereo_slam_env.files.folders import require_writable
    from stereo_slam_env.report.comparison_report import write_comparison_report
    from stereo_slam_env.report.console import show_comparison

    require_writable(after if out is None else out)
    comparison = compare(before, after)
    page = write_comparison_report(after if out is None else out, comparison)
    show_comparison(console(), comparison)
    typer.echo(f"report: {page.resolve()}")


def _fail_if_worse(baseline: Path, runs: Sequence[Path], limit: float, time: bool, markdown: Path | None) -> None:
    from stereo_slam_env.benchmark.gate import gate
    from stereo_slam_env.files.folders import write_atomically

    if not runs:
        raise ValueError("--fail-if-worse needs a second run: give the runs, or packets, that are to be judged")
    verdict = gate(_packets([baseline]), _packets(runs), limit_percent=limit, with_time=time)
    if markdown is not None:
        write_atomically(markdown, lambda stream: stream.write(verdict.as_markdown().encode()))
    typer.echo(verdict.as_markdown(), nl=False)
    if not verdict.passed:
        raise typer.Exit(1)


def submit(
    run: Annotated[Path, typer.Argument(help="Directory of a finished run.", metavar="RUN")],
    out: Annotated[
        Path | None, typer.Option("--out", help="Where the packet goes, JSON.", show_default="RUN.json, here")
    ] = None,
) -> None:
    """Make a small packet of a run, to be handed in."""
    from filters.contract.validation import plain
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
    packet: Annotated[Path, typer.Argument(help="Packet written by `submit`.", metavar="PACKET.json")],
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
    """Run a part of a packet again; exit code 1 if it differs."""
    from filters.contract.validation import plain
    from stereo_slam_env.benchmark.packets import read_packet
    from stereo_slam_env.benchmark.packets import verify as verified
    from stereo_slam_env.report.console import progress_bar

    content = read_packet(packet)
    with tempfile.TemporaryDirectory() as scratch, progress_bar(console(stderr=True), "steps") as progress:
        verified_packet = verified(
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
        show_json(verified_packet.as_dict())
    else:
        for sentence in content["missing"]:
            typer.echo(f"note: {plain(sentence)}")
        typer.echo(verified_packet.words)
    if not verified_packet.agrees:
        raise typer.Exit(1)


def _packets(places: Sequence[Path]) -> list[Mapping[str, Any]]:
    """The packets that paths name: a packet, a run, or a folder of packets."""
    from stereo_slam_env.benchmark.packets import packet_of, read_packet
    from stereo_slam_env.benchmark.storage.run_files import SETTINGS, STUDY

    packets: list[Mapping[str, Any]] = []
    for place in places:
        is_run = (place / STUDY).exists() or (place / SETTINGS).exists()
        inside = sorted(place.glob("*.json")) if place.is_dir() and not is_run else []
        if is_run:
            packets.append(packet_of(place))
        elif place.is_dir() and not inside:
            raise ValueError(f"{place} holds neither a run nor packets: give what `stereo-slam submit` wrote")
        else:
            packets += map(read_packet, inside or [place])
    return packets


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
    """Reproduce the paper and judge it (half an hour)."""
    from stereo_slam_env.paper import FULL, QUICK, run_paper
    from stereo_slam_env.paper.report import claims_table
    from stereo_slam_env.report.console import progress_bar
    from stereo_slam_env.report.table import show_table

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
    show_table(console(), claims_table(result.claims))
    for note in (settings.remark, *result.notes):
        if note:
            typer.echo(note)
    show_place(result.report)
