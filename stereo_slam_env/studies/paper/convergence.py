"""Section 4.3: how depth and its uncertainty converge for near and far landmarks, over 10 updates into a right turn.

The paper shows one near and one far landmark of one drive. Here all landmarks of two ranges of depth that are seen
throughout are followed, on many drives; every quantity is one number a drive, and intervals are over the drives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.sensing.rigs import RIGS
from stereo_slam_env.studies.paper import sentences
from stereo_slam_env.studies.paper.claims import Claim, Finding, Interval
from stereo_slam_env.studies.paper.depth_history import (
    DepthHistory,
    follow_depths,
    measured_disparities,
    seen_throughout,
    true_depths,
    with_one_noise,
)
from stereo_slam_env.studies.paper.intervals import mean_interval, ratio_interval
from stereo_slam_env.studies.paper.limits import BETTER, CONSISTENT
from stereo_slam_env.studies.paper.parts import Arrays, Part
from stereo_slam_env.studies.paper.settings import (
    ASSUMED,
    ASSUMED_NAMES,
    COMMON_OPTIONS,
    COUPLED,
    DIAGONAL,
    DUAL,
    JOINT,
    NOISES,
    PaperSettings,
)

CAMERA = RIGS["reference"]
UPDATES = 10
"""The paper's number; there is one frame more, because the first only initialises."""
RANGES: Mapping[str, tuple[float, float]] = {"near": (15.0, 25.0), "far": (60.0, 90.0)}
"""True depth at first sight, m."""
CASES = tuple((name, R) for name in (JOINT, DUAL) for R in ASSUMED)
"""Filter and the R that it assumes."""
PAIRS: Mapping[str, tuple[str, str]] = {
    ASSUMED_NAMES[DIAGONAL]: (DIAGONAL, DIAGONAL),
    "the paper's, rival 1 px an eye": (DIAGONAL, COUPLED),
    ASSUMED_NAMES[COUPLED]: (COUPLED, COUPLED),
}
"""Comparisons: the R of the paper's filter, and that of its rival. Two eyes of 1 px each are what the full R says."""
SEEDS_A_PART = 20


@dataclass(frozen=True, eq=False)
class Depths:
    """L landmarks of some drives through K frames.

    Attributes
    ----------
    drive : (L,) int64
        What intervals are made over: the number of the drive.
    label : (L,) str
        "near" or "far".
    true, raw : (L, K)
        True depth (NaN where unknown), and the one that the frame's own disparity says (NaN where d <= 0), m.
    filters : mapping of (str, str) to DepthHistory
        (Filter, assumed R) -> what it believed.
    disparity_constant : float
        fx b, px m.
    """

    drive: IntArray
    label: NDArray[np.str_]
    true: FloatArray
    raw: FloatArray
    filters: Mapping[tuple[str, str], DepthHistory]
    disparity_constant: float = CAMERA.disparity_constant

    def depth(self, history: DepthHistory) -> tuple[FloatArray, FloatArray]:
        """Estimated depths and their standard deviations to first order, (L, K) m; NaN where d <= 0."""
        z = raw_depths(history.d, self.disparity_constant)
        return z, z / history.d * history.sigma_d


def parts(settings: PaperSettings) -> list[Part]:
    """The work of this section."""
    found = []
    for noise in NOISES:
        for first in range(0, settings.turn_seeds, SEEDS_A_PART):
            seeds = list(range(first, min(first + SEEDS_A_PART, settings.turn_seeds)))
            inputs = {"noise": noise, "seeds": seeds, "options": dict(COMMON_OPTIONS)}
            found.append(Part(f"turn-{noise}-{first:04d}", inputs, partial(compute, noise, seeds)))
    return found


def compute(noise: str, seeds: list[int]) -> Arrays:
    """All filters on the drives of some seeds."""
    by_drive = [_one_drive(noise, seed) for seed in seeds]
    return {name: np.concatenate([one[name] for one in by_drive]) for name in by_drive[0]}


