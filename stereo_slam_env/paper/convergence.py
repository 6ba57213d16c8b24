"""Section 4.3: how depth and its uncertainty converge for near and far landmarks, over 10 updates into a right turn.

The paper shows one near and one far landmark of one drive. Here all landmarks of two ranges of depth that are seen
throughout are followed, on many drives; every quantity is one number a drive, and intervals are over the drives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from filters import Pose, Start, StereoNoise
from stereo_slam_env import Recording, RenderedDrive, run
from stereo_slam_env.frontend import record_tracks, with_moving_start
from stereo_slam_env.paper import drives
from stereo_slam_env.paper.drives import ROUTES, TURN
from stereo_slam_env.paper.paper_claims import (
    ASSUMED_NAMES,
    DUAL,
    FILTER_NAMES,
    FILTERS,
    JOINT,
    PAZ,
    REAL,
    SIMULATION,
    Arrays,
    Claim,
    FloatArray,
    Interval,
    Measured,
    mean_interval,
    ratio_interval,
)
from stereo_slam_env.rendering import tracks_picture

IntArray = NDArray[np.int64]
UPDATES = 10
"""The paper's number; there is one frame more, because the first only initialises."""
RANGES: Mapping[str, tuple[float, float]] = {"near": (15.0, 25.0), "far": (60.0, 90.0)}
"""Depth at first sight of simulated landmarks, m: narrow, so that they have a depth in common."""
WIDE_RANGES: Mapping[str, tuple[float, float]] = {"near": (5.0, 30.0), "far": (45.0, 300.0)}
"""The same of tracks in images, m, of which there are few."""
LINEAR = 0.1
"""Largest index of linearity with which a landmark is converted to XYZ (Civera et al., reference 12 of the paper)."""
MEDIAN_NEES = float(chi2.ppf(0.5, 1))
"""Median of the NEES of a consistent inverse depth, whose mean is 1."""
FILTERS_HERE = (JOINT, DUAL, PAZ)
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
    """L landmarks of some drives of one setting through K frames."""

    setting: drives.Setting
    drive: IntArray  # (L,): number of the drive, over which intervals are made
    label: NDArray[np.str_]  # (L,): "near", "far" or ""
    true: FloatArray  # (L, K): true depth, m; NaN where unknown
    raw: FloatArray  # (L, K): depth by the disparity of the frame alone, m; NaN where d <= 0
    filters: Mapping[tuple[str, str], DepthHistory]  # (filter, assumed R) -> what it believed
    disparity_constant: float  # fx b, px m

    def depth(self, history: DepthHistory) -> tuple[FloatArray, FloatArray]:
        """Estimated depths and their standard deviations to first order, (L, K) m; NaN where d <= 0."""
        z = raw_depths(history.d, self.disparity_constant)
        return z, z / history.d * history.sigma_d


def experiments(seeds: Mapping[str, int], real: Mapping[str, drives.RealDrive]) -> dict[str, partial[Arrays]]:
    """The short turns, and what real drives have of so many frames."""
    return dict(drives.experiments(drives.TURN, turns, seeds, UPDATES + 1, real, DRIVES_AT_ONCE))


def turns(key: str, *about: Any) -> Arrays:
    """All filters on some turns, or the windows of a real drive that is long enough; see `drives.recordings_of`."""
    setting = drives.setting(key)
    followed: list[Arrays] = []
    for number, recording in drives.recordings_of(drives.TURN, key, *about):
        if setting.place == REAL:
            followed += [_turn(setting, window, k) for k, window in enumerate(_windows(recording))]
        else:
            followed.append(_turn(setting, recording, number))
    return {name: np.concatenate([one[name] for one in followed]) for name in followed[0]} if followed else {}


def _windows(recording: Recording) -> list[Recording]:
    """Pieces of `UPDATES` + 1 frames, in which a filter starts anew with the velocity that the tracks show."""
    length = UPDATES + 1
    pieces = [recording[first : first + length] for first in range(0, len(recording) - length + 1, length)]
    return [with_moving_start(replace(piece, start=Start())) for piece in pieces]


def _turn(setting: drives.Setting, recording: Recording, number: int) -> Arrays:
    ids = seen_throughout(recording)
    constant = recording.camera.disparity_constant
    raw = raw_depths(measurements(recording, ids)[:, :, 2], constant)
    true = np.full_like(raw, np.nan) if recording.landmarks is None else true_depths(recording, ids)
    label = labels(true[:, 0] if recording.landmarks else np.nanmedian(raw, axis=1), setting.place)
    used = label != ""
    ids, raw, true = ids[used], raw[used], true[used]
    arrays: Arrays = {
        "drive": np.full(len(ids), number),
        "label": label[used],
        "true": true,
        "raw": raw,
        "disparity_constant": np.full(len(ids), constant),
    }
    for name in FILTERS_HERE:
        for R in setting.levels:
            observed, noise = setting.seen(recording, R)
            history = follow_depths(observed, name, noise or recording.noise, ids, setting.options)
            arrays |= {f"{name}.{R}.{field}": values for field, values in vars(history).items()}
    return arrays


