"""Differences between filters, and between shares of runs, with intervals and tests.

Errors of two filters differ by a factor rather than by an amount (a hard recording is hard for both), so what is
averaged is the logarithm of their ratio on the same recording. Intervals are those of the symmetric studentised
bootstrap (Hall, *The Bootstrap and Edgeworth Expansion*, 1992, section 3.5), chosen by measured coverage, see
docs/statistics.md; the test is Wilcoxon's signed-rank test. A difference is shown when interval and test say so.

Both are corrected for the number of comparisons after Bonferroni, here and nowhere else: an interval is taken at the
confidence 1 - (1 - confidence) / comparisons, a p value is multiplied by comparisons. With so few runs that no outcome
whatever could be significant there is no interval.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
import scipy  # its `stats`, slow to import, is loaded where it is used
from numpy.typing import ArrayLike

from filters.geometry.arrays import BoolArray, FloatArray
from stereo_slam_env.evaluation.bands import studentised_interval, welch_interval
from stereo_slam_env.evaluation.figures import readable

CONFIDENCE = 0.95
MIN_PAIRS = 6
"""Below this a signed-rank test cannot reach 5 %, and an interval says nothing."""
TIE_PERCENT = 0.1
"""Two that differ by less than that on every recording are tied."""
_EXACT_PAIRS = 50
_LARGEST_LOG = 50.0
_MOST_DIGITS = 1e6


class Finding(Enum):
    """Result of a comparison, for the first of the two."""

    BETTER = "better"
    WORSE = "worse"
    NOT_SHOWN = "not significant"


@dataclass(frozen=True)
class Difference:
    """Difference of two quantities, smaller being better, with its confidence interval and test."""

    count: int
    """Pairs, or the size of the smaller group where nothing is paired."""
    estimate: float
    """Mean of log(a / b), or of a - b; NaN without a pair."""
    interval: tuple[float, float] | None
    """Confidence interval of it, corrected for the number of comparisons; None where `too_few`."""
    p_value: float
    """Two-sided, corrected for the number of comparisons."""
    is_ratio: bool = True
    """Whether it is of logarithms."""
    paired: bool = True
    """Whether both were measured on the same recordings."""
    comparisons: int = 1
    """What interval and p value are corrected for."""
    largest: float = float("nan")
    """Largest |log(a / b)|, or |a - b|, of a pair; NaN where nothing is paired."""

    @property
    def finding(self) -> Finding:
        """Whether a is shown to be better (smaller) or worse than b: interval and test agree; a tie is neither."""
        if self.tied or self.interval is None or self.p_value > 1.0 - CONFIDENCE:
            return Finding.NOT_SHOWN
        if self.interval[1] < 0.0:
            return Finding.BETTER
        return Finding.WORSE if self.interval[0] > 0.0 else Finding.NOT_SHOWN

    @property
    def shown(self) -> bool:
        """Whether a difference is shown."""
        return self.finding is not Finding.NOT_SHOWN

    @property
    def needed(self) -> int:
        """The smallest number of runs with which the corrected test can say anything."""
        return (pairs_needed if self.paired else group_needed)(self.comparisons)

    @property
    def too_few(self) -> bool:
        """Whether no outcome whatever could have shown a difference with so few runs and so many comparisons."""
        return self.count < self.needed

    @property
    def percent(self) -> float:
        """Excess of a over b run by run, %: the geometric mean of their ratios; of ratios only."""
        return as_percent(self.estimate)

    @property
    def interval_percent(self) -> tuple[float, float] | None:
        """`interval` in %; of ratios only."""
        return None if self.interval is None else (as_percent(self.interval[0]), as_percent(self.interval[1]))

    @property
    def reversed(self) -> Difference:
        """Difference of b and a."""
        interval = None if self.interval is None else (-self.interval[1], -self.interval[0])
        return replace(self, estimate=-self.estimate, interval=interval)

    def not_worse_than(self, percent: float) -> bool:
        """Whether the runs show that a is not larger than b by more than `percent`: the interval ends below it."""
        return self.interval is not None and self.interval[1] < math.log1p(percent / 100.0)

    def pairs_to_show(self, percent: float) -> int | None:
        """Roughly how many pairs `not_worse_than` would need if the estimate is right; None if no number will do."""
        room = math.log1p(percent / 100.0) - self.estimate
        if self.interval is None or not room > 0.0:
            return None
        half = 0.5 * (self.interval[1] - self.interval[0])
        return max(self.needed, math.ceil(self.count * (half / room) ** 2))

    @property
    def identical(self) -> bool:
        """Whether no pair differs at all."""
        return self.largest == 0.0

    @property
    def tied(self) -> bool:
        """Whether no pair differs by as much as `TIE_PERCENT` (differences that are no ratios: at all)."""
        return self.largest < math.log1p(TIE_PERCENT / 100.0) if self.is_ratio else self.identical

    @property
    def tie_words(self) -> str:
        """Words on a tie: "the same in all 8 runs"."""
        runs = f"all {self.count} runs" if self.count > 1 else "the only run"
        return f"the same in {runs}" if self.identical else f"the same to within {TIE_PERCENT:g} % in {runs}"

    @property
    def evidence(self) -> str:
        """Interval and number of runs, for brackets: "+12 to +19 % at 95 % confidence, 10 paired runs"."""
        runs = f"{self.count} {'paired' if self.paired else 'unpaired'} run{'' if self.count == 1 else 's'}"
        if self.tied:
            return self.tie_words
        if self.too_few:
            also = f" for {self.comparisons} comparisons" if self.comparisons > 1 else ""
            return f"{runs} {'is' if self.count == 1 else 'are'} too few{also}, {self.needed} are needed"
        if self.interval is None:
            return runs
        return f"{self.interval_words} at {100 * CONFIDENCE:g} % confidence, {runs}"

    @property
    def interval_words(self) -> str:
        """The interval alone: "+12 to +19 %"; empty where there is none."""
        ends = self.interval_percent if self.is_ratio else self.interval
        if ends is None:
            return ""
        widest = max(map(abs, ends))
        digits = (0 if widest >= 10.0 else 1 if widest >= 1.0 else 2) if self.is_ratio else 3
        return f"{signed(ends[0], digits)} to {signed(ends[1], digits)}{' %' if self.is_ratio else ''}"


def paired_difference(a: ArrayLike, b: ArrayLike, *, comparisons: int = 1, is_ratio: bool = True) -> Difference:
    """Compare two quantities that were measured on the same recordings.

    Parameters
    ----------
    a, b : (n,) array_like
        One value a recording. Pairs with a value that is not finite (or, of ratios, not positive) are left out; two
        zeros are equal.
    comparisons : int
        Number of comparisons made at once.
    is_ratio : bool
        Compare logarithms; False for values that may be zero or negative: compares a - b.

    Raises
    ------
    ValueError
        a and b are of different lengths, or comparisons < 1.
    """
    first, second = (np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in (a, b))
    if first.shape != second.shape or first.ndim != 1:
        raise ValueError(
            f"a and b must be of the same length, one value a recording: got {first.shape}, {second.shape}"
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        gaps = np.where(first == second, 0.0, np.log(first / second)) if is_ratio else first - second
        usable = np.isfinite(gaps) & np.isfinite(first) & np.isfinite(second)
    if is_ratio:
        usable &= (first >= 0.0) & (second >= 0.0)
    return difference_of(gaps[usable], comparisons=comparisons, is_ratio=is_ratio)


def difference_of(gaps: FloatArray, *, comparisons: int = 1, is_ratio: bool = True) -> Difference:
    """The difference that independent gaps (n,) show, one a recording; options as `paired_difference`."""
    return differences_of(gaps[:, None], comparisons=comparisons, is_ratio=is_ratio)[0]


def differences_of(gaps: FloatArray, *, comparisons: int = 1, is_ratio: bool = True) -> list[Difference]:
    """The differences that m columns of gaps (n, m) show, one row a recording; options as `paired_difference`."""
    count, columns = gaps.shape
    intervals: list[tuple[float, float] | None] = [None] * columns
    confidence = level(comparisons)
    if count >= pairs_needed(comparisons):
        low, high = studentised_interval(gaps, confidence)
        intervals = list(zip(low.tolist(), high.tolist(), strict=True))
    return [
        Difference(
            count=count,
            estimate=float(column.mean()) if count else float("nan"),
            interval=interval,
            p_value=min(1.0, comparisons * float(p_value)),
            is_ratio=is_ratio,
            comparisons=comparisons,
            largest=float(np.abs(column).max()) if count else float("nan"),
        )
        for column, interval, p_value in zip(gaps.T, intervals, signed_rank_p(gaps), strict=True)
    ]


def unpaired_difference(a: ArrayLike, b: ArrayLike, *, comparisons: int = 1) -> Difference:
    """Compare two positive quantities measured on different recordings: Welch's t by bootstrap, Mann-Whitney.

    Values that are not finite and positive are left out; options as `paired_difference`.
    """
    groups = [np.asarray(values, dtype=np.float64) for values in (a, b)]
    first, second = (np.log(values[np.isfinite(values) & (values > 0.0)]) for values in groups)
    count = min(len(first), len(second))
    interval, p_value, confidence = None, 1.0, level(comparisons)
    estimate = float(first.mean() - second.mean()) if count else float("nan")
    if count >= group_needed(comparisons):
        interval = welch_interval(first, second, confidence)
        p_value = float(scipy.stats.mannwhitneyu(first, second).pvalue)
    return Difference(count, estimate, interval, min(1.0, comparisons * p_value), paired=False, comparisons=comparisons)


def signed_rank_p(gaps: FloatArray) -> FloatArray:
    """Two-sided p value of Wilcoxon's signed-rank test of each column of (n, m) gaps.

    Gaps of exactly zero say nothing and are left out.
    """
    count, columns = gaps.shape
    p_values = np.ones(columns)
    sizes = np.sort(np.abs(gaps), axis=0)
    plain = (np.diff(sizes, axis=0, prepend=0.0) > 0.0).all(axis=0) & (0 < count <= _EXACT_PAIRS)
    if plain.any():
        p_values[plain] = scipy.stats.wilcoxon(gaps[:, plain], axis=0, method="exact").pvalue
    for column in np.flatnonzero(~plain):
        moved = gaps[gaps[:, column] != 0.0, column]
        if len(moved) == 0:
            continue
        exact = len(moved) <= _EXACT_PAIRS and len(np.unique(np.abs(moved))) == len(moved)
        p_value = float(scipy.stats.wilcoxon(moved, method="exact" if exact else "approx").pvalue)
        p_values[column] = max(p_value, 2.0 ** (1 - len(moved)))  # with ties, few pairs would promise the impossible
    return np.minimum(p_values, 1.0)


def pairs_needed(comparisons: int = 1) -> int:
    """Pairs without which the signed-rank test cannot reach significance: its smallest p value is 2^(1 - n)."""
    return max(MIN_PAIRS, 1 + math.ceil(math.log2(comparisons / (1.0 - CONFIDENCE)) - 1e-9))


def group_needed(comparisons: int = 1) -> int:
    """Size of two groups without which the rank-sum test cannot: its smallest p value is 2 / (2n over n)."""
    n = MIN_PAIRS
    while comparisons * 2.0 / math.comb(2 * n, n) > 1.0 - CONFIDENCE:
        n += 1
    return n


def level(comparisons: int) -> float:
    """Confidence of one interval such that all of them hold together with `CONFIDENCE` (Bonferroni)."""
    if not comparisons >= 1:
        raise ValueError(f"comparisons must be >= 1, got {comparisons!r}")
    return 1.0 - (1.0 - CONFIDENCE) / comparisons


def as_percent(log_ratio: float) -> float:
    """Change in percent of a logarithm of a ratio: +100 for log 2."""
    return float(100.0 * np.expm1(np.clip(log_ratio, -_LARGEST_LOG, _LARGEST_LOG)))


# ---- shares ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ShareDifference:
    """Difference of the shares of recordings in which something (a divergence) happened."""

    # Recordings where it happened to one of them alone; where nothing is paired, all where it happened.
    only_a: int
    only_b: int
    count: int
    p_value: float  # two-sided, exact, corrected for the number of comparisons
    finding: Finding  # about a; less often is better
    needed: int  # recordings without which no outcome could be significant
    identical: bool  # whether it happened in the same recordings

    @property
    def tied(self) -> bool:
        """Whether there is no difference."""
        return self.identical

    @property
    def too_few(self) -> bool:
        """Whether no outcome whatever could have shown a difference."""
        return self.count < self.needed

    @property
    def interval_percent(self) -> None:
        """Interval of the difference: shares have none."""


def share_difference(a: BoolArray, b: BoolArray, *, paired: bool = True, comparisons: int = 1) -> ShareDifference:
    """Compare the shares of recordings in which something happened.

    On the same recordings, McNemar's exact test: of those where a and b disagree, is it one of them more often than the
    other. On different ones, Fisher's exact test.
    """
    p_value = 1.0
    if paired:
        in_a, in_b, count = int(np.sum(a & ~b)), int(np.sum(b & ~a)), len(a)
        more = in_a - in_b
        if in_a + in_b:
            p_value = float(scipy.stats.binomtest(in_a, in_a + in_b).pvalue)
    else:
        in_a, in_b, count = int(a.sum()), int(b.sum()), min(len(a), len(b))
        more = in_a * len(b) - in_b * len(a)
        if count:
            p_value = float(scipy.stats.fisher_exact([[in_a, len(a) - in_a], [in_b, len(b) - in_b]]).pvalue)
    p_value *= comparisons
    finding = Finding.NOT_SHOWN
    if p_value <= 1.0 - CONFIDENCE and more:
        finding = Finding.WORSE if more > 0 else Finding.BETTER
    needed = (pairs_needed if paired else group_needed)(comparisons)
    return ShareDifference(in_a, in_b, count, min(1.0, p_value), finding, needed, bool(np.array_equal(a, b)))


# ---- in words --------------------------------------------------------------------------------------------------------


def signed(value: float, digits: int = 0) -> str:
    """Number with its sign, as in print: "+1,200", "−3"; zero after rounding has none."""
    if abs(value) >= _MOST_DIGITS:
        return f"{'+' if value > 0 else ''}{readable(value)}".replace("-", "−")
    text = f"{value:+,.{digits}f}"
    return (text if any(digit in text for digit in "123456789") else text[1:]).replace("-", "−")


def percent_words(percent: float, more: str = "larger", less: str = "smaller") -> str:
    """A change in percent, in words: "20 % larger", "1,200 % larger", "4 % smaller"."""
    size = abs(percent)
    amount = readable(size) if size >= _MOST_DIGITS else f"{size:,.{0 if size >= 10.0 else 1}f}"
    return f"{amount} % {less if percent < 0.0 else more}"


def listed(words: Sequence[str]) -> str:
    """Words in a sentence: "a, b and c"."""
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else words[0]
