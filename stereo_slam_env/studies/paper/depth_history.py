"""What a filter believes of the depth of some landmarks, frame by frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from filters import StereoNoise, make_filter
from filters.validation import FloatArray, IntArray
from stereo_slam_env.evaluation.map_scoring import view_map
from stereo_slam_env.loop import run
from stereo_slam_env.recording.recording import Pose, Recording


@dataclass(frozen=True, eq=False)
class DepthHistory:
    """L landmarks through K frames.

    Attributes
    ----------
    d, sigma_d : (L, K)
        Estimated disparity and its claimed standard deviation, px: inverse depth, up to a constant.
    hindsight : (L, K)
        Depth that the last estimate of the landmark has in each frame, by the filter's own motion, m.
    """

    d: FloatArray
    sigma_d: FloatArray
    hindsight: FloatArray


def seen_throughout(recording: Recording) -> IntArray:
    """Ids of the landmarks that are observed in every frame, ascending; (L,)."""
    return reduce(np.intersect1d, [frame.observation.ids for frame in recording.frames])


def measured_disparities(recording: Recording, ids: IntArray) -> FloatArray:
    """Raw disparities of those landmarks, (L, K) px."""
    columns = []
    for frame in recording.frames:
        order = np.argsort(frame.observation.ids)
        columns.append(frame.observation.uvd[order[np.searchsorted(frame.observation.ids, ids, sorter=order)], 2])
    return np.stack(columns, axis=1)


def true_depths(recording: Recording, ids: IntArray) -> FloatArray:
    """True depths of those landmarks, (L, K) m; the recording must have the truth of poses and landmarks."""
    truth = recording.landmarks
    assert truth is not None
    points_w = truth.positions[np.searchsorted(truth.ids, ids)]
    poses = [frame.truth for frame in recording.frames]
    return np.stack([pose.to_camera(points_w)[:, 2] for pose in poses if pose is not None], axis=1)


def with_one_noise(recording: Recording, noise: StereoNoise | None) -> Recording:
    """The recording with that R for every measurement; None: as the recording says."""
    if noise is None:
        return recording
    frames = tuple(
        dataclasses.replace(frame, observation=dataclasses.replace(frame.observation, R=None))
        for frame in recording.frames
    )
    return dataclasses.replace(recording, frames=frames, noise=noise)


def follow_depths(recording: Recording, filter_name: str, ids: IntArray, options: Mapping[str, Any]) -> DepthHistory:
    """Run a filter over the recording and note the depths of landmarks that it has in its map throughout.

    Parameters
    ----------
    recording : Recording
        The stream.
    filter_name, options : str, mapping
        The filter.
    ids : (L,) int64
        Landmarks, ascending; NaN where the filter does not have one.
    """
    slam = make_filter(filter_name, camera=recording.camera, noise=recording.noise, **options)
    shape = len(ids), len(recording)
    history = DepthHistory(*(np.full(shape, np.nan) for _ in range(3)))
    poses = []
    for moment in run(slam, recording, use_odometry=False):
        view = view_map(slam, None, None)
        _, mine, theirs = np.intersect1d(ids, view.ids, return_indices=True)
        history.d[mine, moment.number] = view.uvd[theirs, 2]
        history.sigma_d[mine, moment.number] = np.sqrt(np.maximum(view.covariance[theirs, 2, 2], 0.0))
        poses.append(Pose(moment.pose.position, moment.pose.orientation))
    belief = slam.landmarks
    _, mine, theirs = np.intersect1d(ids, belief.ids, return_indices=True)
    for k, pose in enumerate(poses):
        history.hindsight[mine, k] = pose.to_camera(belief.positions[theirs])[:, 2]
    return history
