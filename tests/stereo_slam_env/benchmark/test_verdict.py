"""What the report may claim, from runs with a known answer (< 2 s)."""

from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.benchmark.summary import summarise_all
from stereo_slam_env.benchmark.verdict import Consistency, compare, consistency, judge

from ...synthetic_runs import THREE, THREE_ONE_DIVERGING, Behaviour, make_runs


def summary(**changes):
    return replace(summarise_all(make_runs(THREE[:1], frames=20))[0], filter_name="other", **changes)


def errors(values):
    return {("drive", seed): float(value) for seed, value in enumerate(values)}


HARDNESS = np.exp(np.random.default_rng(1).standard_normal(10))
"""How hard each recording is, the same for both filters: it cancels in a paired comparison."""


def test_a_constant_gap_is_found_although_recordings_differ_more_than_filters():
    noise = np.exp(0.03 * np.random.default_rng(2).standard_normal(10))
    comparison = compare("best", errors(HARDNESS), summary(), errors(1.2 * HARDNESS * noise))
    assert comparison.shown
    low, high = comparison.interval_percent
    assert low < 20 < high
    assert 0 < low < high < 30


def test_equal_filters_are_not_ranked():
    false_alarms = 0
    for seed in range(200):
        noise = np.exp(0.2 * np.random.default_rng(seed).standard_normal(10))
        false_alarms += compare("best", errors(HARDNESS), summary(), errors(HARDNESS * noise)).shown
    assert false_alarms / 200 < 0.06


def test_more_comparisons_need_more_evidence():
    noise = np.exp(0.1 * np.random.default_rng(3).standard_normal(10))
    narrow, wide = (
        compare("best", errors(HARDNESS), summary(), errors(1.1 * HARDNESS * noise), comparisons=n) for n in (1, 6)
    )
    assert wide.interval_percent[0] < narrow.interval_percent[0]
    assert wide.interval_percent[1] > narrow.interval_percent[1]


@pytest.mark.parametrize(
    ("ours", "theirs", "says"),
    [
        ([0.10], [0.20], "one run shows no general difference"),
        ([0.10, 0.14, 0.11], [0.12, 0.13, 0.15], "overlap"),
        ([0.10, 0.11, 0.12], [0.20, 0.22, 0.21], "too few for an interval"),
    ],
)
def test_few_runs_show_nothing(ours, theirs, says):
    comparison = compare("best", errors(ours), summary(), errors(theirs))
    assert not comparison.shown
    assert comparison.interval_percent is None
    assert says in comparison.words


def test_a_filter_that_completed_nothing_is_not_compared_by_number():
    comparison = compare("best", errors([0.1] * 6), summary(diverged=6), errors([np.nan] * 6))
    assert np.isnan(comparison.excess_percent)
    assert comparison.words == "other completed no run"


@pytest.mark.parametrize(
    ("anees", "state"),
    [(6.0, Consistency.CONSISTENT), (20.0, Consistency.OVERCONFIDENT), (1.0, Consistency.CAUTIOUS)],
)
def test_consistency_is_the_place_in_the_band(anees, state):
    assert consistency(summary(pose_anees=anees, pose_anees_band=(4.0, 8.0))) is state


def test_without_truth_consistency_is_not_known():
    assert consistency(summary(pose_anees=None)) is Consistency.UNKNOWN


def test_a_filter_that_diverged_is_never_the_best():
    lucky = Behaviour("lucky", 0.001)
    runs = make_runs((lucky, *THREE[:2]), frames=60)
    summaries = summarise_all(runs)
    assert judge(runs, summaries).best == "lucky"
    summaries = [replace(s, diverged=1) if s.filter_name == "lucky" else s for s in summaries]
    verdict = judge(runs, summaries)
    assert verdict.best != "lucky"
    assert "lucky diverged in 1 of 5 runs" in verdict.headline


def test_the_headline_names_the_winner_its_consistency_and_its_cost():
    clear = (Behaviour("sharp", 0.02), Behaviour("blunt", 0.4))
    runs = make_runs(clear, seeds=range(8), frames=120)
    headline = judge(runs, summarise_all(runs)).headline
    assert headline.startswith("sharp is the most accurate")
    assert "NEES" in headline
    assert "ms a frame" in headline


def test_near_equals_are_called_so():
    runs = make_runs(THREE[:2], frames=120)
    assert "no difference to" in judge(runs, summarise_all(runs)).headline


def test_no_truth_and_no_survivor_have_their_own_words():
    runs = make_runs(seeds=[None], frames=60, truth="none")
    assert "no ground truth" in judge(runs, summarise_all(runs)).headline
    runs = make_runs(THREE_ONE_DIVERGING[2:], frames=240)
    assert judge(runs, summarise_all(runs)).headline == "Every filter diverged in at least one run."
