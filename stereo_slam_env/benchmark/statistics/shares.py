"""How often something happens (a divergence), with exact tests of whether one filter has it more often than another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, fisher_exact

from filters.validation import BoolArray
from stereo_slam_env.benchmark.statistics.differences import CONFIDENCE, Finding


@dataclass(frozen=True)
class ShareDifference:
    """How often something happened (a divergence) with one filter and not with the other.

    Attributes
    ----------
    only_a, only_b : int
        Recordings where it happened to one of them alone; where nothing is paired, all where it happened.
    count : int
        Recordings.
    p_value : float
        Two-sided, exact, corrected for the number of comparisons.
    finding : Finding
        About a; less often is better.
    """

    only_a: int
    only_b: int
    count: int
    p_value: float
    finding: Finding


def paired_share(
    a: BoolArray, b: BoolArray, *, comparisons: int = 1, confidence: float = CONFIDENCE
) -> ShareDifference:
    """McNemar's exact test, of the recordings where a and b disagree: is it one of them more often than the other."""
    only_a, only_b = int(np.sum(a & ~b)), int(np.sum(b & ~a))
    p_value = float(binomtest(only_a, only_a + only_b).pvalue) if only_a + only_b else 1.0
    return _share(only_a, only_b, len(a), only_a - only_b, comparisons * p_value, confidence)


def unpaired_share(
    a: BoolArray, b: BoolArray, *, comparisons: int = 1, confidence: float = CONFIDENCE
) -> ShareDifference:
    """Fisher's exact test, for recordings that are not the same."""
    in_a, in_b = int(a.sum()), int(b.sum())
    p_value = float(fisher_exact([[in_a, len(a) - in_a], [in_b, len(b) - in_b]]).pvalue) if len(a) and len(b) else 1.0
    more = in_a * len(b) - in_b * len(a)
    return _share(in_a, in_b, min(len(a), len(b)), more, comparisons * p_value, confidence)


def _share(in_a: int, in_b: int, count: int, more: int, p_value: float, confidence: float) -> ShareDifference:
    finding = Finding.NOT_SHOWN
    if p_value <= 1.0 - confidence and more:
        finding = Finding.WORSE if more > 0 else Finding.BETTER
    return ShareDifference(in_a, in_b, count, min(1.0, p_value), finding)
