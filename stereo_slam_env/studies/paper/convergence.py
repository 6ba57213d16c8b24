"""Section 4.3: how depth and its uncertainty converge for near and far landmarks, over 10 updates into a right turn.

The paper shows one near and one far landmark of one drive. Here all landmarks of two ranges of depth that are seen
throughout are followed, on many drives; every quantity is one number a drive, and intervals are over the drives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from filters import Pose, StereoNoise
from stereo_slam_env import Recording, run
from stereo_slam_env.benchmark import short_turn
from stereo_slam_env.sensing import RIGS
from stereo_slam_env.studies.paper.claims import (
    ASSUMED,
    ASSUMED_NAMES,
    COMMON_OPTIONS,
    COUPLED,
    DIAGONAL,
    DUAL,
    JOINT,
    NOISES,
    Arrays,
    Claim,
    FloatArray,
    Interval,
    Measured,
    claim,
    mean_interval,
    ratio_interval,
)

IntArray = NDArray[np.int64]
UPDATES = 10
"""The paper's number; there is one frame more, because the first only initialises."""
RANGES: Mapping[str, tuple[float, float]] = {"near": (15.0, 25.0), "far": (60.0, 90.0)}
"""True depth at first sight, m."""
CASES = tuple((name, R) for name in (JOINT, DUAL) for R in ASSUMED)
"""Filter and the R that it assumes."""
PAIRS: Mapping[str, tuple[str, str]] = {
    ASSUMED_NAMES[DIAGONAL]: (DIAGONAL, DIAGONAL),
    "the paper's, competitor, 1 px an image": (DIAGONAL, COUPLED),
    ASSUMED_NAMES[COUPLED]: (COUPLED, COUPLED),
}
"""Comparisons: the R of the paper's filter, and that of its competitor. Two images of 1 px each are what the full R
says."""
DRIVES_AT_ONCE = 20


@dataclass(frozen=True, eq=False)
class DepthHistory:
    """L landmarks through K frames, as a filter believes."""

    d: FloatArray  # (L, K): estimated disparity, px: inverse depth, up to a constant
    sigma_d: FloatArray  # (L, K): its claimed standard deviation, px
    # (L, K): depth that the last estimate of the landmark has in each frame, by the filter's own motion, m
    hindsight: FloatArray


@dataclass(frozen=True, eq=False)
class Depths:
    """L landmarks of some drives through K frames."""

    drive: IntArray  # (L,): what intervals are made over: the number of the drive
    label: NDArray[np.str_]  # (L,): "near" or "far"
    true: FloatArray  # (L, K): true depth, m; NaN where unknown
    raw: FloatArray  # (L, K): the one that the frame's own disparity says, m; NaN where d <= 0
    filters: Mapping[tuple[str, str], DepthHistory]  # (filter, assumed R) -> what it believed
    disparity_constant: float = RIGS["reference"].disparity_constant  # fx b, px m

    def depth(self, history: DepthHistory) -> tuple[FloatArray, FloatArray]:
        """Estimated depths and their standard deviations to first order, (L, K) m; NaN where d <= 0."""
        z = raw_depths(history.d, self.disparity_constant)
        return z, z / history.d * history.sigma_d


def experiments(drives: int) -> dict[str, partial[Arrays]]:
    """The short turns, for each noise."""
    return {
        f"turn-{noise}-{first:04d}": partial(turns, noise, first, min(first + DRIVES_AT_ONCE, drives))
        for noise in NOISES
        for first in range(0, drives, DRIVES_AT_ONCE)
    }


def turns(noise: str, first: int, end: int) -> Arrays:
    """All filters on the drives of the seeds from `first` to before `end`."""
    by_drive = [_turn(noise, seed) for seed in range(first, end)]
    return {name: np.concatenate([one[name] for one in by_drive]) for name in by_drive[0]}


def _turn(noise: str, seed: int) -> Arrays:
    recording = short_turn(seed, noise, frames=UPDATES + 1)
    ids = seen_throughout(recording)
    true = true_depths(recording, ids)
    wanted = np.any([within(true[:, 0], label) for label in RANGES], axis=0)
    ids, true = ids[wanted], true[wanted]
    raw = raw_depths(measured_disparities(recording, ids), recording.camera.disparity_constant)
    followed = follow_all(recording, ASSUMED, ids, COMMON_OPTIONS)
    return {"drive": np.full(len(ids), seed), "true": true, "raw": raw, **followed}


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


def follow_all(
    recording: Recording, assumed: Mapping[str, StereoNoise], ids: IntArray, options: Mapping[str, Any]
) -> Arrays:
    """Histories of both filters with each R, by "filter.R.field"."""
    return {
        f"{name}.{R}.{field}": values
        for name in (JOINT, DUAL)
        for R, noise in assumed.items()
        for field, values in vars(follow_depths(recording, name, noise, ids, options)).items()
    }


def follow_depths(
    recording: Recording, filter_name: str, noise: StereoNoise, ids: IntArray, options: Mapping[str, Any]
) -> DepthHistory:
    """Run a filter and note the depths of the landmarks `ids` (L,), ascending; NaN where it does not have one."""
    history = DepthHistory(*(np.full((len(ids), len(recording)), np.nan) for _ in range(3)))
    poses = []
    for moment in run(filter_name, recording, noise=noise, use_odometry=False, **options):
        forecast = moment.slam.forecast()
        _, mine, theirs = np.intersect1d(ids, forecast.ids, return_indices=True)
        variance = (forecast.S - noise.R)[theirs, 2, 2]
        history.d[mine, moment.number] = forecast.uvd[theirs, 2]
        history.sigma_d[mine, moment.number] = np.sqrt(np.maximum(variance, 0.0))
        poses.append(Pose(moment.pose.position, moment.pose.orientation))
    last = moment.slam.landmarks
    _, mine, theirs = np.intersect1d(ids, last.ids, return_indices=True)
    for k, pose in enumerate(poses):
        history.hindsight[mine, k] = pose.to_camera(last.positions[theirs])[:, 2]
    return history


