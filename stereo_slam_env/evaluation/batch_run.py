"""Runs of one filter over many recordings at once, in a `FilterBatch`: the bits of `run_filter`, in less time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters import StereoNoise
from filters.catalogue.registry import MadeFilter, make_with_common_options
from filters.checks.consistency import DEFINITIONS
from filters.engine.batch import FilterBatch, goes_in_a_batch
from filters.geometry.arrays import FloatArray
from stereo_slam_env.evaluation.filter_run import RunLog
from stereo_slam_env.evaluation.map_scoring import FrameMap
from stereo_slam_env.evaluation.results import ContractBroken, FilterRun
from stereo_slam_env.recording.recording import Frame, Recording

_POSE_ERRORS = {type(definition).pose_error for definition in DEFINITIONS}
_LAST_STEP = 0.1
"""s, of filters whose recording has ended: nobody looks at them any more."""


def run_batch(
    recordings: Sequence[Recording],
    filter_name: str,
    options: Mapping[str, Any],
    *,
    label: str,
    common_options: Mapping[str, Any],
    noises: Sequence[StereoNoise],
    use_odometry: bool,
    score_map: bool,
    seeds: Sequence[int | None],
    progress: Callable[[int, int], None],
) -> list[FilterRun] | None:
    """Run a filter over recordings of one camera, frame by frame over all of them.

    Arguments are those of `run_filter`, one noise and seed a recording. Nothing is timed, and the memory is not
    measured: both are NaN.

    Returns
    -------
    list of FilterRun, or None
        None where the filter or the recordings cannot be run so; what the filter raises is passed on.
    """
    first = recordings[0]
    filters_made: list[MadeFilter] = []
    with threadpool_limits(limits=1):
        for recording, noise in zip(recordings, noises, strict=True):
            filters_made.append(make_with_common_options(filter_name, recording.camera, noise, options, common_options))
        alike = all(r.camera == first.camera and r.reference.is_exact and len(r) > 0 for r in recordings)
        if use_odometry and any(frame.inertial is not None for frame in first.frames):
            return None  # a filter that takes samples fuses odometry by itself
        filters = [one.filter for one in filters_made if goes_in_a_batch(one.filter)]
        if not alike or len(filters) < len(filters_made):
            return None
        if any(type(slam.options.error).pose_error not in _POSE_ERRORS for slam in filters):
            return None  # a stranger's definition, which is not to see the truth
        if not all(slam.engine.recipe.is_that_of(filters[0].engine.recipe) for slam in filters):
            return None  # noise of each recording's own may be a part of the recipe
        ready = iter(filters)
        batch = FilterBatch(lambda: next(ready), len(filters))
        batch.reset([recording.start for recording in recordings])
        rows = [_BatchRow(recording) for recording in recordings]
        longest = max(map(len, recordings))
        for k in range(longest):
            _step(batch, rows, k, use_odometry=use_odometry, score_map=score_map)
            progress(k + 1, longest)
        return [
            row.log.result(label, one.options, seed, row.failure or row.log.fault(), float("nan"), one.not_given)
            for row, one, seed in zip(rows, filters_made, seeds, strict=True)
        ]


class _BatchRow:
    """One recording, and what is noted of its run."""

    def __init__(self, recording: Recording) -> None:
        self.recording, self.log = recording, RunLog(recording)
        self.failure: str | None = None

    def frame(self, k: int) -> Frame | None:
        """The frame; None where the recording or the run has ended."""
        return self.recording.frames[k] if k < len(self.recording) and self.failure is None else None


def _step(batch: FilterBatch, rows: Sequence[_BatchRow], k: int, *, use_odometry: bool, score_map: bool) -> None:
    """Frame k of all recordings."""
    frames = [row.frame(k) for row in rows]
    observations = [None if frame is None else frame.observation for frame in frames]
    if k == 0:
        reports = batch.update(observations)
    else:
        dt = [
            _LAST_STEP if frame is None else frame.timestamp - row.recording.frames[k - 1].timestamp
            for row, frame in zip(rows, frames, strict=True)
        ]
        odometries = [frame.odometry if use_odometry and frame is not None else None for frame in frames]
        samples = [None if frame is None else frame.inertial for frame in frames]
        reports = batch.step(
            dt, observations, odometries if any(odometries) else None, samples if any(samples) else None
        )
    beliefs = _beliefs(batch)
    forecasts = batch.forecasts() if score_map else None
    for b, (row, frame) in enumerate(zip(rows, frames, strict=True)):
        if frame is None:
            continue
        log, reference = row.log, row.recording.reference
        try:
            log.note(k, reports[b], **{name: values[b] for name, values in beliefs.items()})
        except ContractBroken:
            row.failure = log.fault()
            continue
        log.note_bodies(k, reports[b])
        if frame.truth is not None:
            error, claimed = batch[b].pose_error(frame.truth.position, frame.truth.orientation)
            counts = reference.counts_as_truth and bool(reference.has_settled(frame.timestamp))
            log.note_errors(k, error, claimed, claimed if counts else None)
        if forecasts is not None:
            log.note_map(FrameMap(k, frame, forecasts[b], batch[b].noise.R))


def _beliefs(batch: FilterBatch) -> dict[str, FloatArray]:
    """Series of a `FilterRun` by name, one row a filter."""
    poses, velocities = batch.poses, batch.velocities
    return {
        "positions": poses[:, :3],
        "orientations": poses[:, 3:],
        "pose_covariances": batch.pose_covariances,
        "linear_velocities": velocities[:, :3],
        "angular_velocities": velocities[:, 3:],
        "velocity_covariances": batch.velocity_covariances,
        "state_size": batch.state_sizes.astype(np.float64),
    }