def labels(depth: FloatArray, place: str) -> NDArray[np.str_]:
    """Range of each depth at first sight (L,), m: "near", "far" or ""."""
    ranges = RANGES if place == SIMULATION else WIDE_RANGES
    return np.select([(low <= depth) & (depth <= high) for low, high in ranges.values()], list(ranges), "")


def seen_throughout(recording: Recording) -> IntArray:
    """Ids of the landmarks that are observed in every frame, ascending; (L,)."""
    return reduce(np.intersect1d, [frame.observation.ids for frame in recording.frames])


def measurements(recording: Recording, ids: IntArray) -> FloatArray:
    """Measured (u, v, d) of those landmarks, which every frame has, (L, K, 3) px."""
    by_frame = []
    for frame in recording.frames:
        order = np.argsort(frame.observation.ids)
        by_frame.append(frame.observation.uvd[order[np.searchsorted(frame.observation.ids, ids, sorter=order)]])
    return np.stack(by_frame, axis=1)


def true_depths(recording: Recording, ids: IntArray) -> FloatArray:
    """True depths of those landmarks, (L, K) m; the recording must have the truth of poses and landmarks."""
    truth = recording.landmarks
    assert truth is not None
    points_w = truth.positions[np.searchsorted(truth.ids, ids)]
    poses = [frame.truth for frame in recording.frames]
    return np.stack([pose.to_camera(points_w)[:, 2] for pose in poses if pose is not None], axis=1)


def follow_depths(
    recording: Recording, name: str, noise: StereoNoise, ids: IntArray, options: Mapping[str, Any]
) -> DepthHistory:
    """Run a filter of `FILTERS` and note the depths of landmarks `ids` (L,), ascending; NaN where it has none."""
    history = DepthHistory(*(np.full((len(ids), len(recording)), np.nan) for _ in range(3)))
    poses = []
    filter_name, filter_options = FILTERS[name]
    for moment in run(filter_name, recording, noise=noise, use_odometry=False, **options, **filter_options):
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


def gathered(setting: drives.Setting, results: Sequence[Arrays]) -> Depths:
    """The turns of one setting."""
    joined = {name: np.concatenate([arrays[name] for arrays in results]) for name in results[0]}
    constant = float(joined["disparity_constant"][0]) if len(joined["drive"]) else np.nan
    fields = ("d", "sigma_d", "hindsight")
    filters = {
        (name, R): DepthHistory(*(joined[f"{name}.{R}.{field}"] for field in fields))
        for name in FILTERS_HERE
        for R in setting.levels
    }
    return Depths(setting, joined["drive"], joined["label"], joined["true"], joined["raw"], filters, constant)


def settings(results: Mapping[str, Arrays]) -> list[Depths]:
    """The turns that there are results of, simulated ones first."""
    by_key = drives.settings_of(results, drives.TURN)
    return [gathered(drives.setting(key), arrays) for key, arrays in by_key.items()]


def raw_depths(d: FloatArray, disparity_constant: float) -> FloatArray:
    """Depth by the disparity alone, m; NaN where d <= 0."""
    return disparity_constant / np.where(d > 0, d, np.nan)


Quantity = Callable[[Depths, DepthHistory], FloatArray]
"""A number for each landmark, (L,), of what a filter believed."""


def sigma(depths: Depths, history: DepthHistory) -> FloatArray:
    """Claimed standard deviation of the depth after the last update, m."""
    return depths.depth(history)[1][:, -1]


def squared_error(depths: Depths, history: DepthHistory) -> FloatArray:
    """Squared error of the depth after the last update, m^2."""
    squared: FloatArray = np.square(depths.depth(history)[0][:, -1] - depths.true[:, -1])
    return squared


def nees(depths: Depths, history: DepthHistory) -> FloatArray:
    """NEES of the inverse depth after the last update: depth itself is not Gaussian (4.1)."""
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


def updates_until_linear(depths: Depths, history: DepthHistory) -> FloatArray:
    """Updates until 4 sigma_d / d, Civera's index at small parallax, is below `LINEAR`; `UPDATES` + 1: not yet."""
    with np.errstate(divide="ignore", invalid="ignore"):
        linear = (4.0 * history.sigma_d / history.d < LINEAR) & (history.d > 0.0)
    count = linear.shape[1]
    updates: FloatArray = np.where(linear.any(axis=1), linear.argmax(axis=1), count).astype(np.float64)
    return updates