def histories(arrays: Arrays, cases: Sequence[tuple[str, str]]) -> dict[tuple[str, str], DepthHistory]:
    """Results of `follow_all` by filter and R."""
    fields = ("d", "sigma_d", "hindsight")
    return {(name, R): DepthHistory(*(arrays[f"{name}.{R}.{field}"] for field in fields)) for name, R in cases}


def gathered(results: Mapping[str, Arrays], noise: str) -> Depths:
    """The turns of one noise."""
    mine = [arrays for name, arrays in results.items() if name.startswith(f"turn-{noise}-")]
    joined = {name: np.concatenate([arrays[name] for arrays in mine]) for name in mine[0]}
    near = within(joined["true"][:, 0], "near")
    label = np.where(near, "near", "far")
    return Depths(joined["drive"], label, joined["true"], joined["raw"], histories(joined, CASES))


def raw_depths(d: FloatArray, disparity_constant: float) -> FloatArray:
    """Depth by the disparity alone, m; NaN where d <= 0."""
    return disparity_constant / np.where(d > 0, d, np.nan)


def within(true_depth: FloatArray, label: str) -> NDArray[np.bool_]:
    """Which true depths at first sight (L,) are of that range."""
    low, high = RANGES[label]
    return (low <= true_depth) & (true_depth <= high)


Quantity = Callable[[Depths, DepthHistory], FloatArray]
"""A number for each landmark, (L,), of what a filter believed."""


def sigma(depths: Depths, history: DepthHistory) -> FloatArray:
    """Claimed standard deviation of the depth after the last update, m."""
    return depths.depth(history)[1][:, -1]


def squared_error(depths: Depths, history: DepthHistory) -> FloatArray:
    """Of the depth after the last update, m^2."""
    squared: FloatArray = np.square(depths.depth(history)[0][:, -1] - depths.true[:, -1])
    return squared


def nees(depths: Depths, history: DepthHistory) -> FloatArray:
    """Of the inverse depth after the last update: the distribution of depth itself is not Gaussian (4.1)."""
    true_d = depths.disparity_constant / depths.true[:, -1]
    squared: FloatArray = np.square((history.d[:, -1] - true_d) / history.sigma_d[:, -1])
    return squared


def roughness(depths: Depths, history: DepthHistory) -> FloatArray:
    """Mean squared second difference of the estimated depth over the updates, m^2: how bent its curve is."""
    bends: FloatArray = np.square(np.diff(depths.depth(history)[0][:, 1:], n=2, axis=1))
    return np.asarray(bends.mean(axis=1))


def distance_to_raw_mean(depths: Depths, history: DepthHistory) -> FloatArray:
    """Last estimate from the mean of the raw depths, all in one frame by the filter's own motion, m."""
    return np.asarray(np.abs(np.nanmean(depths.raw - history.hindsight, axis=1)))


def of_drives(depths: Depths, label: str, quantity: Quantity, case: tuple[str, str]) -> FloatArray:
    """The mean of a quantity over the landmarks of that range, for each drive (S,); NaN where it has none."""
    values = quantity(depths, depths.filters[case])
    used = (depths.label == label) & np.isfinite(values)
    drives, place = np.unique(depths.drive, return_inverse=True)
    with np.errstate(invalid="ignore"):
        total = np.bincount(place[used], values[used], len(drives))
        mean: FloatArray = total / np.bincount(place[used], minlength=len(drives))
    return mean


def example(depths: Depths, label: str) -> int:
    """The landmark to show: on the first drive that has one of that range, the one nearest to its middle."""
    there = np.flatnonzero(depths.label == label)
    there = there[depths.drive[there] == depths.drive[there].min()]
    return int(there[np.argmin(np.abs(depths.true[there, 0] - np.mean(RANGES[label])))])


def judge(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims of section 4.3."""
    every = {noise: gathered(results, noise) for noise in NOISES}

    def against_competitor(quantity: Quantity, root: bool = False) -> Measured:
        for noise, depths in every.items():
            for R, (ours, theirs) in PAIRS.items():
                for label in RANGES:
                    ratio = ratio_interval(
                        of_drives(depths, label, quantity, (JOINT, ours)),
                        of_drives(depths, label, quantity, (DUAL, theirs)),
                    )
                    if root:
                        ratio = Interval(*np.sqrt([ratio.value, ratio.low, ratio.high]).tolist())
                    yield {"noise": NOISES[noise], "R": R, "landmark": label}, ratio

    consistent = [
        (
            {"noise": NOISES[noise], "R": ASSUMED_NAMES[R], "landmark": label},
            mean_interval(of_drives(depths, label, nees, (JOINT, R))),
        )
        for noise, depths in every.items()
        for R in ASSUMED
        for label in RANGES
    ]
    return (
        claim("uncertainty-converges", against_competitor(sigma)),
        claim("depth-converges", against_competitor(squared_error, root=True)),
        claim("depth-uncertainty", consistent),
        claim("smoother", against_competitor(roughness, root=True)),
        claim("raw-mean", against_competitor(distance_to_raw_mean)),
    )
