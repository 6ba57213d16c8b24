"""What filters are compared by (< 2 s)."""

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.differences import Finding
from stereo_slam_env.benchmark.statistics.measures import EFFICIENCY, POSE_NEES, POSITION, TIME, difference_by
from stereo_slam_env.evaluation.run_figures import common_keys, figures_of

from ....synthetic_runs import THREE, make_runs, scored


def test_the_figures_of_the_runs_are_those_of_the_summary():
    runs = make_runs(THREE[:2], seeds=range(3), frames=40)
    (first, _), figures = scored(runs)
    keys = common_keys(*figures.values())
    assert keys == [("drive-0", 0), ("drive-1", 1), ("drive-2", 2)]
    assert tuple(figures["inverse-depth"].values(POSITION, keys)) == first.position_rmse_by_run
    assert figures["inverse-depth"].values(POSE_NEES, keys).mean() == pytest.approx(first.pose_anees / 6)
    assert np.isnan(figures["inverse-depth"].values(EFFICIENCY, keys)).all()
    assert not figures["inverse-depth"].diverged(keys).any()


def test_larger_efficiency_is_better():
    ours = np.linspace(80, 95, 8)
    assert difference_by(EFFICIENCY, ours, 0.7 * ours + np.arange(8) / 100).finding is Finding.BETTER
    assert difference_by(TIME, ours, 0.7 * ours + np.arange(8) / 100).finding is Finding.WORSE


def nees_by_run(rng, runs, factor_a, factor_b):
    """Two filters on the same recordings: most of their errors is common."""
    common, own = rng.standard_normal((runs, 24)), rng.standard_normal((2, runs, 24))
    a, b = ((0.9 * common + np.sqrt(0.19) * noise) ** 2 for noise in own)
    return factor_a * a.mean(axis=1), factor_b * b.mean(axis=1)


def test_consistency_is_the_distance_of_the_mean_nees_from_its_ideal():
    a, b = nees_by_run(np.random.default_rng(0), 20, 1.5, 0.95)
    difference = difference_by(POSE_NEES, a, b)
    assert difference.estimate == pytest.approx(abs(np.log(a.mean())) - abs(np.log(b.mean())))
    assert difference.finding is Finding.WORSE
    assert difference_by(POSE_NEES, b, a) == difference.reversed


@pytest.mark.parametrize("factors", [(1.0, 1.0), (1.3, 1.3), (1.2, 1 / 1.2)], ids=str)
def test_filters_equally_far_from_their_ideal_are_not_ranked(factors):
    rng = np.random.default_rng(1)
    alarms = [difference_by(POSE_NEES, *nees_by_run(rng, 10, *factors)).shown for _ in range(150)]
    assert np.mean(alarms) < 0.09


def test_which_runs_diverged_has_no_limit_of_its_own():
    """A caller that forgets the limit of the scenario is told so, instead of being given another one."""
    with pytest.raises(TypeError, match="divergence_percent"):
        figures_of(make_runs(THREE[:1], seeds=range(1), frames=20))


def test_a_recording_is_run_once_a_filter():
    runs = make_runs(THREE[:1], seeds=range(1), frames=20)
    with pytest.raises(ValueError, match=r"each recording once a filter: inverse-depth ran twice on \('drive-0', 0\)"):
        figures_of([*runs, *runs], divergence_percent=10.0)
