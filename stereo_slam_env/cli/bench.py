"""The commands that run filters: `bench` on scenarios, `replay` on a real drive."""

from __future__ import annotations

import errno
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stereo_slam_env.cli.shared_options import (
    ADVANCED,
    PRESET_GROUPS,
    FiltersOption,
    ImagesOptions,
    Interrupted,
    JobsOption,
    OutOption,
    console,
    listed,
    new_directory,
    rig_from,
    settings_from,
    show_groups,
    show_place,
    with_options,
)

if TYPE_CHECKING:
    from stereo_slam_env.benchmark import FilterChoice, PolicyChoice, Scenario, Study
    from stereo_slam_env.benchmark.recordings.source import Source
    from stereo_slam_env.benchmark.storage.result_tables import CellResult
    from stereo_slam_env.benchmark.storage.store import StudyDirectory


def _setting_keys(incomplete: str) -> list[str]:
    from stereo_slam_env.benchmark.scenarios.schema import setting_keys

    return [f"{key}=" for key in setting_keys() if key.startswith(incomplete)]


@dataclass
class RunOptions:
    """Options of the commands that run filters."""

    filters: FiltersOption = None
    trajectories: Annotated[
        list[str] | None,
        typer.Option(
            "--trajectory",
            help="Trajectory of another program, beside the filters; {seed} in FILE is the recording's. Repeatable.",
            rich_help_panel=ADVANCED,
            metavar="LABEL=FILE",
        ),
    ] = None
    frames: Annotated[int | None, typer.Option("--frames", help="Use the first frames only.", min=2)] = None
    jobs: JobsOption = 2
    out: OutOption = None
    odometry: Annotated[
        bool | None,
        typer.Option(
            "--odometry/--no-odometry",
            help="Use the recording's odometry.",
            show_default="what the scenario says; for a real drive, where there is any",
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help="Any field of the scenario: gate=0.9, noise.independent_pixels=0.5, gate=none. Repeatable.",
            metavar="KEY=VALUE",
            autocompletion=_setting_keys,
        ),
    ] = None
    record: Annotated[
        Path | None,
        typer.Option(
            "--record",
            help="Film the search in the images.",
            metavar="OUT.mp4",
            rich_help_panel=ADVANCED,
        ),
    ] = None
    front_end: Annotated[
        str | None,
        typer.Option(
            "--front-end",
            help="Front end for images: 'active-search', 'klt', 'sift', or an installed one.",
            show_default="active-search",
            rich_help_panel=ADVANCED,
        ),
    ] = None
    backend: Annotated[
        str, typer.Option("--backend", help="'processes' here, or 'dask', on a cluster.", rich_help_panel=ADVANCED)
    ] = "processes"
    address: Annotated[
        str | None,
        typer.Option(
            "--address",
            help="Scheduler of the Dask cluster.",
            show_default="one on this machine",
            rich_help_panel=ADVANCED,
        ),
    ] = None

    def adjusted(self, study: Study) -> Study:
        """The study with these options in place of its own."""
        return study.with_scenarios(self._adjusted).with_settings(self.changes)

    @property
    def changes(self) -> dict[str, Any]:
        """Fields of the scenario that `--set` gives, by dotted keys."""
        return settings_from(self.settings or ())

    def _adjusted(self, scenario: Scenario) -> Scenario:
        changes: dict[str, Any] = {}
        if self.filters is not None:
            changes["filters"] = _chosen("--filters", self.filters, scenario.filters)
        if self.trajectories:
            changes["filters"] = (*changes.get("filters", scenario.filters), *map(_outside, self.trajectories))
        if self.frames is not None:
            changes["frames"] = self.frames
        if self.odometry is not None:
            changes["use_odometry"] = self.odometry
        if self.front_end is not None:
            changes["source"] = _with_front_end(scenario.source, self.front_end)
        return scenario.replaced(**changes)

    def require_place(self) -> None:
        """Raise where the results could not be written, before any work."""
        from stereo_slam_env.files.folders import require_writable

        require_writable(self.out or Path("runs"))

    def directory(self, study: Study) -> StudyDirectory:
        """The run directory, once it is known that it can be used for this study."""
        from stereo_slam_env.benchmark.storage.store import prepared_study

        return prepared_study(self.out or new_directory(study.name), study)

    @contextmanager
    def film(self, title: str) -> Iterator[Callable[[Scenario], None]]:
        """Film of the search in the images of a scenario, if that was asked for; a wrong file is known first."""
        if self.record is None:
            yield lambda scenario: None
            return
        from stereo_slam_env.benchmark.running.tasks import watch_search
        from stereo_slam_env.report.console import progress_bar
        from stereo_slam_env.viewer.search_view import search_film

        with search_film(title, self.record) as watch:

            def show(scenario: Scenario) -> None:
                with progress_bar(console(stderr=True), "pairs") as progress:
                    watch_search(scenario, watch, progress)

            yield show
        typer.echo(f"film: {self.record.resolve()}")

    def run(self, directory: StudyDirectory) -> None:
        """Run, show the table, and say where everything is; exit code 1 where every trial failed."""
        from stereo_slam_env.benchmark.campaign import run_checked
        from stereo_slam_env.benchmark.recordings.source import checked
        from stereo_slam_env.benchmark.running.backends import Backend, BackendName
        from stereo_slam_env.report.benchmark_report import write_report_of
        from stereo_slam_env.report.console import progress_bar, show_cells, show_study

        workers = Backend(checked("backend", self.backend, BackendName), self.jobs, self.address)
        show_study(console(), directory.study)

        def show_and_write(directory: StudyDirectory, cells: Sequence[CellResult]) -> Path:
            bar.close()  # the table comes first: the charts of the report take seconds
            show_cells(console(), cells)
            return write_report_of(directory, cells)

        try:
            with ExitStack() as bar:
                progress = bar.enter_context(progress_bar(console(stderr=True), "steps"))
                result = run_checked(directory, workers, progress, show_and_write)
        except KeyboardInterrupt:
            raise Interrupted(directory.out) from None
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            kept_count = Interrupted(directory.out).kept
            raise OSError(
                f"the disk is full: {kept_count} finished trials are kept in {directory.out}; make room and run the "
                f"same command again with --out {directory.out}"
            ) from error
        show_place(result.report or result.out)
        if all(run.failure is not None for cell in result.cells for run in cell.runs):
            raise typer.Exit(1)


