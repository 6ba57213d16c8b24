"""The pieces of work a benchmark consists of: a recording, a trial, a bound.

Bytes in, bytes out, so that any process of any machine can do them, and the store only has to write what comes back.
"""

from __future__ import annotations

import dataclasses
import io
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters import ConstantVelocity
from stereo_slam_env.benchmark.recordings.description import description_of
from stereo_slam_env.benchmark.running.isolation import Tell, WorkDied, WorkTooSlow, run_isolated
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.streams import as_given, make_recording, make_sequence, without_measurements
from stereo_slam_env.benchmark.storage.run_archive import packed_run
from stereo_slam_env.evaluation.cramer_rao import Bound, cramer_rao_bound
from stereo_slam_env.evaluation.filter_run import failed_run, run_filter
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.frontend.recorder import ActiveSearch
from stereo_slam_env.frontend.settings import TrackerSettings
from stereo_slam_env.loop import Observe
from stereo_slam_env.recording.archive import packed_recording, unpacked_recording
from stereo_slam_env.recording.recording import ImageSequence, Recording

if TYPE_CHECKING:
    from stereo_slam_env.policies.episode import Episode

OpenedImages = tuple[ImageSequence, TrackerSettings]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RecordingTask:
    """Make the measurement stream of a seed, for a cell of the study and those that share it."""

    cell: int
    scenario: Scenario
    seed: int | None


@dataclass(frozen=True, eq=False)
class MadeRecording:
    """A recording as bytes, and what is to be told of it (JSON-able)."""

    task: RecordingTask
    content: bytes
    description: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class TrialTask:
    """Run a filter on a recording; without a filter: compute the bound.

    Attributes
    ----------
    cell : int
        Of the study.
    recording : bytes, optional
        See `recording_archive`; None: the policy of `choice` drives an episode of its own.
    provenance : mapping
        Kept with the result.
    """

    cell: int
    scenario: Scenario
    seed: int | None
    choice: FilterChoice | None
    recording: bytes | None
    provenance: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class DoneTrial:
    """The content of the file that keeps the result, and what was recorded where the policy drove."""

    cell: int
    seed: int | None
    choice: FilterChoice | None
    content: bytes
    made: MadeRecording | None = None


def make(task: RecordingTask, progress: Tell | None = None) -> MadeRecording:
    """Make a recording; one that is drawn or calculated in a process of its own, one that is only read in this.

    Raises
    ------
    ValueError
        See `sources.make_recording`.
    RuntimeError
        The process ended, or gave no sign of life for the scenario's `recording_time_limit`.
    """
    scenario = task.scenario
    if not scenario.source.isolated:  # a drive that is replayed has been read already (see `sources`)
        return _make(task, progress or (lambda done, total: None))
    try:
        return run_isolated(partial(_make, task), silence_limit=scenario.recording_time_limit, progress=progress)
    except (WorkDied, WorkTooSlow) as error:
        raise RuntimeError(f"the recording of scenario {scenario.name!r}, seed {task.seed}, failed: {error}") from error


def _make(task: RecordingTask, tell: Tell) -> MadeRecording:
    recording = make_recording(task.scenario, task.seed, tell)
    return MadeRecording(task, packed_recording(recording), description_of(recording))


def run_trial(task: TrialTask, progress: Tell | None = None) -> DoneTrial:
    """Run a filter, or compute a bound, in a process of its own; whatever goes wrong there is a result, too."""
    if task.choice is None:
        return DoneTrial(task.cell, task.seed, None, _packed_bound(_bound_or_none(task), task.provenance))
    limit = task.scenario.frame_time_limit
    if task.choice.policy is not None:
        return _drive(task, task.choice, limit, progress)
    work = partial(_filtered, task, task.choice, _opened_images(task.scenario, task.seed))
    try:
        run = run_isolated(work, silence_limit=limit, progress=progress)
    except (WorkDied, WorkTooSlow) as error:
        run = _lost(_given(task), task, task.choice, error)
    return DoneTrial(task.cell, task.seed, task.choice, packed_run(run, task.provenance))


