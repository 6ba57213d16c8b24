"""How often filters diverge (< 1 s)."""

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.differences import Finding, share_difference


@pytest.mark.parametrize(
    ("only_a", "only_b", "finding"),
    [(6, 0, Finding.WORSE), (0, 8, Finding.BETTER), (5, 0, Finding.NOT_SHOWN), (8, 6, Finding.NOT_SHOWN)],
)
def test_divergences_are_compared_where_the_filters_disagree(only_a, only_b, finding):
    a = np.repeat([True, False, True], [only_a, only_b, 20])
    b = np.repeat([False, True, True], [only_a, only_b, 20])
    assert share_difference(a, b).finding is finding
    opposite = {Finding.WORSE: Finding.BETTER, Finding.BETTER: Finding.WORSE}
    assert share_difference(b, a).finding is opposite.get(finding, finding)


def test_many_comparisons_need_more_disagreement():
    a, b = np.ones(8, bool), np.zeros(8, bool)
    assert share_difference(a, b, comparisons=6).finding is Finding.WORSE
    assert share_difference(a, b, comparisons=7).finding is Finding.NOT_SHOWN


def test_without_common_recordings_shares_are_compared():
    assert share_difference(np.ones(9, bool), np.zeros(9, bool), paired=False).finding is Finding.WORSE
    assert share_difference(np.zeros(9, bool), np.ones(5, bool), paired=False).finding is Finding.BETTER
    assert share_difference(np.ones(0, bool), np.zeros(9, bool), paired=False).finding is Finding.NOT_SHOWN
