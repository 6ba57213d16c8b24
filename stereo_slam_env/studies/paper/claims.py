"""The claims of the paper: conditions, limits, the rule that decides, and every checkable sentence.

Every claim is made measurable: a quantity, and the range in which it must lie if the claim is true. A quantity is
measured under several conditions, each time with a 95 % confidence interval.

- One condition (`Finding`): the claim *holds* if the whole interval lies in the range, *does not hold* if the whole
  interval lies outside, and is *not shown* where the interval crosses a limit of the range, or there is no interval.
- The claim (`Claim`): *holds* if it holds under every condition; *holds only if ...* under some of them, which are
  then named; *does not hold* if it holds under none and is refuted under at least one; else *not shown*.

Nothing else decides. Limits were chosen before these runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from filters import StereoNoise
from stereo_slam_env import benchmark
from stereo_slam_env.benchmark import CONFIDENCE, MIN_PAIRS

FloatArray = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]
"""Result of an experiment."""

# Conditions.

UVD, PIXELS = "uvd", "pixels"
"""Noise of the measurements: u, v, d independent (the paper's assumption); u_l, v_l, u_r, v_r independent."""
NOISES: Mapping[str, str] = {UVD: "as the paper assumes", PIXELS: "independent pixels"}

DIAGONAL, COUPLED = "diagonal", "full"
ASSUMED: Mapping[str, StereoNoise] = {
    DIAGONAL: StereoNoise.diagonal(1.0, 1.0, 1.0),
    COUPLED: StereoNoise.independent_pixels(1.0),
}
"""R that a filter assumes, px^2: the paper's ("in our experiments 1 pixel" each), and that of independent pixels."""
RIGHT = {UVD: DIAGONAL, PIXELS: COUPLED}
"""The R that describes a noise."""
ASSUMED_NAMES: Mapping[str, str] = {DIAGONAL: "the paper's", COUPLED: "of independent pixels"}

JOINT, DUAL, EUCLIDEAN = "inverse-depth", "dual-bearing", "euclidean"
"""The paper's filter, its competitor with one bearing update an image, and the classic with points XYZ."""
COMPILED = find_spec("numba") is not None
COMMON_OPTIONS: Mapping[str, Any] = {"gate": None, "compiled": COMPILED}
"""Of every filter here: nothing is gated, so nothing is hidden; compiled, where it can be, is the same but faster."""


# The rule.


class Verdict(Enum):
    """What may be said."""

    HOLDS = "holds"
    HOLDS_ONLY_IF = "holds only if"
    DOES_NOT_HOLD = "does not hold"
    NOT_SHOWN = "not shown"


@dataclass(frozen=True)
class Interval:
    """A measured value and its 95 % confidence interval; NaN limits: too little data for one."""

    value: float
    low: float
    high: float

    @property
    def known(self) -> bool:
        """Whether value and limits are numbers; a limit may be infinite."""
        return not any(map(math.isnan, (self.value, self.low, self.high)))


@dataclass(frozen=True)
class Range:
    """Where a quantity must lie: from `low` to `high`, both included."""

    low: float = -math.inf
    high: float = math.inf

    def __str__(self) -> str:
        if self.low == self.high:
            return f"{self.low:g}"
        if self.low == -math.inf:
            return f"at most {self.high:.4g}"
        if self.high == math.inf:
            return f"at least {self.low:.4g}"
        return f"{self.low:.4g} to {self.high:.4g}"


def decide(measured: Interval, asked: Range) -> Verdict:
    """The rule for one condition: what was measured, and the range in which it must lie if the claim is true."""
    if not measured.known:
        return Verdict.NOT_SHOWN
    if asked.low <= measured.low and measured.high <= asked.high:
        return Verdict.HOLDS
    if measured.high < asked.low or measured.low > asked.high:
        return Verdict.DOES_NOT_HOLD
    return Verdict.NOT_SHOWN


@dataclass(frozen=True)
class Finding:
    """A claim under one condition.

    Attributes
    ----------
    condition : mapping of str to str
        Factor -> level, e.g. {"noise": "pixels independent", "R": "full"}; the same factors in all of a claim.
    measured : Interval
        The quantity.
    asked : Range
        Where it must lie if the claim is true.
    """

    condition: Mapping[str, str]
    measured: Interval
    asked: Range

    @property
    def verdict(self) -> Verdict:
        """By `decide`."""
        return decide(self.measured, self.asked)


@dataclass(frozen=True)
class Sentence:
    """Something the paper says that can be checked.

    Attributes
    ----------
    key, section, claim : str
        A short, unique name; the section of the paper; what it says there.
    statement : str
        What is measured, and when that counts as true.
    evidence : str
        Name of the figure that it is shown with.
    """

    key: str
    section: str
    claim: str
    statement: str
    evidence: str


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, and what was found about it: one finding a condition."""

    sentence: Sentence
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> Verdict:
        """By the rule of this module."""
        found = {finding.verdict for finding in self.findings}
        if found == {Verdict.HOLDS}:
            return Verdict.HOLDS
        if Verdict.HOLDS in found:
            return Verdict.HOLDS_ONLY_IF
        return Verdict.DOES_NOT_HOLD if Verdict.DOES_NOT_HOLD in found else Verdict.NOT_SHOWN

    @property
    def says(self) -> str:
        """The verdict in words: under which conditions it holds, and how many of them show nothing."""
        words = str(self.verdict.value)
        every = [finding.condition for finding in self.findings]
        if self.verdict is Verdict.HOLDS_ONLY_IF:
            holding = [finding.condition for finding in self.findings if finding.verdict is Verdict.HOLDS]
            words = f"{words} {describe(holding, every)}"
        open_ = sum(finding.verdict is Verdict.NOT_SHOWN for finding in self.findings)
        if 0 < open_ < len(every):
            words = f"{words} (not shown under {open_} of {len(every)} conditions)"
        return words


def describe(chosen: Sequence[Mapping[str, str]], every: Sequence[Mapping[str, str]]) -> str:
    """Name the `chosen` conditions among all (factor -> level, each combination once), exactly and in few words.

    Conditions that are all those with certain levels of some factors are named by these levels; others are split by
    the levels of a factor until they are.
    """
    return "; or ".join(_terms(list(chosen), every))


def _terms(chosen: list[Mapping[str, str]], every: Sequence[Mapping[str, str]]) -> list[str]:
    levels = {factor: list(dict.fromkeys(c[factor] for c in chosen)) for factor in every[0]}
    if sum(all(c[factor] in named for factor, named in levels.items()) for c in every) == len(chosen):
        telling = {
            factor: " or ".join(named)
            for factor, named in levels.items()
            if len(named) < len({condition[factor] for condition in every})
        }
        return [", ".join(f"{factor}: {named}" for factor, named in telling.items())]
    splits = (
        [term for level in named for term in _terms([c for c in chosen if c[factor] == level], every)]
        for factor, named in levels.items()
        if len(named) > 1
    )
    fewest: list[str] = min(splits, key=len)
    return fewest


# Intervals, over independent runs, as the benchmark computes them.


def share_interval(hits: int, trials: int) -> Interval:
    """A share of independent trials (Clopper and Pearson)."""
    bounds = binomtest(hits, trials).proportion_ci(CONFIDENCE, "exact")
    return Interval(hits / trials, float(bounds.low), float(bounds.high))


def mean_interval(values: FloatArray) -> Interval:
    """The mean; values that are not finite are left out."""
    finite = values[np.isfinite(values)]
    if len(finite) < MIN_PAIRS:
        return Interval(float(finite.mean()) if len(finite) else math.nan, math.nan, math.nan)
    low, high = benchmark.mean_interval(finite[:, None], CONFIDENCE)
    return Interval(float(finite.mean()), float(low[0]), float(high[0]))


def rms_interval(values: FloatArray) -> Interval:
    """The root mean square."""
    square = mean_interval(np.square(values))
    return Interval(*(math.sqrt(max(x, 0.0)) for x in (square.value, square.low, square.high)))


def ratio_interval(ours: FloatArray, theirs: FloatArray) -> Interval:
    """Geometric mean of `ours` by `theirs`, (N,) positive quantities of the same recordings; others are left out."""
    difference = benchmark.paired_difference(ours, theirs)
    low, high = difference.interval or (math.nan, math.nan)
    return Interval(*(math.exp(x) for x in (difference.estimate, low, high)))


# Limits, each with its reason.

BETTER = Range(high=1.0 / 1.02)
"""Of the ratio of the paper's filter to its competitor, for anything of which less is better: a difference below 2 %
is none, because nobody would choose between two filters by it."""
REGION = Range(0.94, 0.96)
"""Share of the true cloud in a region that is meant to hold 95 %: right to one percentage point."""
NOT_REGION = Range(high=0.94)
"""The same of a region that does not enclose the cloud."""
CONSISTENT = Range(1.1**-2, 1.1**2)
"""Of NEES by its degrees of freedom, the ratio of the true variance to the claimed one: a filter is consistent if the
standard deviations that it claims are right to 10 %."""
INCONSISTENT = Range(low=1.1**2)
"""The same of a filter that is surer than it may be."""
POSITION_M = Range(high=2.0)
"""The paper grants its own ground truth errors of up to two metres (4.4): nothing better could be seen there."""
YAW_DEG = Range(high=1.0)
"""A hundredth of the paper's turns, which is about what its figure 6 can show."""
VELOCITY_M_S = Range(high=0.25)
"""5 % of the car's speed, which is about what the paper's figure 6 can show."""
SCALE_PERCENT = Range(high=1.0)
""""A little" scale drift: the scale at the end within 1 % of that at the start."""
DRIFT_PERCENT = Range(high=1.0)
""""Minor" drift: 1 % of the path, what good stereo odometry of that time had on KITTI."""

# Sentences.

_SHARE = "share of the points in the region that is meant to hold 95 %"
_THAN = f"over that of the competitor: {BETTER}"
_SIGMA = "claimed sigma right to 10 %"
_POSE = "'The car pose and velocity can be decently estimated quite well, close to the groundtruth'"

REGION_70M = Sentence(
    "region-70m",
    "4.1",
    "Inverse depth at 70 m: 'the red lines enclose the true uncertainty'",
    f"{_SHARE}: {REGION}",
    "figure-1",
)
REGION_70M_XYZ = Sentence(
    "region-70m-xyz",
    "4.1",
    "Euclidean XYZ at 70 m: '... while blue lines do not'",
    f"{_SHARE}: {NOT_REGION}",
    "figure-1",
)
REGION_ANY = Sentence(
    "region-any-distance",
    "4.1",
    "'For any distance close or far, the uncertainty region estimated by our model accurately bounds the true "
    "uncertainty'",
    f"{_SHARE}: {REGION}",
    "figure-2",
)
HISTOGRAM = Sentence(
    "histogram",
    "4.1",
    "Inverse depth at 70 m: 'the red rectangles have more closely covered the true gray rectangles distribution'",
    "Kolmogorov-Smirnov distance of the depths from those claimed, XYZ minus inverse depth: at least 0",
    "figure-1",
)
UNCERTAINTY_CONVERGES = Sentence(
    "uncertainty-converges",
    "4.3, abstract",
    "'No matter the feature is either far or near, ... our proposed method depth and uncertainty converge faster': the "
    "uncertainty",
    f"claimed sigma of the depth after 10 updates, {_THAN}",
    "figure-4",
)
DEPTH_CONVERGES = Sentence(
    "depth-converges",
    "4.3",
    "'... depth and uncertainty converge faster': the depth",
    f"RMS error of the depth after 10 updates, {_THAN}",
    "figure-5",
)
DEPTH_UNCERTAINTY = Sentence(
    "depth-uncertainty",
    "abstract",
    "'Real depth uncertainty distribution of landmarks features can be accurately estimated'",
    f"NEES of the inverse depth after 10 updates: {CONSISTENT} ({_SIGMA})",
    "figure-4",
)
SMOOTHER = Sentence(
    "smoother",
    "4.3, abstract",
    "'Our proposed method estimation is more stable, therefore the curve is smoother'",
    f"RMS second difference of the estimated depth over 10 updates, {_THAN}",
    "figure-5",
)
RAW_MEAN = Sentence(
    "raw-mean",
    "4.3",
    "'After 10 updates, the estimation result is also closer to the mean values of raw measurement'",
    f"distance of the estimate from the mean of the raw depths, {_THAN}",
    "figure-5",
)
TRAJECTORY = Sentence(
    "trajectory",
    "4.4",
    "'Our proposed model estimated trajectory is quite close to the groundtruth'",
    f"RMS position error, m: {POSITION_M} (what the paper grants its own ground truth)",
    "figure-6",
)
DRIFT = Sentence(
    "drift",
    "abstract",
    "'We also found minor drift in the vehicle pose estimation even after extended periods'",
    f"position error at the end, % of the path: {DRIFT_PERCENT}",
    "figure-6",
)
YAW = Sentence("yaw", "4.4", f"{_POSE}: the yaw", f"RMS error of the yaw, degrees: {YAW_DEG}", "figure-6")
VELOCITY = Sentence(
    "velocity", "4.4", f"{_POSE}: Vx and Vz", f"RMS error of Vx and Vz, m/s: {VELOCITY_M_S}", "figure-6"
)
SCALE = Sentence(
    "scale",
    "5",
    "'Even in large-scale outdoor environment, there is only a little scale drift'",
    f"RMS difference of estimated and true length of the path, %: {SCALE_PERCENT}",
    "figure-6",
)
POSE_CONSISTENT = Sentence(
    "consistent",
    "4.1, 5",
    "'The proposed observation models ... worked consistently under the strict requirement of EKF framework'",
    f"pose NEES / 6, and NIS by its degrees of freedom: {CONSISTENT} ({_SIGMA})",
    "figure-nees",
)
LANDMARK_NOISE = Sentence(
    "landmark-noise",
    "5",
    "'Our observation model together with inverse depth parameterization has kept true to the real noise distribution "
    "of the landmark feature'",
    f"landmark NEES / 3 in (u, v, d): {CONSISTENT} ({_SIGMA})",
    "figure-nees",
)
RANGE_HELPS = Sentence(
    "range-helps",
    "5",
    "'The additional range information has helped'",
    f"RMS position error, {_THAN} (competitor, 1 px an image)",
    "figure-nees",
)
XYZ_INCONSISTENT = Sentence(
    "xyz-inconsistent",
    "1",
    "XYZ: 'true distributions of faraway features are non-Gaussian, which makes the EKF filter estimation "
    "inconsistent'",
    f"pose NEES / 6 of the XYZ filter with the right R: {INCONSISTENT}",
    "figure-nees",
)
FASTER = Sentence(
    "faster",
    "5",
    "'Our new observation model is also computationally faster than the ... binocular stereo-based approach'",
    f"time of predict + update, {_THAN}",
    "figure-speed",
)
ONE_UPDATE = Sentence(
    "one-update",
    "5",
    "'We only have to do projection and update in the EKF framework once, in contrast to the binocular approach which "
    "requires projection and update two times each'",
    "projections and updates in a frame: 1 of ours, 2 of the competitor",
    "figure-speed",
)
