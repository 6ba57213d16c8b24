"""Tests say no more than the runs do (3 s)."""

import math
import re

import numpy as np
import pytest
from scipy.stats import wilcoxon

from stereo_slam_env.benchmark.statistics.differences import (
    Finding,
    difference_of,
    group_needed,
    paired_difference,
    pairs_needed,
    percent_words,
    signed,
    signed_rank_p,
    unpaired_difference,
)

HARDNESS = np.exp(np.random.default_rng(0).standard_normal(10))
SCATTER = np.exp(0.05 * np.random.default_rng(1).standard_normal(10))


def test_the_better_of_two_is_the_smaller_one_and_the_other_way_round():
    better = paired_difference(0.8 * HARDNESS * SCATTER, HARDNESS)
    assert better.finding is Finding.BETTER
    assert better.percent == pytest.approx(-20.0, abs=3.0)
    worse = paired_difference(HARDNESS, 0.8 * HARDNESS * SCATTER)
    assert worse.finding is Finding.WORSE
    assert worse.interval == pytest.approx(better.reversed.interval)


def test_interval_and_test_must_agree():
    one_wild = np.array([9.0, *np.linspace(-0.1, 0.12, 9)])
    assert difference_of(one_wild).finding is Finding.NOT_SHOWN
    shown = paired_difference(1.2 * HARDNESS * SCATTER, HARDNESS)
    assert shown.p_value < 0.05 < 20 * shown.p_value + 0.05
    assert not paired_difference(1.2 * HARDNESS * SCATTER, HARDNESS, comparisons=100).shown
    for compared in (paired_difference, unpaired_difference):
        narrow, wide = (compared(3.0 * HARDNESS * SCATTER, HARDNESS, comparisons=n) for n in (1, 6))
        assert wide.p_value == min(1.0, 6 * narrow.p_value)
        assert wide.interval[0] < narrow.interval[0] < narrow.interval[1] < wide.interval[1]


@pytest.mark.parametrize(("comparisons", "pairs"), [(1, 6), (2, 7), (3, 7), (6, 8), (12, 9), (25, 10), (26, 11)])
def test_the_pairs_needed_are_those_with_which_the_test_can_say_something(comparisons, pairs):
    assert pairs_needed(comparisons) == pairs
    as_clear_as_can_be = np.linspace(1.0, 2.0, pairs)
    assert difference_of(as_clear_as_can_be, comparisons=comparisons).shown
    fewer = difference_of(as_clear_as_can_be[1:], comparisons=comparisons)
    assert fewer.too_few
    assert not fewer.shown
    assert f"{pairs} are needed" in fewer.evidence


def test_small_differences_have_digits_enough():
    for factor, digits in ((1.0004, r"0\.0\d"), (1.04, r"\d\.\d"), (1.4, r"\d\d")):
        difference = paired_difference(factor * HARDNESS * SCATTER ** (factor - 1), HARDNESS)
        assert re.fullmatch(rf"\+{digits} to \+{digits} %", difference.interval_words)


def test_what_differs_nowhere_is_identical():
    same = paired_difference(HARDNESS, HARDNESS)
    assert same.identical
    assert same.finding is Finding.NOT_SHOWN
    assert same.evidence == "the same in all 10 runs"
    assert same.not_worse_than(1.0)
    assert not paired_difference(HARDNESS, HARDNESS * SCATTER).identical


def test_pairs_with_a_value_that_is_not_known_are_left_out():
    a, b = HARDNESS.copy(), HARDNESS * SCATTER
    a[0], b[1] = np.nan, np.inf
    assert paired_difference(a, b).count == 8
    assert paired_difference([0.0, 1.0, -1.0, 0.0], [0.0, 2.0, 2.0, 1.0]).count == 2
    nothing = paired_difference([np.nan], [1.0])
    assert nothing.count == 0
    assert math.isnan(nothing.estimate)
    assert nothing.finding is Finding.NOT_SHOWN


def test_differences_may_be_negative():
    difference = paired_difference([-3.0, -2.0, 0.0, 1.0, 2.0, 3.5], [-1.0, 0.0, 2.2, 3.0, 3.7, 5.8], is_ratio=False)
    assert difference.finding is Finding.BETTER
    assert difference.estimate == pytest.approx(-2.03, abs=0.01)
    assert "%" not in difference.evidence.split(" at ")[0]


