"""Tasks of a benchmark: to make a recording, to run a trial, to compute a bound; and a view of the search in images.

Bytes in, bytes out, so that any process of any machine can do them, and the store only has to write what comes back.

Tasks of one kind go in batches, each in one process (`make_all`, `run_all_trials`). A batch is only a faster way to do
the same: where anything goes wrong in it, its tasks are done one by one, each in a process of its own, and what goes
wrong there is what is told.
"""

from __future__ import annotations

import dataclasses
import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from filters import ConstantVelocity
from filters.catalogue.registry import named_filters
from filters.contract.validation import first_line
from stereo_slam_env.benchmark.recordings.source import OpenedImages
from stereo_slam_env.benchmark.recordings.sources import StreetSource
from stereo_slam_env.benchmark.running.isolation import (
    NoProcess,
    Tell,
    WorkDied,
    WorkFailed,
    WorkTooSlow,
    attempted,
    run_isolated,
)
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.streams import (
    as_given,
    description_of,
    drive_episode,
    drive_straight_ahead,
    make_recording,
    make_recordings,
    make_sequence,
    without_measurements,
)
from stereo_slam_env.benchmark.storage.run_files import packed_bound, packed_run
from stereo_slam_env.evaluation.batch_run import run_batch
from stereo_slam_env.evaluation.body_frames import read_body
from stereo_slam_env.evaluation.cramer_rao import Bound, cramer_rao_bound, cramer_rao_bounds
from stereo_slam_env.evaluation.filter_run import failed_run, run_filter
from stereo_slam_env.evaluation.outside_run import outside_run
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.run_figures import score_of
from stereo_slam_env.frontend.track_recorder import ActiveSearch, Watch, record_tracks
from stereo_slam_env.loop import Observe
from stereo_slam_env.recording.archive import packed_recording, unpacked_recording
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.recording.trajectory_files import load_trajectory

if TYPE_CHECKING:
    from stereo_slam_env.policies.policy_rows import Episode

Result = TypeVar("Result")

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Task:
    """Run a filter on a recording; without a filter: compute the bound, or make the recording (`make`)."""

    cell: int  # of the study
    scenario: Scenario
    seed: int | None
    choice: FilterChoice | None = None
    recording: bytes | None = None  # see `recording.archive`; None: the policy of `choice` drives an episode of its own
    provenance: Mapping[str, Any] = field(default_factory=dict)  # kept with the result
    bound: Bound | None = None  # for the recording, for the figures of the trial
    whole: bool = True  # whether the time series are kept, see `run_files`
    timed: bool = True  # whether the times of the filter are wanted


@dataclass(frozen=True, eq=False)
class Done:
    """A result as bytes: a recording with its description (JSON-able), or a trial, with the one its policy made."""

    cell: int
    seed: int | None
    choice: FilterChoice | None
    content: bytes
    description: Mapping[str, Any] = field(default_factory=dict)
    made: Done | None = None


AT_ONCE = 8
"""Tasks of a batch."""
TIMED = 5
"""Recordings on which every filter is run by itself, and timed."""
SECONDS_BETWEEN_SIGNS = 0.1
"""Between signs of life of a trial."""


def goes_in_a_batch(task: Task) -> bool:
    """Whether a task may be done with others of its kind: our own code, whose times nobody wants."""
    scenario, choice = task.scenario, task.choice
    if task.recording is None:
        return choice is None and scenario.source.at_once
    if choice is None:
        return True
    alone = task.timed or scenario.search == "forecast" or "windows" in scenario.metrics
    return not alone and choice.policy is None and choice.name in named_filters()


def batches(tasks: Iterable[Task]) -> Iterator[list[Task]]:
    """The tasks, in their order: alone, or with others of one kind, of one cell and filter."""
    open_ones: dict[tuple[int, str | None], list[Task]] = {}
    for task in tasks:
        if not goes_in_a_batch(task):
            yield [task]
            continue
        key = task.cell, None if task.choice is None else task.choice.label
        batch = open_ones.setdefault(key, [])
        batch.append(task)
        if len(batch) == AT_ONCE:
            yield open_ones.pop(key)
    yield from open_ones.values()