def _drive(task: TrialTask, choice: FilterChoice, limit: float, progress: Tell | None) -> DoneTrial:
    """The trial of a policy: its episode, and the run of its filter over what was measured there."""
    made: MadeRecording | None = None
    try:
        run, made = run_isolated(partial(_driven, task, choice), silence_limit=limit, progress=progress)
        description = made.description
    except (WorkDied, WorkTooSlow) as error:
        look = partial(_straight_ahead, task)  # what there was to see, for the figures
        episode = run_isolated(look, silence_limit=task.scenario.recording_time_limit)
        run, description = _lost(episode.recording, task, choice, error), _description_of(episode)
    provenance = {**task.provenance, "recording": as_given(description, task.scenario)}
    return DoneTrial(task.cell, task.seed, choice, packed_run(run, provenance), made)


def _driven(task: TrialTask, choice: FilterChoice, tell: Tell) -> tuple[FilterRun, MadeRecording]:
    """The filter is run again over the recording: there is one way to judge a filter, and it is timed alone."""
    # PyBullet and Gymnasium, only where they are needed.
    from stereo_slam_env.benchmark.scenarios.streams import drive_episode

    assert task.seed is not None
    episode = drive_episode(task.scenario, task.seed, choice, lambda done, of: tell(done, 2 * of))
    recording = episode.recording
    run = _run_on(recording, task, choice, lambda done, of: tell(of + done, 2 * of))
    if episode.failure is not None and run.failure is None:
        run = dataclasses.replace(run, failure=episode.failure)
    about = RecordingTask(task.cell, task.scenario, task.seed)
    return run, MadeRecording(about, packed_recording(recording), _description_of(episode))


def _straight_ahead(task: TrialTask, tell: Tell) -> Episode:
    from stereo_slam_env.benchmark.scenarios.streams import drive_straight_ahead

    assert task.seed is not None
    return drive_straight_ahead(task.scenario, task.seed)


def _description_of(episode: Episode) -> dict[str, Any]:
    return {**description_of(episode.recording), "drive_sha256": episode.drive_digest}


def _opened_images(scenario: Scenario, seed: int | None) -> OpenedImages | None:
    """A recording of images that a filter searches itself; opened here, because its calibration is looked for once."""
    searched = scenario.search == "forecast" and not scenario.source.isolated
    return make_sequence(scenario, seed) if searched else None


def _filtered(task: TrialTask, choice: FilterChoice, opened: OpenedImages | None, tell: Tell) -> FilterRun:
    recording = _given(task)
    if task.scenario.search != "forecast":
        return _run_on(recording, task, choice, tell)
    search = ActiveSearch(*(opened or make_sequence(task.scenario, task.seed)))
    return _run_on(without_measurements(recording), task, choice, tell, search.observe)


def _run_on(
    recording: Recording, task: TrialTask, choice: FilterChoice, tell: Tell, observe: Observe | None = None
) -> FilterRun:
    scenario = task.scenario
    return run_filter(
        recording,
        choice.name,
        choice.options,
        label=choice.label,
        common_options=scenario.common_options,
        noise=scenario.assumed_noise(recording.noise),
        use_odometry=scenario.use_odometry,
        score_map="map" in scenario.metrics,
        seed=task.seed,
        observe=observe,
        progress=tell,
    )


def _lost(recording: Recording, task: TrialTask, choice: FilterChoice, error: Exception) -> FilterRun:
    _log.warning("%s on %s: %s", choice.label, recording.name, error)
    return failed_run(recording, choice.label, choice.options, task.seed, str(error))


def _given(task: TrialTask) -> Recording:
    assert task.recording is not None
    return unpacked_recording(task.recording)


def _bound_or_none(task: TrialTask) -> Bound | None:
    try:
        return run_isolated(partial(_bounded, task), silence_limit=task.scenario.frame_time_limit)
    except (WorkDied, WorkTooSlow, ArithmeticError, np.linalg.LinAlgError) as error:
        _log.warning("no bound for seed %s: %s", task.seed, error)
        return None


def _bounded(task: TrialTask, tell: Tell) -> Bound | None:
    recording, scenario = _given(task), task.scenario
    with threadpool_limits(limits=1):
        return cramer_rao_bound(
            recording, ConstantVelocity(**scenario.motion), use_odometry=scenario.use_odometry, progress=tell
        )


def _packed_bound(bound: Bound | None, provenance: Mapping[str, Any]) -> bytes:
    stream = io.BytesIO()
    pose = np.zeros((0, 6, 6)) if bound is None else bound.pose
    np.savez_compressed(stream, pose=pose, code=np.array(provenance["code"]))
    return stream.getvalue()