def of_drives(depths: Depths, label: str, quantity: Quantity, case: tuple[str, str]) -> FloatArray:
    """The mean of a quantity over the landmarks of that range, for each drive (S,); NaN where it has none.

    In images it is the median: a corner at an edge has no one depth. Where all landmarks are of one drive, they stand
    for themselves.
    """
    values = quantity(depths, depths.filters[case])
    used = (depths.label == label) & np.isfinite(values)
    drive = depths.drive
    if len(np.unique(drive)) == 1 and len(drive) > 1:
        drive = np.arange(len(drive))
    numbers, place = np.unique(drive, return_inverse=True)
    if depths.setting.place != SIMULATION:
        by_drive = [values[used & (place == number)] for number in range(len(numbers))]
        return np.array([np.median(few) if len(few) else np.nan for few in by_drive])
    with np.errstate(invalid="ignore"):
        total = np.bincount(place[used], values[used], len(numbers))
        mean: FloatArray = total / np.bincount(place[used], minlength=len(numbers))
    return mean


def example(depths: Depths, label: str) -> int:
    """The landmark to show: on the first drive that has one of that range, the one nearest to its middle."""
    labelled = np.flatnonzero(depths.label == label)
    labelled = labelled[depths.drive[labelled] == depths.drive[labelled].min()]
    return int(labelled[np.argmin(np.abs(np.nanmedian(depths.raw[labelled], axis=1) - np.mean(RANGES[label])))])


def judge(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims of section 4.3."""

    def ratios(
        quantity: Quantity, root: bool = False, labels: Sequence[str] = tuple(RANGES)
    ) -> Callable[[Depths], Measured]:
        def measured(depths: Depths) -> Measured:
            for words, (ours, theirs) in depths.setting.pairs.items():
                for rival in (DUAL, PAZ):
                    for label in labels:
                        both = ((JOINT, ours), (rival, theirs))
                        ratio = ratio_interval(*(of_drives(depths, label, quantity, case) for case in both))
                        if root:
                            ratio = Interval(*np.sqrt([ratio.value, ratio.low, ratio.high]).tolist())
                        about = {"R": words, "competitor": FILTER_NAMES[rival], "landmark": label}
                        yield about, ratio

        return measured

    def consistent(depths: Depths) -> Measured:
        for R in depths.setting.levels:
            for label in RANGES:
                about = {"R": ASSUMED_NAMES[R], "landmark": label}
                values = of_drives(depths, label, nees, (JOINT, R))
                simulated = depths.setting.place == SIMULATION
                # In images: the ratio of variances that is typical of landmarks, and of turns.
                typical = ratio_interval(values, np.full_like(values, MEDIAN_NEES))
                yield about, mean_interval(values) if simulated else typical

    quantities = {
        "uncertainty-converges": ratios(sigma),
        "depth-converges": ratios(squared_error, root=True),
        "depth-uncertainty": consistent,
        "sooner-linear": ratios(updates_until_linear, labels=("near",)),
        "smoother": ratios(roughness, root=True),
        "raw-mean": ratios(distance_to_raw_mean),
        "far-not-closer": ratios(distance_to_raw_mean, labels=("far",)),
    }
    return drives.judged(quantities, settings(results))


NEAR, BETWEEN, FAR = (230, 140, 0), (150, 150, 150), (30, 110, 200)  # RGB: orange, grey, blue
FEATURES = "features"


def feature_experiments() -> dict[str, partial[Arrays]]:
    """The turn of seed 0."""
    return {FEATURES: partial(tracked_features, 0)}


def tracked_features(seed: int) -> Arrays:
    """Left images of the first and the last frame, and the pixels and depths of what is seen throughout."""
    drive = RenderedDrive({"route": ROUTES[TURN], "renderer": "gl"}, seed, UPDATES + 1)
    recording = record_tracks(drive, drive.front_end)
    images = [pair.left for number, pair in enumerate(drive.pairs()) if number in (0, UPDATES)]
    uvd = measurements(recording, seen_throughout(recording))
    depths = recording.camera.disparity_constant / np.median(uvd[:, :, 2], axis=1)
    return {"images": np.array(images), "pixels": uvd[:, :, :2].transpose(1, 0, 2), "depths": depths}


def feature_picture(arrays: Arrays) -> bytes:
    """Both frames, one above the other, as a PNG file, with a ring at each feature and its way since the first."""
    (_, near), (far, _) = WIDE_RANGES.values()
    colours = [NEAR if depth < near else FAR if depth > far else BETWEEN for depth in arrays["depths"]]
    words = "first frame: features are initialised", f"after {UPDATES} updates"
    ways = arrays["pixels"][:1], arrays["pixels"]
    return tracks_picture(arrays["images"], ways, colours, words)
