"""The command `stereo-slam`. Heavy modules are imported where they are used, so that `--help` is quick."""

from __future__ import annotations

import dataclasses
import datetime
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from stereo_slam_env.benchmark import Scenario

INTERRUPTED = 130

app = typer.Typer(
    help="Compare stereo EKF-SLAM filters on identical measurements, simulated or real.",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
filters_app = typer.Typer(help="The filters: ours and installed third-party ones.")
scenes_app = typer.Typer(help="The routes through the simulated street.")
app.add_typer(filters_app, name="filters")
app.add_typer(scenes_app, name="scenes")

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
        return _refuse(explain())
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
    _help_without_command(context)


@filters_app.callback(invoke_without_command=True)
@scenes_app.callback(invoke_without_command=True)
def _help_without_command(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


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
) -> None:
    """Compare filters in the simulated world: scenario x filters x seeds, one report."""
    with _one_line_errors():
        from stereo_slam_env.benchmark import load_scenario
        from stereo_slam_env.benchmark import preset as preset_named

        if preset is not None and scenario is not None:
            raise ValueError("--preset and --scenario exclude each other: give one of them")
        chosen = load_scenario(scenario) if scenario is not None else preset_named(preset or "quick")
        if seeds is not None:
            chosen = dataclasses.replace(chosen, seeds=tuple(range(seeds)))
        if odometry is not None:
            chosen = dataclasses.replace(chosen, use_odometry=odometry)
        _run(_adjusted(chosen, filters, frames, sigma_px, gate), out, jobs)


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
) -> None:
    """Run filters over a real drive."""
    with _one_line_errors():
        from stereo_slam_env.benchmark import Scenario
        from stereo_slam_env.benchmark.sources import make_recording
        from stereo_slam_env.console import show_recording

        where = path if path.partition(":")[0] == "gtsam" else str(Path(path).resolve())
        scenario = Scenario(f"replay-{Path(path).name.replace(':', '-')}", "dataset", {"path": where})
        scenario = dataclasses.replace(scenario, use_odometry=odometry)
        scenario = _adjusted(scenario, filters, frames, sigma_px, gate)
        joint = scenario.gate is not None if consensus is None else consensus
        scenario = dataclasses.replace(scenario, consensus=joint)
        recording = make_recording(scenario, None)
        show_recording(_console(), recording)
        # What is stored must be what happened.
        if not any(frame.odometry is not None for frame in recording.frames):
            scenario = dataclasses.replace(scenario, use_odometry=False)
        _run(scenario, out, jobs)


@app.command()
def report(directory: Annotated[Path, typer.Argument(help="Directory of a finished run.")]) -> None:
    """Write the tables and the report of a finished run again, without running anything."""
    with _one_line_errors():
        from stereo_slam_env.benchmark.campaign import write_report_of
        from stereo_slam_env.benchmark.store import read_run
        from stereo_slam_env.console import show_results

        run = read_run(directory)
        runs, summaries = run.write_results()
        page = write_report_of(run, runs, summaries)
        show_results(_console(), summaries)
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
    with _one_line_errors():
        from filters import make_filter
        from filters.conformance import REFERENCE_CAMERA, REFERENCE_NOISE, check_filter

        make_filter(name, camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE)
        result = check_filter(
            lambda: make_filter(name, camera=REFERENCE_CAMERA, noise=REFERENCE_NOISE), raise_on_failure=False
        )
        typer.echo(str(result).replace(result.filter_name, name, 1))
    if result.failed:
        raise typer.Exit(1)


@scenes_app.command("list")
def list_scenes() -> None:
    """Names of the routes, and the ready-made scenarios of `bench`."""
    from stereo_slam_env.benchmark import PRESETS
    from stereo_slam_env.world.routes import ROUTES

    typer.echo("routes:")
    for name, make in ROUTES.items():
        route = make()
        typer.echo(f"  {name:<16} {route.frames} frames, {route.length:.0f} m")
    typer.echo("presets of bench:")
    for name, (description, _) in PRESETS.items():
        typer.echo(f"  {name:<16} {description}")


@scenes_app.command("render")
def render_scene(
    name: Annotated[str, typer.Argument(help="Name of a route, see 'scenes list'.")],
    out: Annotated[Path, typer.Option("--out", help="PNG file to write.")],
    seed: Annotated[int, typer.Option("--seed", help="Of the street.", min=0)] = 0,
    frame: Annotated[int, typer.Option("--frame", help="Drive so many frames first.", min=0)] = 0,
) -> None:
    """Draw what both eyes see, with the observed landmarks."""
    with _one_line_errors():
        import cv2
        import gymnasium as gym
        import numpy as np

        if out.suffix.lower() != ".png":
            raise ValueError(f"--out must be a file name ending in .png, got {str(out)!r}")
        env: Any = gym.make("StereoSlam/Drive-v0", route=name, policy="route", render_mode="rgb_array")
        try:
            env.reset(seed=seed)
            for k in range(frame):
                _, _, terminated, truncated, _ = env.step(np.zeros(2, dtype=np.float32))
                if terminated or truncated:
                    raise ValueError(f"--frame must be less than {k + 1} on route {name}, got {frame}")
            image = env.render()
        finally:
            env.close()
        out.parent.mkdir(parents=True, exist_ok=True)
        if not cv2.imwrite(str(out), image[..., ::-1]):
            raise OSError(f"{out} cannot be written")
        typer.echo(str(out.resolve()))


def _adjusted(
    scenario: Scenario, filters: str | None, frames: int | None, sigma_px: float | None, gate: str | None
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
    return dataclasses.replace(scenario, **changes)


def _gate(text: str) -> float | None:
    if text.lower() == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"--gate must be a probability between 0 and 1, or 'none', got {text!r}") from None


def _run(scenario: Scenario, out: Path | None, jobs: int) -> None:
    """Run, show the table, and say where everything is; when interrupted, say how to go on."""
    from stereo_slam_env.benchmark.campaign import check_filters, run_benchmark
    from stereo_slam_env.console import progress_bar, show_results, show_settings

    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    directory = Path("runs") / f"{scenario.name}-{stamp}" if out is None else out
    check_filters(scenario)
    show_settings(_console(), scenario)
    try:
        with progress_bar(_console(stderr=True)) as progress:
            result = run_benchmark(scenario, directory, jobs=jobs, progress=progress)
    except KeyboardInterrupt:
        raise _Interrupted(directory) from None
    show_results(_console(), result.summaries)
    _show_place(result.report or result.out)


def _show_place(page: Path) -> None:
    typer.echo(f"tables and time series: {page.parent.resolve()}")
    typer.echo(f"report: {page.resolve()}")


def _console(*, stderr: bool = False) -> Console:
    from rich.console import Console

    return Console(stderr=stderr)


def _refuse(message: str) -> int:
    typer.echo("error: " + " ".join(message.split()), err=True)
    return 2


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """Wrong input is the user's business, not a crash: one line on stderr, exit code 2."""
    try:
        yield
    except (ValueError, OSError, ImportError) as error:
        raise typer.Exit(_refuse(str(error))) from error


if __name__ == "__main__":
    sys.exit(main())
