"""A trajectory from outside as a run on a recording, so that it stands beside filters in tables, statistics and charts.

It is held against the truth of the recording as a filter is: at the times of the frames, in the definition of its own
errors, from a start that both know. What a filter has and a file has not, such as innovations, a map and a time a
frame, is not known.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from filters import Pose, nees
from filters.checks.consistency import are_definite
from filters.geometry.arrays import FloatArray, IntArray
from filters.motions.motion_model import POSE_SIZE
from stereo_slam_env.evaluation.filter_run import RunLog
from stereo_slam_env.evaluation.gauges import Alignment, carried, correlation_of, is_zero_at_start
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.synchronisation import MAX_GAP
from stereo_slam_env.evaluation.windows import WINDOWS, motion_covariances, motions, series_of, window_ends
from stereo_slam_env.recording.recording import Recording
from stereo_slam_env.recording.trajectory import Trajectory, pose_errors, tangent_jacobian, transformed


def outside_run(
    recording: Recording,
    trajectory: Trajectory,
    *,
    label: str | None = None,
    options: Mapping[str, Any] | None = None,
    seed: int | None = None,
) -> FilterRun:
    """The run that a trajectory from outside is on a recording.

    Parameters
    ----------
    recording : Recording
        What it was estimated from.
    trajectory : Trajectory
        Poses of the left camera, with the times of the recording, or as many as it has frames, or with the numbers of
        these. Unless its header says that its world is that of the recording, its first pose is put where the vehicle
        was at that time. Frames that it has no pose for stay unknown.
    label : str, optional
        Name in tables and files; None: that of the trajectory.
    options : mapping, optional
        What is kept with the run, JSON-able.
    seed : int, optional
        Of the recording.

    Returns
    -------
    FilterRun
        With `failure` where no pose belongs to a frame, or a covariance is not positive definite; without NEES where
        nothing is claimed, or only motion in a plane.
    """
    log, failure = RunLog(recording), None
    name, options = label or trajectory.name, options or {}
    try:
        rows, frames = _paired(trajectory, log.given["timestamps"])
        poses = _in_world(trajectory.rows(rows), recording, int(frames[0]))
    except ValueError as error:
        return log.result(name, options, seed, str(error), float("nan"))
    claimed = None if poses.plane is not None else poses.covariances
    if claimed is not None:
        sound = are_definite(claimed)
        sound[0] = True  # where it starts may be known exactly
        if not sound.all():
            first = int(np.flatnonzero(~sound)[0])
            failure = f"frame {frames[first]}: its covariance is not positive definite"
            poses, frames = poses.rows(slice(0, first)), frames[:first]
    log.note_series(frames, positions=poses.positions, orientations=poses.orientations)
    if claimed is not None:
        _score(log, recording, poses, frames)
    return log.result(name, options, seed, failure, float("nan"))


def _paired(trajectory: Trajectory, times: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows of a trajectory and the frames that they belong to, in order, each once."""
    if trajectory.timestamps is None:
        numbers = np.arange(len(trajectory)) if trajectory.frame_numbers is None else trajectory.frame_numbers
        if trajectory.frame_numbers is None and len(trajectory) != len(times):
            raise ValueError(
                f"{trajectory.name} has {len(trajectory)} poses without times, the recording {len(times)} frames: give "
                "times, or frame numbers (13 columns)"
            )
        rows = np.flatnonzero((numbers >= 0) & (numbers < len(times)))
        frames = np.asarray(numbers)[rows]
    else:
        after = np.clip(np.searchsorted(times, trajectory.timestamps), 1, len(times) - 1)
        before = after - 1
        nearest = np.where(trajectory.timestamps - times[before] <= times[after] - trajectory.timestamps, before, after)
        gaps = np.abs(trajectory.timestamps - times[nearest])
        near = np.flatnonzero(gaps <= MAX_GAP)
        order = near[np.lexsort((gaps[near], nearest[near]))]
        frames, first = np.unique(nearest[order], return_index=True)
        rows = order[first]
    if not len(rows):
        raise ValueError(
            f"{trajectory.name} has no pose at the time of a frame: the recording lasts from {times[0]:.9g} to "
            f"{times[-1]:.9g} s, write its times so"
        )
    return rows, frames


