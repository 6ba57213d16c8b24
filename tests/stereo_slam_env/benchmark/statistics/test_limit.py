"""How near filters come to what theory allows, in words that hold for these runs (< 1 s)."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.remarks import LimitReached, Reach, limit_reached
from stereo_slam_env.benchmark.statistics.verdict import judge

from ....synthetic_runs import THREE, changed, make_runs, scored

RUNS = make_runs(THREE[:1], seeds=range(8), frames=40)
SUMMARIES, FIGURES = scored(RUNS)


def reached(efficiencies):
    """A filter with these efficiencies run by run, and errors of 1 m."""
    efficiencies = np.asarray(efficiencies, dtype=float)
    over_runs = {"efficiency_percent": float(np.sqrt(np.mean(efficiencies**2))), "bound_position_m": 0.5}
    return replace(
        changed(SUMMARIES[0], **over_runs),
        position_rmse_by_run=(1.0,) * len(efficiencies),
        efficiency_by_run=tuple(efficiencies),
    )


@pytest.mark.parametrize(
    ("efficiencies", "reach", "words"),
    [
        (np.linspace(60, 80, 8), Reach.SHORT, r"7\d % \(6\d to 7\d %\)"),
        (np.linspace(60, 150, 8), Reach.AT, r"at the limit \(8\d to 1\d\d %\)"),
        (np.linspace(40, 125, 8), Reach.OPEN, r"8\d % \(\d\d to 10\d %\)"),
        (np.linspace(110, 130, 8), Reach.BEYOND, r"beyond the limit \(11\d to 12\d %\)"),
        ([70.0, 80.0], Reach.SHORT, r"75 % \(2 runs\)"),
        ([112.0], Reach.UNSURE, r"not distinguishable from the limit \(1 run\)"),
    ],
)
def test_an_interval_with_100_percent_in_it_is_at_the_limit(efficiencies, reach, words):
    found = limit_reached(reached(efficiencies))
    assert found.reach is reach
    assert pytest.approx(found.percent) == reached(efficiencies).efficiency_percent
    assert re.fullmatch(words, found.words)


@pytest.mark.parametrize(
    ("percent", "interval", "reach"),
    [(90.0, (80.0, 100.0), Reach.OPEN), (90.0, (80.0, 99.9), Reach.SHORT), (110.0, (100.0, 120.0), Reach.AT)],
)
def test_an_interval_that_ends_at_100_percent_has_it_in_it(percent, interval, reach):
    assert LimitReached(percent, interval, 8).reach is reach


def test_no_more_than_100_percent_of_what_theory_allows_is_ever_claimed():
    for efficiencies in (np.linspace(60, 150, 8), np.linspace(110, 130, 8), [112.0]):
        said = judge([reached(efficiencies)], FIGURES).answers["limit"]
        assert not re.search(r"efficiency is \d", said)
    assert "may be 100 % of the Cramér–Rao bound" in judge([reached(np.linspace(60, 150, 8))], FIGURES).headline


def test_without_a_bound_nothing_is_said():
    assert limit_reached(SUMMARIES[0]) is None
    assert "limit" not in judge(SUMMARIES, FIGURES).answers