def make_all(tasks: Sequence[Task], progress: Tell | None = None, *, here: bool = False) -> list[Done]:
    """Make the recordings of a batch; raises as `make`."""
    return _together(tasks, _make_all, partial(make, here=here), tasks[0].scenario.recording_time_limit, progress)


def run_all_trials(tasks: Sequence[Task], progress: Tell | None = None) -> list[Done]:
    """Run the trials of a batch, or compute its bounds."""
    work = _bound_all if tasks[0].choice is None else _filter_all
    return _together(tasks, work, run_trial, tasks[0].scenario.frame_time_limit, progress)


def _together(
    tasks: Sequence[Task],
    work: Callable[[Sequence[Task], Tell], list[Done] | None],
    alone: Callable[[Task, Tell | None], Done],
    limit: float,
    progress: Tell | None,
) -> list[Done]:
    done = None
    if len(tasks) > 1:
        try:
            done = _isolated(partial(work, tasks), silence_limit=limit, progress=progress)
        except (CancelledError, NoProcess):
            raise
        except Exception as error:  # of one of them: they are done once more, each by itself
            _log.info("%d tasks are done one by one: %s", len(tasks), first_line(error))
    return [alone(task, progress) for task in tasks] if done is None else done


def _isolated(work: Callable[[Tell], Result], *, silence_limit: float, progress: Tell | None = None) -> Result:
    """`run_isolated` for work that tells of every frame: a message costs as much as a part of one, so few are sent."""
    return run_isolated(partial(_telling_less, work), silence_limit=silence_limit, progress=progress)


def _telling_less(work: Callable[[Tell], Result], tell: Tell) -> Result:
    told = -math.inf

    def now_and_then(done: int, total: int) -> None:
        nonlocal told
        if time.monotonic() >= told + SECONDS_BETWEEN_SIGNS:
            tell(done, total)
            told = time.monotonic()

    return work(now_and_then)


def _make_all(tasks: Sequence[Task], tell: Tell) -> list[Done]:
    recordings = make_recordings(tasks[0].scenario, [task.seed for task in tasks], tell)
    return [_recording_of(task, recording) for task, recording in zip(tasks, recordings, strict=True)]


def _bound_all(tasks: Sequence[Task], tell: Tell) -> list[Done]:
    return [_bound_of(task, bound) for task, bound in zip(tasks, _bounded(tasks, tell), strict=True)]


def _filter_all(tasks: Sequence[Task], tell: Tell) -> list[Done] | None:
    choice, scenario, recordings = tasks[0].choice, tasks[0].scenario, [_given(task) for task in tasks]
    assert choice is not None
    runs = run_batch(
        recordings,
        choice.name,
        choice.options,
        label=choice.label,
        common_options=scenario.common_options,
        noises=[scenario.assumed_noise(recording.noise) for recording in recordings],
        use_odometry=scenario.use_odometry,
        score_map="map" in scenario.metrics,
        seeds=[task.seed for task in tasks],
        progress=tell,
    )
    if runs is None:
        return None
    return [
        Done(task.cell, task.seed, choice, _packed(task, run, task.provenance))
        for task, run in zip(tasks, runs, strict=True)
    ]


def make(task: Task, progress: Tell | None = None, *, here: bool = False) -> Done:
    """Make a recording in a process of its own; with `here`, one that is only read is made in this process.

    A `ChildProcessError` says that the process ended, or gave no sign of life for the scenario's
    `recording_time_limit`.
    """
    if here and not task.scenario.source.isolated:  # it has often been read already (see `sources`)
        return _make(task, progress or (lambda done, total: None))
    return _recorded(task, partial(_make, task), progress)


def _recorded(task: Task, work: Callable[[Tell], Result], progress: Tell | None = None) -> Result:
    scenario = task.scenario
    try:
        return _isolated(work, silence_limit=scenario.recording_time_limit, progress=progress)
    except (WorkDied, WorkTooSlow) as error:
        message = f"the recording of scenario {scenario.name!r}, seed {task.seed}, failed: {error}"
        raise ChildProcessError(message) from error


