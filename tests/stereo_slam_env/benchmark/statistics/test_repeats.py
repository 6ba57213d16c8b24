"""Systems that are run several times on each recording (1 s)."""

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.differences import Finding
from stereo_slam_env.benchmark.statistics.measures import POSE_NEES, POSITION, compare_systems, run_spread, systems
from stereo_slam_env.evaluation.run_figures import RunFigures


def figures(values):
    """Of one filter: (K,) errors, one a recording, and NEES that are six times as large."""
    return RunFigures(
        {("drive", k): {"position_rmse_m": value, "pose_anees": 6.0 * value} for k, value in enumerate(values)}
    )


def campaign(count=10, runs=3, gap=1.2, within=0.2, seed=0):
    """A filter, and a system with errors `gap` times as large, whose runs scatter."""
    rng = np.random.default_rng(seed)
    hard = np.exp(0.5 * rng.standard_normal(count))
    noisy = {f"theirs+{k + 1}": figures(gap * hard * np.exp(within * rng.standard_normal(count))) for k in range(runs)}
    return {"ours": figures(hard), **noisy}


def test_runs_of_a_system_are_told_by_their_labels():
    assert systems(["a", "b+1", "b+2", "c+x"]) == {"a": ("a",), "b": ("b+1", "b+2"), "c+x": ("c+x",)}
    assert compare_systems({"a": figures([1.0]), "b": figures([1.0])}) is None


def test_the_difference_is_that_of_the_geometric_means_over_runs_and_recordings_the_sample():
    found = campaign()
    compared = compare_systems(found, measures=(POSITION,))
    assert compared.filters == ("ours", "theirs")
    difference = compared.cell(POSITION, "theirs", "ours")
    logs = [
        np.log([found[f"theirs+{k}"].of_run[key]["position_rmse_m"] / row["position_rmse_m"] for k in (1, 2, 3)]).mean()
        for key, row in found["ours"].of_run.items()
    ]
    assert difference.count == 10
    assert difference.estimate == pytest.approx(np.mean(logs))
    assert difference.finding is Finding.WORSE


def test_more_runs_make_no_more_recordings():
    """Five recordings are too few for a test, however often they are run."""
    assert not compare_systems(campaign(count=5, runs=20), measures=(POSITION,)).cell(POSITION, "theirs", "ours").shown


def test_a_recording_that_only_one_has_is_left_out_and_nees_are_averaged():
    found = {"a": figures([1.0, 1.0]), "b+1": figures([0.5, 3.0, 9.0]), "b+2": figures([1.5, 5.0, 9.0])}
    assert compare_systems(found, measures=(POSITION,)).cell(POSITION, "b", "a").count == 2
    assert compare_systems(found, measures=(POSE_NEES,)).cell(POSE_NEES, "b", "a").count == 2


def test_the_spread_is_that_of_runs_on_the_same_recording():
    found = campaign(count=400, runs=4, within=0.2)
    assert run_spread(found, systems(list(found))["theirs"]) == pytest.approx(0.2, rel=0.05)
    assert np.isnan(run_spread(found, ["ours"]))
