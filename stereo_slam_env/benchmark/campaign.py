"""Benchmark runs: every filter on every seed of every scenario, parallel, resumable, on identical recordings."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from filters.catalogue.registry import filter_factory, make_with_common_options, plugin_of
from filters.contract.noise import StereoNoise
from filters.contract.validation import first_line
from filters.geometry.camera import StereoCamera
from stereo_slam_env.benchmark.running.backends import Backend, BackendName, RunAll
from stereo_slam_env.benchmark.running.isolation import Tell
from stereo_slam_env.benchmark.running.tasks import TIMED, Done, Task, batches, make_all, run_all_trials
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, PolicyChoice, Scenario
from stereo_slam_env.benchmark.scenarios.streams import check_source
from stereo_slam_env.benchmark.scenarios.study import Study, load_study, preset_study
from stereo_slam_env.benchmark.storage.result_tables import CellResult, write_results
from stereo_slam_env.benchmark.storage.store import RunDirectory, StudyDirectory, prepared_study
from stereo_slam_env.evaluation.body_frames import read_body
from stereo_slam_env.evaluation.results import FilterRun, FilterSummary
from stereo_slam_env.evaluation.run_figures import Figures
from stereo_slam_env.files.folders import claimed_folder
from stereo_slam_env.recording.archive import packed_recording, unpacked_recording
from stereo_slam_env.recording.trajectory_files import load_trajectory

Progress = Callable[[float, int], None]
ReportWriter = Callable[[StudyDirectory, Sequence[CellResult]], Path]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class BenchmarkResult:
    """Results of a benchmark.

    Attributes
    ----------
    out : Path
        Run directory.
    cells : tuple of CellResult
        One for each scenario.
    report : Path, optional
        The page, if it was written.
    """

    out: Path
    cells: tuple[CellResult, ...]
    report: Path | None

    @property
    def runs(self) -> tuple[FilterRun, ...]:
        """The runs of all cells whose time series are kept, see `Scenario.kept_seeds`."""
        return tuple(run for cell in self.cells for run in cell.runs)

    @property
    def figures(self) -> Figures:
        """Figures of every run, by label of the filter; of a grid, by "cell: label"."""
        return {
            f"{result.cell.name}: {label}" if len(self.cells) > 1 else label: figures
            for result in self.cells
            for label, figures in result.figures.items()
        }

    @property
    def summaries(self) -> tuple[FilterSummary, ...]:
        """A summary of each filter; of a grid, cell by cell."""
        return tuple(summary for cell in self.cells for summary in cell.summaries)


def run_benchmark(
    what: Study | Scenario | str | Path,
    out: str | Path,
    *,
    filters: Sequence[str | FilterChoice] | None = None,
    policies: Sequence[str | PolicyChoice] | None = None,
    seeds: Sequence[int] | None = None,
    jobs: int = 2,
    backend: BackendName = "processes",
    address: str | None = None,
    data: str | Path | None = None,
    allow_code: bool = False,
    progress: Progress | None = None,
    write_report: ReportWriter | None = None,
) -> BenchmarkResult:
    """Compare filters on the recordings of a scenario, or of many.

    Each recording is made once a seed and given to every filter; a policy drives its own episode of the seed. Every
    trial has a process of its own; what it raises, a crash or a hang is its recorded result, and the others go on.
    Finished trials are kept in `out`: the same call goes on where an interrupted one stopped.

    Parameters
    ----------
    what : Study, Scenario, str or Path
        What to run: a scenario, a grid of them, the name of a preset, or a scenario file.
    out : str or Path
        Run directory, see `stereo_slam_env.benchmark.storage.store`.
    filters : sequence of str or FilterChoice, optional
        Instead of the scenario's.
    policies : sequence of str or PolicyChoice, optional
        Instead of the scenario's, which must be of kind "gaze".
    seeds : sequence of int, optional
        Instead of the scenario's.
    jobs : int
        Trials at a time; each uses one core and one BLAS thread.
    backend : {"processes", "dask"}
        Where trials run.
    address : str, optional
        Scheduler of the cluster.
    data : str or Path, optional
        Folder of real recordings, for files that say `{data}`.
    allow_code : bool
        Whether a scenario file may name a function to be called, see `load_study`.
    progress : callable, optional
        Called with (tasks done, tasks): recordings, bounds and trials; done has a fraction where they run one by one.
    write_report : callable, optional
        Writes the report of the results and returns its page: `report.benchmark_report.write_report_of`.

    Returns
    -------
    BenchmarkResult

    Raises
    ------
    ValueError
        Unknown filter or option, impossible settings, a source that cannot be used, or `out` holds another run or is
        in use by another process.
    OSError
        The disk is full or cannot be written, a recording cannot be made, or processes end again and again; what is
        finished is kept.
    """
    workers = Backend(backend, jobs, address)
    study = as_study(what, data=data, allow_code=allow_code)
    given = {"filters": filters, "policies": policies, "seeds": seeds}
    changes = {key: tuple(values) for key, values in given.items() if values is not None}
    study = study.with_scenarios(lambda scenario: scenario.replaced(**changes))
    check_study(study)
    return run_checked(prepared_study(Path(out), study), workers, progress, write_report)


def run_checked(
    directory: StudyDirectory,
    backend: Backend,
    progress: Progress | None = None,
    write_report: ReportWriter | None = None,
) -> BenchmarkResult:
    """Run a study that `check_study` has passed, in a directory of `prepared_study`; as `run_benchmark`."""
    with claimed_folder(directory.root), _interruptible():
        directory = prepared_study(directory.out, directory.study)  # somebody may have written there meanwhile
        missing = [Missing(number, *trial) for number, run in enumerate(directory.cells) for trial in run.missing()]
        directory.write_settings()
        _run_missing(directory.cells, missing, backend, progress or (lambda done, total: None))
        results = write_results(directory)
        page = None if write_report is None else write_report(directory, results)
    return BenchmarkResult(directory.out, tuple(results), page)


@contextmanager
def _interruptible() -> Iterator[None]:
    """End everything and keep what is finished at Ctrl-C, and at SIGTERM where nobody else handles it.

    An interruption may meet a file half written, whose closing fails then: the error is not told in place of it.
    """
    ours = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    if ours:
        interrupts = signal.getsignal(signal.SIGINT)
        signal.signal(signal.SIGTERM, interrupts if callable(interrupts) else signal.default_int_handler)
    try:
        yield
    except Exception as error:
        context = error.__context__
        while context is not None and not isinstance(context, KeyboardInterrupt):
            context = context.__context__
        if context is None:
            raise
        raise KeyboardInterrupt from error
    finally:
        if ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def as_study(what: Study | Scenario | str | Path, *, data: str | Path | None = None, allow_code: bool = False) -> Study:
    """Study from itself, a scenario, the name of a preset or a file; raises as `load_study` and `preset_study`."""
    if isinstance(what, Study):
        return what
    if isinstance(what, Scenario):
        return Study.of(what)
    if isinstance(what, Path) or Path(what).suffix in (".toml", ".json"):
        return load_study(what, data=data, allow_code=allow_code)
    return preset_study(what, data=data)


def check_study(study: Study) -> None:
    """Raise a `ValueError` for a study that cannot be run, before any work is done."""
    scenarios = [cell.scenario for cell in study.cells]
    loadable_filters = _loadable_filters(scenarios)
    for scenario in scenarios:
        check_source(scenario)
    checked: list[tuple[object, ...]] = []
    for scenario in scenarios:
        what_filters_get = scenario.filters, scenario.common_options, scenario.recording_seeds
        if what_filters_get not in checked:  # making every filter may compile it, and most cells share theirs
            _check_options(scenario, loadable_filters)
            checked.append(what_filters_get)


def _loadable_filters(scenarios: Sequence[Scenario]) -> list[str]:
    """Look up the filters of scenarios: names of those that can be loaded.

    A third-party filter that is installed but cannot be loaded is no reason to stop: its runs will say so.
    Those that nobody asked for are not loaded.
    """
    names = (choice.name for scenario in scenarios for choice in scenario.filters if not choice.is_outside)
    loadable = []
    for name in dict.fromkeys(names):
        try:
            filter_factory(name)
            loadable.append(name)
        except ValueError as error:
            if plugin_of(name) is None:
                raise
            _log.warning("%s", error)
    return loadable


def _check_options(scenario: Scenario, loadable_filters: Collection[str]) -> None:
    """Raise a `ValueError` for an option that a filter does not have, or a file of one that cannot be read."""
    camera, noise = StereoCamera(700.0, 700.0, 600.0, 180.0, 0.5, 1200, 360), StereoNoise.independent_pixels(1.0)
    for choice in scenario.filters:
        if choice.is_outside:
            for seed in scenario.recording_seeds:
                load_trajectory(choice.outside_file(seed))
            if "body" in choice.options:
                read_body(Path(choice.options["body"]))
        elif choice.name in loadable_filters:
            try:
                make_with_common_options(choice.name, camera, noise, choice.options, scenario.common_options)
            except (ValueError, KeyboardInterrupt):
                raise
            except BaseException as error:  # a third-party constructor may raise anything; the run will record it
                _log.info("filter %s cannot be made: %s", choice.label, first_line(error))


SEEDS_AT_A_TIME = 100
"""After so many seeds, recordings that are not kept are removed."""
_FEW = 2
"""Recordings for which nothing is loaded beforehand."""


def _run_missing(cells: Sequence[RunDirectory], missing: list[Missing], backend: Backend, progress: Progress) -> None:
    """Make what is missing and keep each result as soon as it is there."""
    total = sum(len(run.seeds) * (len(run.scenario.competitors) + run.scenario.has_bound) for run in cells)
    work = _Work(cells, backend, progress, total - len(missing), total)
    to_record = work.to_record(missing)
    work.wanted += len(to_record)
    work.tell()
    if not missing:
        return
    seeds = list(dict.fromkeys(each.seed for each in missing))
    preloaded = {module: None for task in to_record[_FEW:] for module in task.scenario.source.preloaded}
    with backend.started(isolated=True, preloaded=[*preloaded]) as run_all:
        for first in range(0, len(seeds), SEEDS_AT_A_TIME):
            some = seeds[first : first + SEEDS_AT_A_TIME]
            work.do([each for each in missing if each.seed in some], run_all)
            passing = [seed for seed in some if not any(run.keeps(seed) for run in cells)]
            for run in cells:
                run.remove_recordings(passing)


class Missing(NamedTuple):
    """A trial to be run; without a filter, the bound."""

    cell: int
    seed: int | None
    choice: FilterChoice | None


@dataclass
class _Work:
    """Missing trials of a campaign, and the progress in them."""

    cells: Sequence[RunDirectory]
    backend: Backend
    progress: Progress
    done: int
    wanted: int

    def tell(self, part: float = 0.0) -> None:
        self.progress(self.done + part, self.wanted)

    def within(self, frames: int, of: int) -> None:
        self.tell(frames / of)

    def do(self, missing: Sequence[Missing], run_all: RunAll[Any, Any]) -> None:
        """Make recordings, then bounds, then trials, whose figures hang on both."""
        tell = self.within if self.backend.in_this_process else None
        self._record(missing, run_all, tell)
        for some in ([m for m in missing if m.choice is None], [m for m in missing if m.choice is not None]):
            for batch in run_all(partial(run_all_trials, progress=tell), batches(map(self._task, some))):
                for finished in batch:
                    run, episode = self.cells[finished.cell], finished.made
                    if episode is not None:
                        run.save_recording(finished.seed, episode.content, episode.description, finished.choice)
                    run.save_trial(finished.seed, finished.choice, finished.content)
                    self.done += 1
                    self.tell()

    def _record(self, missing: Sequence[Missing], run_all: RunAll[Any, Any], told: Tell | None) -> None:
        to_record = self.to_record(missing)
        # The only one is made here: a real drive has often been read by this process already (see `sources`).
        alone = len(to_record) == 1
        maker = partial(make_all, here=alone or self.backend.in_this_process, progress=self.within if alone else told)
        for batch in (map if alone else run_all)(maker, batches(to_record)):
            for recording in batch:
                run = self.cells[recording.cell]
                run.save_recording(recording.seed, self._shared(run, recording), recording.description)
                self.done += 1
                self.tell()

    def _shared(self, run: RunDirectory, made: Done) -> bytes:
        """The recording; where cells that share it set filters up differently, it does not say how."""
        path, setup = run.recording_path(made.seed), run.scenario.filter_setup
        setups = (cell.scenario.filter_setup for cell in self.cells if cell.recording_path(made.seed) == path)
        if all(one == setup for one in setups):
            return made.content
        return packed_recording(replace(unpacked_recording(made.content), stated_setup=None))

    def to_record(self, missing: Sequence[Missing]) -> list[Task]:
        """Recordings that are not there, once for all cells that share one."""
        tasks: dict[Path, Task] = {}
        for number, seed, choice in missing:
            run = self.cells[number]
            if not _drives(choice) and not run.recording_is_made(seed):
                tasks.setdefault(run.recording_path(seed), Task(number, run.scenario, seed))
        return list(tasks.values())

    def _task(self, missing: Missing) -> Task:
        number, seed, choice = missing
        run = self.cells[number]
        about = run.provenance(seed, choice)
        if _drives(choice):
            return Task(number, run.scenario, seed, choice, None, about, whole=run.keeps(seed))
        bound = None if choice is None else run.bound(seed)
        content, timed = run.recording_content(seed), seed in run.seeds[:TIMED]
        return Task(number, run.scenario, seed, choice, content, about, bound, run.keeps(seed), timed)


def _drives(choice: FilterChoice | None) -> bool:
    """Whether a policy makes the recording of the trial itself."""
    return choice is not None and choice.policy is not None