def _make(task: Task, tell: Tell) -> Done:
    return _recording_of(task, make_recording(task.scenario, task.seed, tell))


def _recording_of(task: Task, recording: Recording) -> Done:
    return Done(task.cell, task.seed, None, packed_recording(recording), description_of(recording))


def run_trial(task: Task, progress: Tell | None = None) -> Done:
    """Run a filter, or compute a bound, in a process of its own; what goes wrong there is a result, too."""
    if task.choice is None:
        return _bound_of(task, _bound(task))
    limit = task.scenario.frame_time_limit
    if task.choice.policy is not None:
        return _drive(task, task.choice, limit, progress)
    # Real images that a filter searches itself are opened here, because their calibration is looked for once.
    searches = task.scenario.search == "forecast" and not task.choice.is_outside
    searched = searches and not task.scenario.source.isolated
    work = partial(_filtered, task, task.choice, make_sequence(task.scenario, task.seed) if searched else None)
    try:
        packed = _isolated(partial(attempted, work), silence_limit=limit, progress=progress)
    except (WorkDied, WorkTooSlow, WorkFailed) as error:
        packed = _packed(task, _lost(_given(task), task, task.choice, error), task.provenance)
    return Done(task.cell, task.seed, task.choice, packed)


def _drive(task: Task, choice: FilterChoice, limit: float, progress: Tell | None) -> Done:
    """The trial of a policy: its episode, and the run of its filter over what was measured there."""
    episode_result: Done | None = None
    try:
        work = partial(attempted, partial(_driven, task, choice))
        run, episode_result = _isolated(work, silence_limit=limit, progress=progress)
        description = episode_result.description
    except (WorkDied, WorkTooSlow, WorkFailed) as error:
        look = partial(drive_straight_ahead, task.scenario, task.seed)  # what there was to see, for the figures
        episode = _recorded(task, look)
        run, description = _lost(episode.recording, task, choice, error), _description_of(episode)
    provenance = {**task.provenance, "recording": as_given(description, task.scenario)}
    return Done(task.cell, task.seed, choice, _packed(task, run, provenance), made=episode_result)


def _driven(task: Task, choice: FilterChoice, tell: Tell) -> tuple[FilterRun, Done]:
    """The filter is run again over the recording: there is one way to judge a filter, and it is timed alone."""
    assert task.seed is not None
    episode = drive_episode(task.scenario, task.seed, choice, lambda done, of: tell(done, 2 * of))
    recording = dataclasses.replace(episode.recording, stated_setup=task.scenario.filter_setup)
    run = _run_on(recording, task, choice, lambda done, of: tell(of + done, 2 * of))
    if episode.failure is not None and run.failure is None:
        run = dataclasses.replace(run, failure=episode.failure)
    return run, Done(task.cell, task.seed, choice, packed_recording(recording), _description_of(episode))


def _description_of(episode: Episode) -> dict[str, Any]:
    return {**description_of(episode.recording), "drive_sha256": episode.drive_digest}


def _filtered(task: Task, choice: FilterChoice, opened: OpenedImages | None, tell: Tell) -> bytes:
    recording, observe = _given(task), None
    if choice.is_outside:
        return _packed(task, outside_run_of(recording, choice, task.seed), task.provenance)
    if task.scenario.search == "forecast":
        search = ActiveSearch(*(opened or make_sequence(task.scenario, task.seed)))
        recording, observe = without_measurements(recording), search.observe
    return _packed(task, _run_on(recording, task, choice, tell, observe), task.provenance)


def _packed(task: Task, run: FilterRun, provenance: Mapping[str, Any]) -> bytes:
    """The run with its figures, which are computed here, once."""
    score = score_of(run, divergence_percent=task.scenario.divergence_percent, bound=task.bound)
    return packed_run(run, provenance, score, whole=task.whole)


