"""The claims of the paper: conditions that they are judged under, intervals, and the rule that decides.

Every claim is made measurable: a quantity, and the range in which it must lie if the claim is true. A quantity is
measured under several conditions, each time with a 95 % confidence interval, in up to three places: with simulated
measurements, in rendered images, on real drives.

- One condition (`Finding`): the claim *holds* if the whole interval lies in the range, *does not hold* if the whole
  interval lies outside, and is *not shown* where the interval crosses a limit of the range, or there is no interval.
- The claim (`Claim`), in one place and in all: *holds* if it holds under every condition; *does not hold* if it is
  refuted under every one; *holds only if ...* if it is shown under some of them, which are then named, and refuted
  under others; else *not shown*: what is undecided is neither held nor refuted.

Nothing else decides. `claims.json` has every checkable sentence and the limits, each with its reason; they were chosen
before these runs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest, chi2

from filters import StereoNoise
from stereo_slam_env import benchmark
from stereo_slam_env.benchmark import CONFIDENCE, MIN_PAIRS
from stereo_slam_env.evaluation import studentised_interval

FloatArray = NDArray[np.float64]
Arrays = dict[str, NDArray[Any]]
"""Result of an experiment."""

# Conditions.

SIMULATION, RENDERED, REAL = "simulation", "rendered", "real"
PLACES: Mapping[str, str] = {SIMULATION: "Simulation", RENDERED: "Rendered images", REAL: "Real drives"}
"""Where a claim is judged: on simulated measurements, on tracks through rendered images, on real recordings."""

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
OWN = "measured"
"""The R that a front end measured for each track, or that `replay` assumes of stored tracks."""
ASSUMED_NAMES: Mapping[str, str] = {
    DIAGONAL: "the paper's",
    COUPLED: "of independent pixels",
    OWN: "of the measurements",
}

JOINT, DUAL, PAZ, EUCLIDEAN = "inverse-depth", "dual-bearing", "paz", "euclidean"
XYZ_POINTS, POINTS, MONOCULAR, ODOMETRY = "euclidean-unscented", "unscented", "monocular", "frame-to-frame"
FILTERS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    JOINT: ("inverse-depth", {}),
    DUAL: ("dual-bearing", {}),
    PAZ: ("hybrid", {"measurement": "sequential"}),
    EUCLIDEAN: ("euclidean", {"min_disparity": 4.0}),
    XYZ_POINTS: ("euclidean", {"update": "unscented", "min_disparity": 1.0}),
    POINTS: ("unscented", {}),
    MONOCULAR: (
        "monocular",
        {"measurement": {"name": "left", "inverse_depth": 0.1, "sigma_inverse_depth": 0.1}},
    ),
    ODOMETRY: ("frame-to-frame", {}),
}
"""Filters of the study, each a name and options of `make_filter`: the paper's; the same with one bearing update an
image; the competitor that the paper names (Paz et al.: inverse depth far, XYZ near, two bearing updates); XYZ by an EKF
and by sigma points; inverse depth by sigma points; the left camera alone; visual odometry from frame to frame. Smallest
disparities of XYZ landmarks were chosen on other drives (`benchmarks/euclidean_guard.py`)."""
FILTER_NAMES: Mapping[str, str] = {
    JOINT: "inverse depth, (u, v, d)",
    DUAL: "inverse depth, two bearings",
    PAZ: "Paz et al.",
    EUCLIDEAN: "XYZ",
    XYZ_POINTS: "XYZ, sigma points",
    POINTS: "inverse depth, sigma points",
    MONOCULAR: "left camera alone",
    ODOMETRY: "visual odometry",
}
UNGATED: Mapping[str, Any] = {"gate": None}
"""Options of every filter on simulated measurements: nothing is gated, so nothing is hidden."""
GATED: Mapping[str, Any] = {"gate": 0.99, "consensus": True}
"""Options of every filter on tracks through images: a front end makes mistakes, so they are looked for."""


# The rule.


class ClaimVerdict(Enum):
    """Verdicts on a claim."""

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
    """Range of a quantity, from `low` to `high`, both included."""

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


def decide(measured: Interval, asked: Range) -> ClaimVerdict:
    """The rule for one condition: what was measured, and the range in which it must lie if the claim is true."""
    if not measured.known:
        return ClaimVerdict.NOT_SHOWN
    if asked.low <= measured.low and measured.high <= asked.high:
        return ClaimVerdict.HOLDS
    if measured.high < asked.low or measured.low > asked.high:
        return ClaimVerdict.DOES_NOT_HOLD
    return ClaimVerdict.NOT_SHOWN


@dataclass(frozen=True)
class ClaimFinding:
    """A claim under one condition."""

    # factor -> level, e.g. {"noise": "pixels independent", "R": "full"}; the same factors in all of a claim in a place
    condition: Mapping[str, str]
    measured: Interval  # the quantity
    asked: Range  # where it must lie if the claim is true
    place: str = SIMULATION  # a key of `PLACES`

    @property
    def verdict(self) -> ClaimVerdict:
        """Verdict of `decide` on this condition."""
        return decide(self.measured, self.asked)


@dataclass(frozen=True)
class Sentence:
    """Statement of the paper that can be checked: an entry of `claims.json`."""

    key: str  # a short, unique name
    section: str  # of the paper
    claim: str  # what it says there
    statement: str  # what is measured, and when that counts as true
    evidence: str  # name of the figure that it is shown with
    asked: Range = Range()  # where the quantity must lie


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, and what was found about it: one finding a condition."""

    sentence: Sentence
    findings: tuple[ClaimFinding, ...]

    def at(self, place: str) -> Claim:
        """The claim in one place alone; without any finding where it was not judged there."""
        return replace(self, findings=tuple(finding for finding in self.findings if finding.place == place))

    @property
    def verdict(self) -> ClaimVerdict:
        """Judge by the rule of this module."""
        verdicts = {finding.verdict for finding in self.findings}
        if {ClaimVerdict.HOLDS, ClaimVerdict.DOES_NOT_HOLD} <= verdicts:
            return ClaimVerdict.HOLDS_ONLY_IF
        return verdicts.pop() if len(verdicts) == 1 else ClaimVerdict.NOT_SHOWN

    @property
    def says(self) -> str:
        """The verdict in one place in words: where it holds or is refuted, and how many conditions show nothing."""
        if not self.findings:
            return "–"
        every = [finding.condition for finding in self.findings]
        of = {kind: [f.condition for f in self.findings if f.verdict is kind] for kind in ClaimVerdict}
        undecided = len(of[ClaimVerdict.NOT_SHOWN])
        words = str(self.verdict.value)
        if self.verdict is ClaimVerdict.HOLDS_ONLY_IF:
            words = f"{words} {describe(of[ClaimVerdict.HOLDS], every)}"
        elif undecided < len(every) and self.verdict is ClaimVerdict.NOT_SHOWN:
            (kind,) = (kind for kind in (ClaimVerdict.HOLDS, ClaimVerdict.DOES_NOT_HOLD) if of[kind])
            return f"{words} ({kind.value} if {describe(of[kind], every)}; undecided under {undecided} of {len(every)})"
        return (
            f"{words} (not shown under {undecided} of {len(every)} conditions)" if 0 < undecided < len(every) else words
        )


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


