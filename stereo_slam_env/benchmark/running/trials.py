"""Run one filter over many recordings at once: the same runs as one by one, for Monte Carlo over small maps."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters import PoseBelief, StereoEKF, StereoEKFTrials, StereoNoise, VelocityBelief
from filters.common_options import make_with_common_options
from filters.trials.series import TOGETHER
from stereo_slam_env.benchmark.running.runner import RunLog, failure_line
from stereo_slam_env.evaluation.results import EVENTS, FilterRun, peak_memory_mb
from stereo_slam_env.recording.recording import Recording


def run_filter_together(
    recordings: Sequence[Recording],
    filter_name: str,
    options: Mapping[str, Any] | None = None,
    *,
    label: str | None = None,
    common_options: Mapping[str, Any] | None = None,
    noise: StereoNoise | None = None,
    use_odometry: bool = True,
    seeds: Sequence[int] | None = None,
    score_maps: bool = True,
    together: int = TOGETHER,
) -> list[FilterRun]:
    """Feed recordings of one scenario to a filter, `together` of them in lock-step.

    Parameters
    ----------
    recordings : sequence of Recording
        With the same camera, noise and timestamps.
    filter_name, options, label, common_options, noise, use_odometry
        As of `run_filter`; the filter must be a `StereoEKF` whose options work in lock-step.
    seeds : sequence of int, optional
        Of the recordings, for the results.
    score_maps : bool
        Whether to score the landmarks, too. That goes trial by trial and costs more than the filter; without it
        `landmark_nees` and `landmark_rmse` are NaN and there are no traces.
    together : int
        Trials at a time.

    Returns
    -------
    list of FilterRun
        Those of `run_filter`, to rounding; milliseconds and `memory_mb` are those of all trials at a time, shared
        equally. A trial whose belief is not finite any more is a failed run, and the others go on.

    Raises
    ------
    ValueError
        Recordings that do not go together, or a filter that runs only one by one.
    """
    if not recordings or len(recordings[0]) == 0:
        raise ValueError("recordings must be at least one, with frames: there is nothing to run")
    first = recordings[0]
    for number, recording in enumerate(recordings):
        for name, other, own in (
            ("camera", recording.camera, first.camera),
            ("noise", recording.noise, first.noise),
            ("timestamps", _timestamps(recording), _timestamps(first)),
        ):
            if other != own:
                raise ValueError(f"recordings must have one {name}, recording {number} has another: use run_filter")
    if seeds is not None and len(seeds) != len(recordings):
        raise ValueError(f"seeds must be one for each of {len(recordings)} recordings, got {len(seeds)}")
    if type(together) is not int or together < 1:
        raise ValueError(f"together must be an integer >= 1, got {together!r}")
    assumed = first.noise if noise is None else noise
    made = make_with_common_options(filter_name, first.camera, assumed, options or {}, common_options or {})
    one = made.filter
    if not isinstance(one, StereoEKF):
        raise ValueError(f"filter {filter_name!r} is no StereoEKF and runs only one by one: use run_filter")
    runs = []
    with threadpool_limits(limits=1):
        for begin in range(0, len(recordings), together):
            group = recordings[begin : begin + together]
            memory = peak_memory_mb()
            logs, failures = _run(one, group, use_odometry, score_maps)
            memory = (peak_memory_mb() - memory) / len(group)
            for number, (log, failure) in enumerate(zip(logs, failures, strict=True), start=begin):
                seed = None if seeds is None else seeds[number]
                runs.append(log.result(label or filter_name, made.options, seed, failure, memory, made.not_given))
    return runs


def _run(
    one: StereoEKF, recordings: Sequence[Recording], use_odometry: bool, score_maps: bool
) -> tuple[list[RunLog], list[str | None]]:
    """The logs of one group, and what went wrong."""
    slam = StereoEKFTrials(one, len(recordings))
    slam.reset([vars(recording.start) for recording in recordings])
    logs = [RunLog(recording) for recording in recordings]
    failures: list[str | None] = [None] * len(recordings)
    timestamps = _timestamps(recordings[0])
    unknown = np.full(7, np.nan)
    for k, frames in enumerate(zip(*(recording.frames for recording in recordings), strict=True)):
        observations = [frame.observation for frame in frames]
        odometry = [frame.odometry for frame in frames] if use_odometry else None
        began = time.perf_counter()
        if k:
            slam.predict(timestamps[k] - timestamps[k - 1], odometry)
        predicted = time.perf_counter()
        reports = slam.update(observations)
        each = 1000.0 / len(recordings)
        predicting, updating = each * (predicted - began), each * (time.perf_counter() - predicted)

        pose, velocity, sizes, counts = slam.pose, slam.velocity, slam.map_sizes, reports.counts()
        state_sizes = slam.state_sizes
        counts = {name: counts[name] for name in EVENTS} | {
            "failed_factorisations": counts["failed"],
            "map_size": sizes,
        }
        poses = [unknown if f.truth is None else np.r_[f.truth.position, f.truth.orientation] for f in frames]
        errors, covariances = slam.pose_error(*np.split(np.array(poses), [3], axis=1))
        for b, (log, frame) in enumerate(zip(logs, frames, strict=True)):
            if failures[b] is not None:
                continue
            try:
                log.add_belief(
                    k,
                    PoseBelief(pose.position[b], pose.orientation[b], pose.covariance[b]),
                    VelocityBelief(velocity.linear[b], velocity.angular[b], velocity.covariance[b]),
                    float(reports.nis[b]),
                    int(reports.nis_dof[b]),
                    {name: int(count[b]) for name, count in counts.items()},
                )
                log.add_cost(k, predicting, updating, float(state_sizes[b]))
                if frame.truth is not None:
                    log.add_pose_error(k, errors[b], covariances[b])
                if score_maps:
                    log.add_map(k, frame, slam.trial(b))
            except ArithmeticError as error:
                failures[b] = failure_line(k, error)
    return logs, failures


def _timestamps(recording: Recording) -> list[float]:
    return [frame.timestamp for frame in recording.frames]