def _preset_names(incomplete: str) -> list[str]:
    from stereo_slam_env.benchmark import presets

    return [name for name in presets() if name.startswith(incomplete)]


@with_options(RunOptions, "options")
def bench(
    preset: Annotated[
        str | None,
        typer.Option(
            "--preset", help="A ready-made scenario, see --list.", show_default="quick", autocompletion=_preset_names
        ),
    ] = None,
    scenario: Annotated[Path | None, typer.Option("--scenario", help="A scenario file of your own, TOML.")] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            "--policy",
            "--policies",
            help="Gaze policies, comma-separated (uses preset gaze).",
            metavar="A,B",
        ),
    ] = None,
    seeds: Annotated[int | None, typer.Option("--seeds", help="Number of recordings, seeds 0, 1, ...", min=1)] = None,
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
            "--renderer", help="'tiny', everywhere, or 'gl', fast.", rich_help_panel=ADVANCED, show_default="tiny"
        ),
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            help="Rig of simulated drives: 'reference', 'vga', 'kitti', 'euroc', 'zed2', ...; a calibration file; "
            "numbers: vga,baseline=0.2.",
            rich_help_panel=ADVANCED,
            show_default="what the scenario says",
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option("--data", help="Folder of real recordings.", envvar="STEREO_SLAM_DATA", rich_help_panel=ADVANCED),
    ] = None,
    allow_code: Annotated[
        bool,
        typer.Option("--allow-code", help="Let a scenario file name a function to run.", rich_help_panel=ADVANCED),
    ] = False,
    write: Annotated[
        Path | None,
        typer.Option("--write", help="Write the preset to a scenario file, and stop.", metavar="MINE.toml"),
    ] = None,
    show_list: Annotated[bool, typer.Option("--list", help="List the ready-made scenarios and stop.")] = False,
    *,
    options: RunOptions,
) -> None:
    """Compare filters on simulated drives: one report."""
    from stereo_slam_env.benchmark import load_study, preset_study, presets
    from stereo_slam_env.benchmark.campaign import check_study
    from stereo_slam_env.benchmark.recordings.source import Renderer, checked
    from stereo_slam_env.benchmark.scenarios.scenario import Sensor

    if show_list:
        show_groups(presets(), PRESET_GROUPS)
        return
    options.require_place()
    if preset is not None and scenario is not None:
        raise ValueError("--preset and --scenario exclude each other: give one of them")
    usual = "quick" if policy is None else "gaze"
    if write is not None:
        from stereo_slam_env.benchmark.scenarios.schema import write_scenario_file

        if scenario is not None:
            raise ValueError("--write and --scenario exclude each other: it writes a preset")
        write_scenario_file(write, preset or usual)
        typer.echo(f"scenario: {write.resolve()}")
        return
    if scenario is not None:
        study = load_study(scenario, data=data, allow_code=allow_code)
    else:
        study = preset_study(preset or usual, data=data)

    measured: Sensor | None = checked("--sensor", sensor, Sensor | None)
    drawn: Renderer | None = checked("--renderer", renderer, Renderer | None)

    def adjusted(one: Scenario) -> Scenario:
        changes: dict[str, Any] = {} if seeds is None else {"seeds": range(seeds)}
        if policy is not None:
            changes["policies"] = _chosen("--policy", policy, one.policies)
        return one.replaced(**changes).with_sensor(measured, drawn)

    study = options.adjusted(study.with_scenarios(adjusted))
    if rig is not None:
        if other := next((cell.scenario.source.kind for cell in study.cells if not cell.scenario.source.has_rig), None):
            raise ValueError(f"--rig needs a simulated camera, got a scenario of kind {other!r}")
        study = study.with_settings({"options.rig": rig_from(rig)})
    check_study(study)
    directory = options.directory(study)
    with options.film(study.name) as show:
        show(study.cells[0].scenario)
    options.run(directory)