def finite_mean(values: FloatArray) -> float:
    """Mean of the finite values; NaN where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else math.nan


def mean_interval(values: FloatArray) -> Interval:
    """The mean; values that are not finite are left out."""
    finite = values[np.isfinite(values)]
    if len(finite) < MIN_PAIRS:
        return Interval(finite_mean(finite), math.nan, math.nan)
    low, high = studentised_interval(finite[:, None], CONFIDENCE)
    return Interval(float(finite.mean()), float(low[0]), float(high[0]))


def single_interval(nees: float, dof: int = 6) -> Interval:
    """The variance ratio that the mean NEES of one drive shows, over its degrees of freedom.

    The error of a drive changes slowly, so it is taken for one draw: the interval of a chi-square variable.
    """
    low, high = chi2.ppf([0.5 - CONFIDENCE / 2.0, 0.5 + CONFIDENCE / 2.0], dof) / dof
    return Interval(nees, nees / float(high), nees / float(low))


def rms_interval(values: FloatArray) -> Interval:
    """The root mean square."""
    square = mean_interval(np.square(values))
    return Interval(*(math.sqrt(max(x, 0.0)) for x in (square.value, square.low, square.high)))


def ratio_interval(ours: FloatArray, theirs: FloatArray) -> Interval:
    """Geometric mean of `ours` by `theirs`, (N,) positive quantities of the same recordings; others are left out."""
    difference = benchmark.paired_difference(ours, theirs)
    low, high = difference.interval or (math.nan, math.nan)
    return Interval(*(math.exp(x) for x in (difference.estimate, low, high)))


# Sentences.


TABLE: Mapping[str, Any] = json.loads(Path(__file__).with_name("claims.json").read_text(encoding="utf-8"))
"""The rule and the conditions in words, limits, sentences, captions of the figures."""


def _sentences() -> dict[str, Sentence]:
    ranges = {
        name: Range(about.get("low", -math.inf), about.get("high", math.inf)) for name, about in TABLE["limits"].items()
    }
    sentences = {}
    for entry in TABLE["sentences"]:
        wanted_range, note = ranges.get(entry.get("limit"), Range()), f" ({entry['note']})" if "note" in entry else ""
        statement = f"{entry['measured']}: {wanted_range}{note}" if "limit" in entry else entry["measured"]
        key, figure = entry["key"], entry["figure"]
        sentences[key] = Sentence(key, entry["section"], entry["claim"], statement, figure, wanted_range)
    return sentences


SENTENCES: Mapping[str, Sentence] = _sentences()
"""By key."""
Measured = Iterable[tuple[Mapping[str, str], Interval]]
"""Conditions, and what was measured under each."""


def claim(key: str, simulation: Measured = (), rendered: Measured = (), real: Measured = ()) -> Claim:
    """The sentence of that key, judged by what was measured in each place."""
    sentence = SENTENCES[key]
    return Claim(
        sentence,
        tuple(
            ClaimFinding(condition, interval, sentence.asked, place)
            for place, measured in zip(PLACES, (simulation, rendered, real), strict=True)
            for condition, interval in measured
        ),
    )