def _run_on(
    recording: Recording, task: Task, choice: FilterChoice, tell: Tell, observe: Observe | None = None
) -> FilterRun:
    scenario = task.scenario
    return run_filter(
        recording,
        choice.name,
        choice.options,
        label=choice.label,
        score_map="map" in scenario.metrics,
        windows="windows" in scenario.metrics,
        seed=task.seed,
        observe=observe,
        progress=tell,
    )


def outside_run_of(recording: Recording, choice: FilterChoice, seed: int | None) -> FilterRun:
    """The run that the trajectory of a competitor is; one that cannot be read is a result, too."""
    options = dict(choice.options)
    try:
        trajectory = load_trajectory(choice.outside_file(seed))
        if "body" in options:
            trajectory = trajectory.of_body(read_body(Path(options["body"])))
    except (ValueError, OSError, ImportError) as error:
        return failed_run(recording, choice.label, options, seed, first_line(error))
    return outside_run(recording, trajectory, label=choice.label, options=options, seed=seed)


def _lost(recording: Recording, task: Task, choice: FilterChoice, error: Exception) -> FilterRun:
    _log.warning("%s on %s: %s", choice.label, recording.name, error)
    return failed_run(recording, choice.label, choice.options, task.seed, str(error))


def _given(task: Task) -> Recording:
    assert task.recording is not None
    # Cells that share a recording may set filters up differently.
    return dataclasses.replace(unpacked_recording(task.recording), stated_setup=task.scenario.filter_setup)


def _bound(task: Task) -> Bound | None:
    """The bound; None, and a warning, where it cannot be computed."""
    try:
        (bound,) = _isolated(partial(_bounded, [task]), silence_limit=task.scenario.frame_time_limit)
        return bound
    except (WorkDied, WorkTooSlow, ArithmeticError, np.linalg.LinAlgError) as error:
        _log.warning("no bound for seed %s: %s", task.seed, error)
        return None


def _bound_of(task: Task, bound: Bound | None) -> Done:
    return Done(task.cell, task.seed, None, packed_bound(bound, task.provenance["code"]))


def _bounded(tasks: Sequence[Task], tell: Tell) -> list[Bound | None]:
    scenario = tasks[0].scenario
    motion, recordings = ConstantVelocity(**scenario.motion), [_given(task) for task in tasks]
    return cramer_rao_bounds(recordings, motion, use_odometry=scenario.use_odometry, progress=tell)


def rehearsals() -> Iterator[Callable[[], object]]:
    """Functions that record two frames, run the usual filters over them, and compute the bound."""
    usual = Scenario("rehearsal", StreetSource({"route": "right-turn"}), frames=2, gate=None, metrics=("map",))
    recordings: list[Recording] = []
    yield lambda: recordings.append(make_recording(usual, 0))
    for recording in recordings:
        yield partial(cramer_rao_bound, recording, ConstantVelocity())
        for choice in usual.filters:
            yield partial(_run_on, recording, Task(0, usual, 0), choice, lambda done, total: None)


def watch_search(scenario: Scenario, watch: Watch, progress: Tell | None = None) -> None:
    """Run the front end over the scenario's first seed, guided by the first filter if `search` is "forecast".

    `watch` is called with each pair and what was found in it, `progress` with (pairs done, pairs). A `ValueError` says
    that the scenario has no images, or where the filter that guides fails.
    """
    seed = scenario.recording_seeds[0]
    sequence, settings = make_sequence(scenario, seed)
    if scenario.search == "flow":
        record_tracks(sequence, settings, frames=scenario.frames, watch=watch, progress=progress)
        return
    recording = make_recording(scenario, seed)
    choice = next(choice for choice in scenario.filters if not choice.is_outside)
    run = run_filter(
        without_measurements(recording),
        choice.name,
        choice.options,
        observe=ActiveSearch(sequence, settings, watch=watch).observe,
        progress=progress,
    )
    if run.failure is not None:
        raise ValueError(f"the search guided by {choice.label} failed: {run.failure}")
