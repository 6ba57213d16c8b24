"""The command `stereo-slam`. Heavy modules are imported where they are used, so that `--help` is quick."""

from __future__ import annotations

import dataclasses
import datetime
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereo_slam_env import cli_scenes
from stereo_slam_env.cli_parts import console, help_without_command, one_line_errors, refuse

if TYPE_CHECKING:
    from stereo_slam_env.benchmark import Scenario

INTERRUPTED = 130

app = typer.Typer(
    help="Compare stereo EKF-SLAM filters on identical measurements, simulated or real.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
filters_app = typer.Typer(help="The filters: ours and installed third-party ones.")
app.add_typer(filters_app, name="filters")
app.add_typer(cli_scenes.app, name="scenes")

FiltersOption = Annotated[str | None, typer.Option("--filters", help="Names, separated by commas.", metavar="A,B")]
FramesOption = Annotated[int | None, typer.Option("--frames", help="Cut after so many frames.", min=2)]
JobsOption = Annotated[int, typer.Option("--jobs", help="Processes, one BLAS thread each.", min=1)]
OutOption = Annotated[
    Path | None, typer.Option("--out", help="Run directory; an interrupted run in it is resumed.", show_default="new")
]
SigmaOption = Annotated[
    float | None,
    typer.Option(
        "--sigma-px", "--sigma", help="Pixel noise the filters assume, px.", show_default="what the recording says"
    ),
]
SearchOption = Annotated[
    str | None,
    typer.Option(
        "--search",
        help="In images: 'flow', the same tracks for all, or 'forecast', guided by each filter (the paper's way).",
        show_default="flow",
    ),
]
RecordOption = Annotated[
    Path | None, typer.Option("--record", help="Write the search in the images to a film, OUT.mp4.", metavar="OUT.mp4")
]
LiveOption = Annotated[
    int | None, typer.Option("--live", help="Show the search in a browser at this port, 0: any.", metavar="PORT")
]
GateOption = Annotated[
    str | None, typer.Option("--gate", help="Gate, a probability per landmark, or 'none'.", show_default="0.99")
]


class _Interrupted(Exception):
    """Ctrl-C during a run."""

    def __init__(self, directory: Path) -> None:
        super().__init__(f"interrupted, results so far are in {directory}")
        self.directory = directory
        self.kept = len(list(directory.glob("trials/*/*.npz")))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit code. Wrong use gets one line on stderr and exit code 2."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        code = app(args=arguments, prog_name="stereo-slam", standalone_mode=False)
    except typer.Abort:
        return INTERRUPTED
    except _Interrupted as stopped:
        resume = [*arguments, *([] if "--out" in shlex.join(arguments) else ["--out", str(stopped.directory)])]
        typer.echo(f"interrupted: {stopped.kept} finished trials are kept in {stopped.directory}", err=True)
        typer.echo(f"to go on: stereo-slam {shlex.join(resume)}", err=True)
        return INTERRUPTED
    except Exception as error:
        # Usage errors of typer have no public base class in every version; what they share is this method.
        explain = getattr(error, "format_message", None)
        if explain is None:
            raise
        return refuse(explain())
    return code if isinstance(code, int) else 0


@app.callback(invoke_without_command=True)
def _start(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version and stop.")] = False,
) -> None:
    if version:
        from importlib.metadata import PackageNotFoundError
        from importlib.metadata import version as version_of

        try:
            typer.echo(f"stereo-slam {version_of('stereo-slam-env')}")
        except PackageNotFoundError:
            typer.echo("stereo-slam (not installed, run from source)")
        raise typer.Exit()
    help_without_command(context)


@filters_app.callback(invoke_without_command=True)
def _filters(context: typer.Context) -> None:
    help_without_command(context)


@app.command()
def bench(
    preset: Annotated[
        str | None, typer.Option("--preset", help="A ready-made scenario.", show_default="quick", metavar="NAME")
    ] = None,
    scenario: Annotated[Path | None, typer.Option("--scenario", help="A scenario of your own, a JSON file.")] = None,
    filters: FiltersOption = None,
    seeds: Annotated[int | None, typer.Option("--seeds", help="Number of recordings, seeds 0, 1, ...", min=1)] = None,
    frames: FramesOption = None,
    jobs: JobsOption = 2,
    out: OutOption = None,
    sigma_px: SigmaOption = None,
    gate: GateOption = None,
    odometry: Annotated[
        bool | None, typer.Option("--odometry/--no-odometry", help="Give the filters the odometry.")
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            "--sensor",
            help="'landmarks': geometry and noise; 'images': rendered pictures.",
            show_default="what the scenario says",
        ),
    ] = None,
    renderer: Annotated[
        str | None,
        typer.Option(
            "--renderer", help="Who draws the images: 'tiny', everywhere, or 'gl', fast.", show_default="tiny"
        ),
    ] = None,
    search: SearchOption = None,
    record: RecordOption = None,
    live: LiveOption = None,
) -> None:
    """Compare filters in the simulated world: scenario x filters x seeds, one report."""
    with one_line_errors():
        from stereo_slam_env.benchmark import load_scenario
        from stereo_slam_env.benchmark import preset as preset_named

        if preset is not None and scenario is not None:
            raise ValueError("--preset and --scenario exclude each other: give one of them")
        chosen = load_scenario(scenario) if scenario is not None else preset_named(preset or "quick")
        if seeds is not None:
            chosen = dataclasses.replace(chosen, seeds=tuple(range(seeds)))
        if odometry is not None:
            chosen = dataclasses.replace(chosen, use_odometry=odometry)
        chosen = _adjusted(_sensed(chosen, sensor, renderer), filters, frames, sigma_px, gate, search)
        directory = _ready(chosen, out)
        with _film(chosen.name, record, live) as show:
            show(chosen)
        _run(chosen, directory, jobs)


