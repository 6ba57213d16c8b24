"""From runs with known errors to the row of a filter (0.5 s)."""

from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.benchmark.runner import run_filter
from stereo_slam_env.benchmark.summary import summarise, summarise_all

from .small_recordings import small_recording


@pytest.fixture(scope="module")
def plain():
    return run_filter(small_recording(), "inverse-depth", seed=0)


def off_by(run, offset, **changes):
    """The run with a constant position error."""
    return replace(run, positions=run.true_positions + np.asarray(offset, dtype=float), **changes)


def test_position_errors_are_combined_over_runs(plain):
    row = summarise([off_by(plain, [0.3, 0, 0.4]), off_by(plain, [0, 0, 1.2], seed=1)])
    assert row.position_rmse_by_run == pytest.approx((0.5, 1.2))
    assert row.position_rmse_m == pytest.approx(np.sqrt((0.25 + 1.44) / 2))
    assert row.ate_rigid_m == pytest.approx(0.0, abs=1e-6)
    length = np.linalg.norm(np.diff(plain.true_positions[1:], axis=0), axis=1).sum()
    assert row.end_drift_percent == pytest.approx(100 * (0.5 + 1.2) / 2 / length)
    assert (row.runs, row.frames) == (2, 2 * (len(plain) - 1))


def test_the_first_frame_is_not_scored(plain):
    positions = plain.true_positions.copy()
    positions[0] += 100.0
    assert summarise([replace(plain, positions=positions)]).position_rmse_m == 0.0


def test_nees_is_averaged_over_runs_before_it_is_compared_with_the_band(plain):
    low, high = (replace(plain, pose_nees=np.full(len(plain), value)) for value in (1.0, 11.0))
    row = summarise([low, high])
    assert row.pose_anees == 6.0
    assert row.frames_in_band_percent == 100.0
    assert row.pose_anees_band == pytest.approx((2.20, 11.67), abs=0.01)
    assert summarise([low]).frames_in_band_percent == 0.0


def test_nis_is_per_degree_of_freedom(plain):
    row = summarise([replace(plain, nis=3.0 * plain.nis_dof)])
    assert row.nis == pytest.approx(3.0)


def test_gated_is_a_share_of_the_known_measurements(plain):
    counts = dict(plain.counts, updated=np.full(len(plain), 9), gated=np.full(len(plain), 1))
    assert summarise([replace(plain, counts=counts)]).gated_percent == pytest.approx(10.0)


def test_a_failed_run_counts_as_diverged_and_spoils_nothing(plain):
    failed = replace(plain, seed=3, positions=np.full_like(plain.positions, np.nan), failure="frame 2: oops")
    row = summarise([plain, failed])
    alone = summarise([plain])
    assert row.diverged == 1
    assert row.failures == ("seed 3, frame 2: oops",)
    assert row.position_rmse_m == alone.position_rmse_m
    assert np.isnan(row.position_rmse_by_run[1])
    assert row.pose_anees_band == alone.pose_anees_band


def test_far_from_the_truth_at_the_end_is_divergence(plain):
    lost = off_by(plain, [0.0, 0.0, 2.0])
    assert summarise([lost], divergence_percent=10.0).diverged == 1
    assert summarise([lost], divergence_percent=90.0).diverged == 0


def test_what_is_not_known_is_none():
    row = summarise([run_filter(small_recording(truth=False), "inverse-depth")])
    for name in (
        "position_rmse_m",
        "ate_rigid_m",
        "end_drift_percent",
        "pose_anees",
        "pose_anees_band",
        "landmark_anees",
    ):
        assert getattr(row, name) is None, name
    assert row.nis is not None
    assert row.frames == 0


def test_all_runs_failed(plain):
    row = summarise([replace(plain, failure="start: no")])
    assert (row.diverged, row.position_rmse_m, row.pose_anees_band) == (1, None, None)


def test_filters_are_summarised_apart_in_their_order(plain):
    other = replace(plain, filter_name="other")
    assert [row.filter_name for row in summarise_all([other, plain, other])] == ["other", "inverse-depth"]
    with pytest.raises(ValueError, match="of one filter, got inverse-depth, other"):
        summarise([plain, other])
    with pytest.raises(ValueError, match="at least one run"):
        summarise([])
