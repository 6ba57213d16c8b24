"""Every filter on every seed: parallel, resumable, each trial on the identical recording."""

from __future__ import annotations

import dataclasses
import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filters import available_filters, make_filter
from filters.camera import StereoCamera
from filters.noise import StereoNoise
from stereo_slam_env.benchmark.results import FilterRun, FilterSummary
from stereo_slam_env.benchmark.runner import make_with_common_options, run_filter
from stereo_slam_env.benchmark.scenario import FilterChoice, Scenario, filter_choice
from stereo_slam_env.benchmark.sensor_noise import noise_of_images
from stereo_slam_env.benchmark.sources import (
    check_source,
    make_recording,
    make_sequence,
    stream_digest,
    takes_images,
    without_measurements,
)
from stereo_slam_env.benchmark.store import RunDirectory, open_run
from stereo_slam_env.frontend.active_search import ActiveSearch

Progress = Callable[[float, int], None]
WATCH_SECONDS = 0.5

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class BenchmarkResult:
    """What a benchmark found and where it is: the directory, the runs, a summary of each filter, the report."""

    out: Path
    runs: tuple[FilterRun, ...]
    summaries: tuple[FilterSummary, ...]
    report: Path | None


def run_benchmark(
    scenario: Scenario,
    out: str | Path,
    *,
    filters: Sequence[str | FilterChoice] | None = None,
    seeds: Sequence[int] | None = None,
    jobs: int = 2,
    progress: Progress | None = None,
    report: bool = True,
) -> BenchmarkResult:
    """Compare filters on the recordings of a scenario.

    Each recording is made once a seed and given to every filter. Finished trials are kept in `out`: the same call
    goes on where an interrupted one stopped.

    Parameters
    ----------
    scenario : Scenario
        What to run; see `stereo_slam_env.benchmark.presets`.
    out : str or Path
        Run directory, see `stereo_slam_env.benchmark.store`.
    filters : sequence of str or FilterChoice, optional
        Instead of the scenario's.
    seeds : sequence of int, optional
        Instead of the scenario's.
    jobs : int
        Processes; each uses one BLAS thread.
    progress : callable, optional
        Called with (trials done, trials), perhaps from another thread; done has a fraction where trials run in this
        process.
    report : bool
        Whether to write the report.

    Returns
    -------
    BenchmarkResult

    Raises
    ------
    ValueError
        Unknown filter or option, impossible settings, a source that cannot be used, or `out` holds another run.
    """
    if jobs < 1:
        raise ValueError(f"jobs must be >= 1, got {jobs!r}")
    if filters is not None:
        choices = tuple(filter_choice(f) if isinstance(f, str) else f for f in filters)
        scenario = dataclasses.replace(scenario, filters=choices)
    if seeds is not None:
        scenario = dataclasses.replace(scenario, seeds=tuple(seeds))
    check_filters(scenario)
    check_source(scenario)
    run = open_run(Path(out), scenario)
    _run_missing(run, jobs, progress)
    runs, summaries = run.write_results()
    page = None
    if report:
        page = write_report_of(run, runs, summaries)
    return BenchmarkResult(run.out, tuple(runs), summaries, page)


def write_report_of(run: RunDirectory, runs: Sequence[FilterRun], summaries: Sequence[FilterSummary]) -> Path:
    """Write the report of a finished run into its directory."""
    from stereo_slam_env.benchmark.report import write_report  # Matplotlib, only where it is needed

    return write_report(run.out, f"Comparison: {run.scenario.name}", runs, summaries, run.settings())


def check_filters(scenario: Scenario) -> None:
    """Raise a `ValueError` for a filter or option that does not exist, before any work is done.

    A third-party filter that is installed but cannot be loaded is no reason to stop: its runs will say so.
    """
    camera, noise = StereoCamera(700.0, 700.0, 600.0, 180.0, 0.5, 1200, 360), StereoNoise.independent_pixels(1.0)
    known = available_filters()
    for choice in scenario.filters:
        if choice.name not in known:
            make_filter(choice.name, camera=camera, noise=noise)
        if not known[choice.name].startswith("not available"):
            _try_to_make(scenario, choice, camera, noise)


