"""The pieces of work a benchmark consists of: a recording, a trial, a bound.

Bytes in, bytes out, so that any process of any machine can do them, and the store only has to write what comes back.
"""

from __future__ import annotations

import io
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters import ConstantVelocity
from stereo_slam_env.benchmark.isolation import Tell, WorkDied, WorkTooSlow, run_isolated
from stereo_slam_env.benchmark.limits import Bound, cramer_rao_bound
from stereo_slam_env.benchmark.results import FilterRun
from stereo_slam_env.benchmark.run_archive import packed_run
from stereo_slam_env.benchmark.runner import failed_run, run_filter
from stereo_slam_env.benchmark.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.sensor_noise import noise_of_images
from stereo_slam_env.benchmark.sources import make_recording, make_sequence, stream_digest, without_measurements
from stereo_slam_env.frontend.active_search import ActiveSearch
from stereo_slam_env.recording_archive import packed_recording, unpacked_recording

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
    recording : bytes
        See `recording_archive`.
    provenance : mapping
        Kept with the result.
    """

    cell: int
    scenario: Scenario
    seed: int | None
    choice: FilterChoice | None
    recording: bytes
    provenance: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class DoneTrial:
    """The content of the file that keeps the result."""

    cell: int
    seed: int | None
    choice: FilterChoice | None
    content: bytes


def make(task: RecordingTask, progress: Tell | None = None) -> MadeRecording:
    """Make a recording, in a process of its own.

    Raises
    ------
    ValueError
        See `sources.make_recording`.
    """
    return run_isolated(partial(_make, task), progress=progress)


def _make(task: RecordingTask, tell: Tell) -> MadeRecording:
    recording = make_recording(task.scenario, task.seed, tell)
    description: dict[str, Any] = {
        "name": recording.name,
        "frames": len(recording),
        "stream_sha256": stream_digest(recording),
        "R": recording.noise.R.tolist(),
        "source": dict(recording.source),
    }
    measured = noise_of_images(recording)
    if measured is not None:
        description["sensor_noise"] = measured
    return MadeRecording(task, packed_recording(recording), description)


def run_trial(task: TrialTask, progress: Tell | None = None) -> DoneTrial:
    """Run a filter, or compute a bound, in a process of its own; whatever goes wrong there is a result, too."""
    if task.choice is None:
        return DoneTrial(task.cell, task.seed, None, _packed_bound(_bound_or_none(task), task.provenance))
    try:
        run = run_isolated(
            partial(_filtered, task, task.choice), silence_limit=task.scenario.frame_time_limit, progress=progress
        )
    except (WorkDied, WorkTooSlow) as error:
        recording, choice = unpacked_recording(task.recording), task.choice
        run = failed_run(recording, choice.label, choice.options, task.seed, str(error))
        _log.warning("%s on %s: %s", choice.label, recording.name, error)
    return DoneTrial(task.cell, task.seed, task.choice, packed_run(run, task.provenance))


def _filtered(task: TrialTask, choice: FilterChoice, tell: Tell) -> FilterRun:
    scenario, recording = task.scenario, unpacked_recording(task.recording)
    noise = scenario.assumed_noise(recording.noise)
    observe: Callable[..., Any] | None = None
    if scenario.search == "forecast":
        recording = without_measurements(recording)
        observe = ActiveSearch(*make_sequence(scenario, task.seed)).observe
    return run_filter(
        recording,
        choice.name,
        choice.options,
        label=choice.label,
        common_options=scenario.common_options,
        noise=noise,
        use_odometry=scenario.use_odometry,
        score_map="map" in scenario.metrics,
        seed=task.seed,
        observe=observe,
        progress=tell,
    )


def _bound_or_none(task: TrialTask) -> Bound | None:
    try:
        return run_isolated(partial(_bounded, task))
    except (WorkDied, ArithmeticError, np.linalg.LinAlgError) as error:
        _log.warning("no bound for seed %s: %s", task.seed, error)
        return None


def _bounded(task: TrialTask, tell: Tell) -> Bound | None:
    recording, scenario = unpacked_recording(task.recording), task.scenario
    with threadpool_limits(limits=1):
        return cramer_rao_bound(recording, ConstantVelocity(**scenario.motion), use_odometry=scenario.use_odometry)


def _packed_bound(bound: Bound | None, provenance: Mapping[str, Any]) -> bytes:
    stream = io.BytesIO()
    pose = np.zeros((0, 6, 6)) if bound is None else bound.pose
    np.savez_compressed(stream, pose=pose, code=np.array(provenance["code"]))
    return stream.getvalue()