@with_options(ImagesOptions, "images")
@with_options(RunOptions, "options")
def replay(
    path: Annotated[
        str,
        typer.Argument(
            help="Folder of a real recording (known by its files), a ROS bag, or 'gtsam' for the wheel's example."
        ),
    ],
    *,
    options: RunOptions,
    images: ImagesOptions,
) -> None:
    """Compare filters on a real drive, of tracks or images."""
    from stereo_slam_env.benchmark import Scenario, Study
    from stereo_slam_env.benchmark.campaign import check_study
    from stereo_slam_env.benchmark.recordings.sources import DatasetSource
    from stereo_slam_env.benchmark.scenarios.scenario import REAL_DRIVE_FILTERS, filter_choice
    from stereo_slam_env.benchmark.scenarios.streams import make_recording
    from stereo_slam_env.report.console import progress_bar, show_recording

    where = path if path.partition(":")[0] == "gtsam" else str(Path(path).resolve())
    options.require_place()
    name = f"replay-{Path(where).name.replace(':', '-')}"
    # No bound: the true noise is not known.
    as_it_comes = Scenario(name, DatasetSource(where, images.given()), REAL_DRIVE_FILTERS, metrics=("map", "windows"))
    study = options.adjusted(Study.of(as_it_comes))
    check_study(study)
    scenario = study.only_scenario()
    with options.film(scenario.name) as show:
        with progress_bar(console(stderr=True), "pairs") as progress:
            recording = make_recording(scenario, None, progress)
        show_recording(console(), recording)
        if options.filters is None and all(frame.inertial is not None for frame in recording.frames[1:]):
            scenario = scenario.replaced(filters=(filter_choice("inertial"), *scenario.filters))
        arguments: dict[str, Any] = {"use_odometry": options.odometry}
        named = {key.partition(".")[0] for key in options.changes}
        arguments |= {key: value for key, value in scenario.filter_setup.as_dict().items() if key in named}
        scenario = scenario.set_up_for(scenario.source.record(None, scenario.frames), arguments)
        directory = options.directory(Study.of(scenario))
        show(scenario)
    options.run(directory)


def _with_front_end(source: Source, name: str) -> Source:
    """The source measured by another front end."""
    from stereo_slam_env.frontend.front_ends import front_end_factory

    front_end_factory(name)
    if not source.takes_images:
        raise ValueError("--front-end needs images: give a recording of images, or --sensor images")
    if source.kind == "dataset":
        return source.replaced(front_end={**source.options.get("front_end", {}), "method": name})
    return source.replaced(front_end_name=name)


def _chosen(option: str, text: str, choices: Sequence[FilterChoice | PolicyChoice]) -> tuple[Any, ...]:
    """Entries of a list of filters or policies, with the choices of the scenario in place of their labels."""
    labelled = {choice.label: choice for choice in choices}
    return tuple(labelled.get(entry, entry) if isinstance(entry, str) else entry for entry in listed(option, text))


def _outside(text: str) -> FilterChoice:
    """The competitor that `--trajectory` names."""
    from stereo_slam_env.benchmark.scenarios.scenario import OUTSIDE, FilterChoice

    label, equals, name = text.partition("=")
    if not (label and equals and name):
        raise ValueError(f"--trajectory must be LABEL=FILE, as orbslam3=est.tum, got {text!r}")
    return FilterChoice(label, OUTSIDE, {"file": str(Path(name).absolute())})