def test_not_worse_by_more_than_needs_the_whole_interval_below():
    noise = np.exp(0.04 * np.random.default_rng(4).standard_normal(12))
    difference = paired_difference(noise, np.ones(12))
    assert difference.finding is Finding.NOT_SHOWN
    upper = difference.interval_percent[1]
    assert difference.not_worse_than(upper + 0.1)
    assert not difference.not_worse_than(upper - 0.1)
    assert difference.pairs_to_show(1.0) > difference.count
    assert difference.pairs_to_show(-50.0) is None
    assert not paired_difference([1.0], [1.1]).not_worse_than(5.0), "one run shows nothing"


def test_the_signed_rank_test_is_scipys_and_never_promises_more_than_the_runs_can_hold():
    gaps = np.random.default_rng(7).normal(0.5, 1.0, (12, 3))
    gaps[3, 1] = 0.0
    gaps[4:, 2] = 0.0
    first, second, third = signed_rank_p(gaps)
    assert first == wilcoxon(gaps[:, 0], method="exact").pvalue
    assert second == wilcoxon(np.delete(gaps[:, 1], 3), method="exact").pvalue
    assert third >= 2.0**-3
    assert signed_rank_p(np.ones((5, 1))) == [2.0**-4]
    assert signed_rank_p(np.zeros((5, 1))) == [1.0]
    assert signed_rank_p(np.zeros((0, 1))) == [1.0]


def test_without_common_recordings_pairs_are_not_made_up():
    rng = np.random.default_rng(8)
    a, b = np.exp(rng.normal(0.0, 0.5, 20)), np.exp(rng.normal(1.0, 0.5, 15))
    difference = unpaired_difference(a, b)
    assert difference.finding is Finding.BETTER
    assert difference.interval[0] < -1.0 < difference.interval[1]
    assert "15 unpaired runs" in difference.evidence
    assert unpaired_difference(a[:3], b).interval is None


def test_the_unpaired_interval_keeps_its_promise():
    rng = np.random.default_rng(9)
    held = 0
    for _ in range(200):
        a, b = np.exp(rng.standard_t(3, 10)), np.exp(2.0 * rng.standard_normal(15))
        low, high = unpaired_difference(a, b).interval
        held += low <= 0.0 <= high
    assert held / 200 >= 0.93


def test_impossible_levels_are_refused():
    with pytest.raises(ValueError, match="comparisons must be >= 1, got 0"):
        paired_difference(HARDNESS, HARDNESS, comparisons=0)
    with pytest.raises(ValueError, match="a and b must be of the same length"):
        paired_difference(HARDNESS, HARDNESS[1:])


def test_factors_have_words_and_what_is_rounded_to_zero_has_no_sign():
    words = {20.4: "20 % larger", 0.42: "0.4 % larger", 110.0: "110 % larger", -30.0: "30 % smaller"}
    assert {percent: percent_words(percent) for percent in words} == words
    assert signed(-1234.4) == "−1,234"
    assert (signed(-0.4), signed(0.004, 2), signed(-0.0), signed(-0.6)) == ("0", "0.00", "0", "−1")


def test_a_tie_is_no_difference_however_sure_its_sign():
    tie = paired_difference(1.0002 * HARDNESS, HARDNESS)
    assert tie.tied
    assert not tie.identical
    assert tie.finding is Finding.NOT_SHOWN
    assert tie.evidence == "the same to within 0.1 % in all 10 runs"
    assert not paired_difference(1.002 * HARDNESS, HARDNESS).tied
    assert not unpaired_difference(HARDNESS, HARDNESS).tied


@pytest.mark.parametrize(("comparisons", "size"), [(1, 6), (23, 6), (24, 7), (85, 7), (86, 8)])
def test_the_groups_needed_are_those_with_which_the_rank_sum_test_can_say_something(comparisons, size):
    """Two groups need fewer than pairs do: 6 of each are enough for 23 comparisons."""
    assert group_needed(comparisons) == size
    apart, fewer = (
        unpaired_difference(np.linspace(2.0, 2.1, n), np.linspace(1.0, 1.1, n), comparisons=comparisons)
        for n in (size, size - 1)
    )
    assert (apart.shown, apart.too_few) == (True, False)
    assert (fewer.shown, fewer.too_few, fewer.interval) == (False, True, None)
    assert f"{size} are needed" in fewer.evidence