def _one_drive(noise: str, seed: int) -> Arrays:
    recording = short_turn(seed, noise, frames=UPDATES + 1)
    ids = seen_throughout(recording)
    true = true_depths(recording, ids)
    wanted = np.any([within(true[:, 0], label) for label in RANGES], axis=0)
    ids, true = ids[wanted], true[wanted]
    arrays: Arrays = {
        "drive": np.full(len(ids), seed),
        "true": true,
        "raw": raw_depths(measured_disparities(recording, ids), recording.camera.disparity_constant),
    }
    for name, R in CASES:
        history = follow_depths(with_one_noise(recording, ASSUMED[R]), name, ids, COMMON_OPTIONS)
        arrays |= {f"{name}.{R}.{field}": values for field, values in vars(history).items()}
    return arrays


def gathered(results: Mapping[str, Arrays], noise: str) -> Depths:
    """What the parts of one noise found."""
    mine = [arrays for name, arrays in results.items() if name.startswith(f"turn-{noise}-")]
    joined = {name: np.concatenate([arrays[name] for arrays in mine]) for name in mine[0]}
    filters = {
        (name, R): DepthHistory(*(joined[f"{name}.{R}.{field}"] for field in ("d", "sigma_d", "hindsight")))
        for name, R in CASES
    }
    near = within(joined["true"][:, 0], "near")
    return Depths(joined["drive"], np.where(near, "near", "far"), joined["true"], joined["raw"], filters)


def raw_depths(d: FloatArray, disparity_constant: float) -> FloatArray:
    """Depth by the disparity alone, m; NaN where d <= 0."""
    return disparity_constant / np.where(d > 0, d, np.nan)


Quantity = Callable[[Depths, DepthHistory], FloatArray]
"""Of what a filter believed, a number for each landmark, (L,)."""


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
    """Last estimate from the mean of the raw depths, all told in one frame by the filter's own motion, m."""
    return np.asarray(np.abs(np.nanmean(depths.raw - history.hindsight, axis=1)))


def of_drives(depths: Depths, label: str, quantity: Quantity, case: tuple[str, str]) -> FloatArray:
    """The mean of a quantity over the landmarks of that range, for each drive (S,); NaN where it has none."""
    values = quantity(depths, depths.filters[case])
    used = (depths.label == label) & np.isfinite(values)
    drives, place = np.unique(depths.drive, return_inverse=True)
    with np.errstate(invalid="ignore"):
        mean: FloatArray = np.bincount(place[used], values[used], len(drives)) / np.bincount(
            place[used], minlength=len(drives)
        )
    return mean


def within(true_depth: FloatArray, label: str) -> BoolArray:
    """Which true depths at first sight (L,) are of that range."""
    low, high = RANGES[label]
    return (low <= true_depth) & (true_depth <= high)


def example(depths: Depths, label: str) -> int:
    """The landmark to show: on the first drive that has one of that range, the one nearest to its middle."""
    there = np.flatnonzero(depths.label == label)
    there = there[depths.drive[there] == depths.drive[there].min()]
    return int(there[np.argmin(np.abs(depths.true[there, 0] - np.mean(RANGES[label])))])


def claims(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims of section 4.3, judged."""
    every = {noise: gathered(results, noise) for noise in NOISES}

    def against_rival(quantity: Quantity, root: bool = False) -> tuple[Finding, ...]:
        found = []
        for noise, depths in every.items():
            for R, (ours, theirs) in PAIRS.items():
                for label in RANGES:
                    ratio = ratio_interval(
                        of_drives(depths, label, quantity, (JOINT, ours)),
                        of_drives(depths, label, quantity, (DUAL, theirs)),
                    )
                    if root:
                        ratio = Interval(*np.sqrt([ratio.value, ratio.low, ratio.high]).tolist())
                    found.append(Finding({"noise": NOISES[noise], "R": R, "landmark": label}, ratio, BETTER))
        return tuple(found)

    consistent = tuple(
        Finding(
            {"noise": NOISES[noise], "R": ASSUMED_NAMES[R], "landmark": label},
            mean_interval(of_drives(depths, label, nees, (JOINT, R))),
            CONSISTENT,
        )
        for noise, depths in every.items()
        for R in ASSUMED
        for label in RANGES
    )
    return (
        Claim(sentences.UNCERTAINTY_CONVERGES, against_rival(sigma)),
        Claim(sentences.DEPTH_CONVERGES, against_rival(squared_error, root=True)),
        Claim(sentences.DEPTH_UNCERTAINTY, consistent),
        Claim(sentences.SMOOTHER, against_rival(roughness, root=True)),
        Claim(sentences.RAW_MEAN, against_rival(distance_to_raw_mean)),
    )