@app.command()
def replay(
    path: Annotated[
        str, typer.Argument(help="Folder of a real recording (known by its files), or 'gtsam' for the wheel's example.")
    ],
    filters: FiltersOption = None,
    out: OutOption = None,
    odometry: Annotated[bool, typer.Option("--odometry/--no-odometry", help="Use it where there is any.")] = True,
    sigma_px: SigmaOption = None,
    gate: GateOption = None,
    consensus: Annotated[
        bool | None,
        typer.Option("--consensus/--no-consensus", help="Joint test over each frame.", show_default="with a gate"),
    ] = None,
    frames: FramesOption = None,
    jobs: JobsOption = 2,
    search: SearchOption = None,
    record: RecordOption = None,
    live: LiveOption = None,
    skip_broken: Annotated[
        bool, typer.Option("--skip-broken", help="Leave out pairs with missing or damaged images, and count them.")
    ] = False,
) -> None:
    """Run filters over a real drive, of tracks or of images."""
    with one_line_errors():
        from stereo_slam_env.benchmark import Scenario
        from stereo_slam_env.benchmark.sources import make_recording
        from stereo_slam_env.console import progress_bar, show_recording

        where = path if path.partition(":")[0] == "gtsam" else str(Path(path).resolve())
        options = {"path": where, "on_broken": "skip"} if skip_broken else {"path": where}
        scenario = Scenario(f"replay-{Path(where).name.replace(':', '-')}", "dataset", options)
        scenario = dataclasses.replace(scenario, use_odometry=odometry)
        scenario = _adjusted(scenario, filters, frames, sigma_px, gate, search)
        joint = scenario.gate is not None if consensus is None else consensus
        scenario = dataclasses.replace(scenario, consensus=joint)
        _check(scenario)
        with _film(scenario.name, record, live) as show:
            with progress_bar(console(stderr=True), "pairs") as progress:
                recording = make_recording(scenario, None, progress)
            show_recording(console(), recording)
            # What is stored must be what happened.
            if not any(frame.odometry is not None for frame in recording.frames):
                scenario = dataclasses.replace(scenario, use_odometry=False)
            directory = _ready(scenario, out)
            show(scenario)
        _run(scenario, directory, jobs)


@app.command()
def report(directory: Annotated[Path, typer.Argument(help="Directory of a finished run.")]) -> None:
    """Write the tables and the report of a finished run again, without running anything."""
    with one_line_errors():
        from stereo_slam_env.benchmark.campaign import write_report_of
        from stereo_slam_env.benchmark.store import read_run
        from stereo_slam_env.console import show_results

        run = read_run(directory)
        runs, summaries = run.write_results()
        page = write_report_of(run, runs, summaries)
        show_results(console(), summaries)
        _show_place(page)


@filters_app.command("list")
def list_filters() -> None:
    """Names of all filters, with one line on each."""
    from filters import available_filters

    lines = available_filters()
    width = max(map(len, lines))
    for name, line in lines.items():
        typer.echo(f"{name:<{width}}  {line}")


