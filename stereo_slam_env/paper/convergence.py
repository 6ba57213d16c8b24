"""Section 4.3: how depth and its uncertainty converge for near and far landmarks, over 10 updates into a right turn.

The paper shows one near and one far landmark of one drive. Here all landmarks of two ranges of depth that are seen
throughout are followed, on many drives; every quantity is one number a drive, and intervals are over the drives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from filters.validation import BoolArray, FloatArray, IntArray
from stereo_slam_env.benchmark.reference_problem import short_turn
from stereo_slam_env.paper.claims import Claim, Finding, Interval
from stereo_slam_env.paper.depth_history import (
    DepthHistory,
    follow_depths,
    measured_disparities,
    seen_throughout,
    true_depths,
    with_one_noise,
)
from stereo_slam_env.paper.intervals import mean_interval, ratio_interval
from stereo_slam_env.paper.limits import BETTER, CONSISTENT
from stereo_slam_env.paper.parts import Arrays, Part
from stereo_slam_env.paper.settings import (
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
from stereo_slam_env.sensing.rigs import RIGS

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
    """All landmarks of all drives of one noise: L landmarks, K frames.

    Attributes
    ----------
    drive : (L,) int64
        Seed of the drive.
    true, raw : (L, K)
        True depth, and the one that the frame's own disparity says (NaN where d <= 0), m.
    filters : mapping of (str, str) to DepthHistory
        (Filter, assumed R) -> what it believed.
    """

    drive: IntArray
    true: FloatArray
    raw: FloatArray
    filters: Mapping[tuple[str, str], DepthHistory]


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
        "raw": raw_depths(measured_disparities(recording, ids)),
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
    return Depths(joined["drive"], joined["true"], joined["raw"], filters)


def raw_depths(d: FloatArray) -> FloatArray:
    """Depth by the disparity alone, m; NaN where d <= 0."""
    return CAMERA.disparity_constant / np.where(d > 0, d, np.nan)


def depth(history: DepthHistory) -> tuple[FloatArray, FloatArray]:
    """Estimated depths and their standard deviations to first order, (L, K) m; NaN where d <= 0."""
    z = raw_depths(history.d)
    return z, z / history.d * history.sigma_d


# Quantities of one filter, a number for each landmark, (L,).


def sigma(depths: Depths, history: DepthHistory) -> FloatArray:
    """Claimed standard deviation of the depth after the last update, m."""
    return depth(history)[1][:, -1]


def squared_error(depths: Depths, history: DepthHistory) -> FloatArray:
    """Of the depth after the last update, m^2."""
    return np.square(depth(history)[0][:, -1] - depths.true[:, -1])


def nees(depths: Depths, history: DepthHistory) -> FloatArray:
    """Of the inverse depth after the last update: the distribution of depth itself is not Gaussian (4.1)."""
    true_d = CAMERA.disparity_constant / depths.true[:, -1]
    return np.square((history.d[:, -1] - true_d) / history.sigma_d[:, -1])


def roughness(depths: Depths, history: DepthHistory) -> FloatArray:
    """Mean squared second difference of the estimated depth over the updates, m^2: how bent its curve is."""
    return np.mean(np.square(np.diff(depth(history)[0][:, 1:], n=2, axis=1)), axis=1)


def distance_to_raw_mean(depths: Depths, history: DepthHistory) -> FloatArray:
    """Last estimate from the mean of the raw depths, all told in one frame by the filter's own motion, m."""
    return np.abs(np.nanmean(depths.raw - history.hindsight, axis=1))


def of_drives(
    depths: Depths, label: str, quantity: Callable[[Depths, DepthHistory], FloatArray], case: tuple[str, str]
) -> FloatArray:
    """The mean of a quantity over the landmarks of that range, for each drive (S,); NaN where it has none."""
    values = quantity(depths, depths.filters[case])
    used = within(depths.true[:, 0], label) & np.isfinite(values)
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
    there = np.flatnonzero(within(depths.true[:, 0], label))
    there = there[depths.drive[there] == depths.drive[there].min()]
    return int(there[np.argmin(np.abs(depths.true[there, 0] - np.mean(RANGES[label])))])


def claims(results: Mapping[str, Arrays]) -> tuple[Claim, ...]:
    """The claims of section 4.3, judged."""
    every = {noise: gathered(results, noise) for noise in NOISES}

    def against_rival(
        quantity: Callable[[Depths, DepthHistory], FloatArray], root: bool = False
    ) -> tuple[Finding, ...]:
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
    than = f"ours over that of the rival with two bearing updates: {BETTER}"
    return (
        Claim(
            "uncertainty-converges",
            "4.3, abstract",
            "No matter the feature is either far or near, our proposed method depth and uncertainty converge faster",
            f"claimed sigma of the depth after {UPDATES} updates, {than}",
            "figure-4",
            against_rival(sigma),
        ),
        Claim(
            "depth-converges",
            "4.3",
            "... depth and uncertainty converge faster: is the depth as much better as it says?",
            f"error of the depth after {UPDATES} updates, {than}",
            "figure-5",
            against_rival(squared_error, root=True),
        ),
        Claim(
            "depth-uncertainty",
            "abstract",
            "Real depth uncertainty distribution of landmarks features can be accurately estimated",
            f"NEES of the inverse depth after {UPDATES} updates: {CONSISTENT} (claimed sigma right to 10 %)",
            "figure-4",
            consistent,
        ),
        Claim(
            "smoother",
            "4.3, abstract",
            "Our proposed method estimation is more stable, therefore the curve is smoother",
            f"RMS second difference of the estimated depth, {than}",
            "figure-5",
            against_rival(roughness, root=True),
        ),
        Claim(
            "raw-mean",
            "4.3",
            f"After {UPDATES} updates, the estimation result is also closer to the mean values of raw measurement",
            f"distance of the estimate from the mean of the raw depths, {than}",
            "figure-5",
            against_rival(distance_to_raw_mean),
        ),
    )