def _try_to_make(scenario: Scenario, choice: FilterChoice, camera: StereoCamera, noise: StereoNoise) -> None:
    try:
        make_with_common_options(choice.name, camera, noise, choice.options, scenario.common_options)
    except ValueError:
        raise
    except Exception as error:  # a third-party constructor may raise anything; the run will record it
        _log.info("filter %s cannot be made: %s", choice.label, error)


def _run_missing(run: RunDirectory, jobs: int, progress: Progress | None) -> None:
    todo = run.missing()
    total = len(run.seeds) * len(run.scenario.filters)
    done = total - len(todo)

    def tell(trials: float) -> None:
        if progress is not None:
            progress(done + trials, total)

    tell(0)
    # Images are looked at once a seed, whoever is idle meanwhile.
    tasks = _tasks(todo, 1 if takes_images(run.scenario) else jobs)
    if min(jobs, len(tasks)) > 1:
        import joblib

        with joblib.parallel_config(backend="loky", inner_max_num_threads=1), _watching(run, todo, tell):
            workers = joblib.Parallel(n_jobs=min(jobs, len(tasks)), batch_size=1)
            workers(joblib.delayed(_run_trials)(run, seed, choices) for seed, choices in tasks)
    else:
        for seed, choices in tasks:
            _run_trials(run, seed, choices, tell)
            done += len(choices)
    done = total
    tell(0)


@contextmanager
def _watching(
    run: RunDirectory, todo: Sequence[tuple[int | None, FilterChoice]], tell: Callable[[float], None]
) -> Iterator[None]:
    """Report trials of other processes as their files appear."""
    paths = [run.trial_path(seed, choice) for seed, choice in todo]
    for path in paths:  # what is there was made by other code
        path.unlink(missing_ok=True)
    over = threading.Event()

    def watch() -> None:
        while not over.wait(WATCH_SECONDS):
            tell(sum(path.exists() for path in paths))

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()


def _tasks(
    todo: Sequence[tuple[int | None, FilterChoice]], jobs: int
) -> list[tuple[int | None, tuple[FilterChoice, ...]]]:
    """A task a seed, so that the recording is made once; a task a trial where that would leave processes idle."""
    by_seed: dict[int | None, list[FilterChoice]] = {}
    for seed, choice in todo:
        by_seed.setdefault(seed, []).append(choice)
    if len(by_seed) < jobs:
        return [(seed, (choice,)) for seed, choice in todo]
    return [(seed, tuple(choices)) for seed, choices in by_seed.items()]


def _run_trials(
    run: RunDirectory,
    seed: int | None,
    choices: Sequence[FilterChoice],
    progress: Callable[[float], None] | None = None,
) -> None:
    """Make the recording, run `choices` on it, keep each result as soon as it is there."""
    scenario = run.scenario
    recording = make_recording(scenario, seed)
    noise = scenario.assumed_noise(recording.noise)
    description: dict[str, Any] = {
        "name": recording.name,
        "frames": len(recording),
        "stream_sha256": stream_digest(recording),
        "assumed_R": noise.R.tolist(),
        "source": dict(recording.source),
    }
    measured = noise_of_images(recording)
    if measured is not None:
        description["sensor_noise"] = measured
    guided = scenario.search == "forecast"
    if guided:
        recording = without_measurements(recording)
    for number, choice in enumerate(choices):

        def within(frames: int, total: int, number: int = number) -> None:
            if progress is not None:
                progress(number + frames / total)

        result = run_filter(
            recording,
            choice.name,
            choice.options,
            label=choice.label,
            common_options=scenario.common_options,
            noise=noise,
            use_odometry=scenario.use_odometry,
            seed=seed,
            observe=ActiveSearch(*make_sequence(scenario, seed)).observe if guided else None,
            progress=within,
        )
        run.save_trial(result, choice, description)