@filters_app.command("check")
def check(name: Annotated[str, typer.Argument(help="Name of a filter.")]) -> None:
    """Check that a filter keeps the contract; exit code 1 if it does not."""
    with one_line_errors():
        from filters import make_filter
        from filters.conformance import REFERENCE_CAMERA, REFERENCE_NOISE, check_filter

        make_filter(name, camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE)
        result = check_filter(
            lambda: make_filter(name, camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE), raise_on_failure=False
        )
        typer.echo(str(result).replace(result.filter_name, name, 1))
    if result.failed:
        raise typer.Exit(1)


def _adjusted(
    scenario: Scenario,
    filters: str | None,
    frames: int | None,
    sigma_px: float | None,
    gate: str | None,
    search: str | None,
) -> Scenario:
    """The scenario with the options of the command line in place of its own."""
    from stereo_slam_env.benchmark.scenario import filter_choice

    changes: dict[str, Any] = {}
    if filters is not None:
        own = {choice.label: choice for choice in scenario.filters}
        names = [name.strip() for name in filters.split(",") if name.strip()]
        changes["filters"] = tuple(own.get(name) or filter_choice(name) for name in names)
    if frames is not None:
        changes["frames"] = frames
    if sigma_px is not None:
        changes["noise"] = {"independent_pixels": sigma_px}
    if gate is not None:
        changes["gate"] = _gate(gate)
        changes["consensus"] = scenario.consensus and changes["gate"] is not None
    if search is not None:
        changes["search"] = search
    return dataclasses.replace(scenario, **changes)


def _gate(text: str) -> float | None:
    if text.lower() == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"--gate must be a probability between 0 and 1, or 'none', got {text!r}") from None


def _sensed(scenario: Scenario, sensor: str | None, renderer: str | None) -> Scenario:
    """The scenario with the sensor of the command line."""
    from stereo_slam_env.benchmark.presets import with_images
    from stereo_slam_env.benchmark.sources import takes_images

    if sensor not in (None, "landmarks", "images"):
        raise ValueError(f"--sensor must be 'landmarks' or 'images', got {sensor!r}")
    seen = takes_images(scenario)
    if sensor == "images" and not seen:
        return with_images(scenario, renderer or "tiny")
    changes: dict[str, Any] = {}
    if sensor == "landmarks" and seen:
        seen, changes["sensor"] = False, sensor
    if renderer is not None:
        if not seen:
            raise ValueError("--renderer needs --sensor images: nothing is drawn for landmarks")
        changes["renderer"] = renderer
    return dataclasses.replace(scenario, options={**scenario.options, **changes})


def _check(scenario: Scenario) -> None:
    """Refuse what cannot be run before any work is done."""
    from stereo_slam_env.benchmark.campaign import check_filters
    from stereo_slam_env.benchmark.sources import check_source

    check_filters(scenario)
    check_source(scenario)


def _ready(scenario: Scenario, out: Path | None) -> Path:
    """The run directory, once it is known that the scenario can be run into it."""
    from stereo_slam_env.benchmark.store import prepared_run

    _check(scenario)
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    return prepared_run(Path("runs") / f"{scenario.name}-{stamp}" if out is None else out, scenario).out


@contextmanager
def _film(title: str, record: Path | None, live: int | None) -> Iterator[Callable[[Scenario], None]]:
    """What shows the search in the images of a scenario, if that was asked for; a wrong file or port is known first."""
    if record is None and live is None:
        yield lambda scenario: None
        return
    from stereo_slam_env.benchmark.watch import watch_search
    from stereo_slam_env.console import progress_bar
    from stereo_slam_env.viewer.search_film import search_film

    with search_film(title, record, live, on_live=lambda url: typer.echo(f"live view: {url}")) as watch:

        def show(scenario: Scenario) -> None:
            with progress_bar(console(stderr=True), "pairs") as progress:
                watch_search(scenario, watch, progress)

        yield show
    if record is not None:
        typer.echo(f"film: {record.resolve()}")


def _run(scenario: Scenario, directory: Path, jobs: int) -> None:
    """Run, show the table, and say where everything is; when interrupted, say how to go on."""
    from stereo_slam_env.benchmark.campaign import run_benchmark
    from stereo_slam_env.console import progress_bar, show_results, show_settings

    show_settings(console(), scenario)
    try:
        with progress_bar(console(stderr=True)) as progress:
            result = run_benchmark(scenario, directory, jobs=jobs, progress=progress)
    except KeyboardInterrupt:
        raise _Interrupted(directory) from None
    show_results(console(), result.summaries)
    _show_place(result.report or result.out)


def _show_place(page: Path) -> None:
    typer.echo(f"tables and time series: {page.parent.resolve()}")
    typer.echo(f"report: {page.resolve()}")


if __name__ == "__main__":
    sys.exit(main())