def _in_world(poses: Trajectory, recording: Recording, frame: int) -> Trajectory:
    """The poses in the world of the recording, by the pose of the vehicle in the first frame that they have."""
    if poses.gauge == "fixed":
        return poses
    vehicle_pose = recording.frames[frame].truth
    if vehicle_pose is None:
        if frame:
            raise ValueError(f"{poses.name} begins at frame {frame}, where no pose of the vehicle is known: give one")
        vehicle_pose = Pose(recording.start.position, recording.start.orientation)
    at_first = Alignment("start", vehicle_pose @ poses.pose(0).inverse(), 1.0, np.arange(len(poses)) == 0, up=2)
    aligned = at_first.apply(poses)
    if aligned.covariances is None or is_zero_at_start(poses):
        return aligned
    return replace(
        aligned, covariances=carried(aligned.covariances, aligned, at_first, correlation_of(poses)), drift=None
    )


def _score(log: RunLog, recording: Recording, poses: Trajectory, frames: IntArray) -> None:
    """Note what poses claim, and their errors, with what the reference states of its own errors."""
    reference, start = recording.reference, Pose(recording.start.position, recording.start.orientation)
    claimed, pose_covariances = poses.covariances, poses.pose_covariances
    assert claimed is not None
    assert pose_covariances is not None
    truth, truly_turned = log.given["true_positions"][frames], log.given["true_orientations"][frames]
    known_truth = np.isfinite(truth).all(axis=1)
    errors = np.full((len(frames), POSE_SIZE), np.nan)
    estimated = poses.positions[known_truth], poses.orientations[known_truth]
    errors[known_truth] = pose_errors(poses.tangent, *estimated, truth[known_truth], truly_turned[known_truth])
    scored = claimed
    if not reference.is_exact:
        truths = [recording.frames[k].truth for k in frames]
        doubt = np.array([np.zeros((6, 6)) if t is None else reference.covariance(start, t) for t in truths])
        scored = claimed + transformed(tangent_jacobian(poses.tangent, poses.positions, poses.orientations), doubt)
    settled = known_truth & reference.has_settled(log.given["timestamps"][frames]) & reference.counts_as_truth
    counts = settled.copy()
    counts[0] = poses.gauge == "fixed"  # else both are put together there
    log.note_series(frames, pose_covariances=pose_covariances)
    log.note_errors(frames, errors, claimed, np.where(counts[:, None, None], scored, np.nan))
    if poses.drift is not None:
        rows = np.flatnonzero(settled)
        for seconds in WINDOWS:
            _score_windows(log, seconds, recording, poses.rows(rows), frames[rows])


def _score_windows(log: RunLog, seconds: float, recording: Recording, poses: Trajectory, frames: IntArray) -> None:
    """Note the NEES of the motion over windows, of poses that say what two of them have in common."""
    ends = list(window_ends(log.given["timestamps"][frames], seconds))
    if not ends:
        return
    first, last = np.array(ends).T
    truth = Trajectory(log.given["true_positions"][frames], log.given["true_orientations"][frames])
    errors = pose_errors("right", *motions(poses, first, last), *motions(truth, first, last))
    covariances = motion_covariances(poses, first, last)
    assert covariances is not None
    for k, (i, j) in enumerate(zip(first, last, strict=True)):
        start, end = truth.pose(i), truth.pose(j)
        covariances[k] += transformed(_into_body(start, end), recording.reference.relative_covariance(start, end))
    log.note_series(frames[last], **{series_of(seconds): nees(errors, covariances)})


def _into_body(start: Pose, end: Pose) -> FloatArray:
    """J (6, 6) from errors of a motion as of `PoseBelief` to those of its right perturbation."""
    moved = start.inverse() @ end
    J: FloatArray = tangent_jacobian("right", moved.position[None], moved.orientation[None])[0]
    return J
