"""From runs with known errors to the row of a filter (0.5 s)."""

from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.evaluation.cramer_rao import Bound
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.landmark_statistics import LandmarkStatistics
from stereo_slam_env.evaluation.run_figures import RunFigures, score_of, summarise

from ...synthetic_runs import scored, summary_of
from ..benchmark.small_recordings import small_recording


@pytest.fixture(scope="module")
def plain():
    return run_filter(small_recording(), "inverse-depth", seed=0)


def off_by(run, offset, **changes):
    """The run with a constant position error."""
    return replace(run, positions=run.true_positions + np.asarray(offset, dtype=float), **changes)


def test_position_errors_are_combined_over_runs(plain):
    row = summary_of([off_by(plain, [0.3, 0, 0.4]), off_by(plain, [0, 0, 1.2], seed=1)])
    assert row.position_rmse_by_run == pytest.approx((0.5, 1.2))
    assert row.position_rmse_m == pytest.approx(np.sqrt((0.25 + 1.44) / 2))
    assert row.ate_rigid_m == pytest.approx(0.0, abs=1e-6)
    length = np.linalg.norm(np.diff(plain.true_positions[1:], axis=0), axis=1).sum()
    assert row.end_drift_percent == pytest.approx(100 * (0.5 + 1.2) / 2 / length)
    assert (row.runs, row.frames) == (2, 2 * (len(plain) - 1))
    positions = plain.true_positions.copy()
    positions[0] += 100.0  # the first frame is not scored
    assert summary_of([replace(plain, positions=positions)]).position_rmse_m == 0.0


def test_nees_is_averaged_over_runs_before_it_is_compared_with_the_band(plain):
    low, high = (replace(plain, pose_nees=np.full(len(plain), value)) for value in (1.0, 11.0))
    row = summary_of([low, high])
    assert row.pose_anees == 6.0
    assert row.frames_in_band_percent == 100.0
    assert row.pose_anees_band == pytest.approx((2.20, 11.67), abs=0.01)
    assert summary_of([low]).frames_in_band_percent == 0.0


def test_nis_is_per_degree_of_freedom(plain):
    row = summary_of([replace(plain, nis=3.0 * plain.nis_dof)])
    assert row.nis == pytest.approx(3.0)


@pytest.mark.parametrize(("updated", "gated", "percent"), [(9, 1, 10.0), (5, 5, 50.0), (0, 4, 100.0), (0, 0, None)])
def test_gated_is_a_share_of_the_known_measurements(plain, updated, gated, percent):
    counts = dict(plain.counts, updated=np.full(len(plain), updated), gated=np.full(len(plain), gated))
    assert summary_of([replace(plain, counts=counts)]).gated_percent == percent


def test_a_failed_run_counts_as_diverged_and_spoils_nothing(plain):
    failed = replace(plain, seed=3, positions=np.full_like(plain.positions, np.nan), failure="frame 2: oops")
    row = summary_of([plain, failed])
    alone = summary_of([plain])
    assert row.diverged == 1
    assert row.failures == ("seed 3, frame 2: oops",)
    assert row.position_rmse_m == alone.position_rmse_m
    assert np.isnan(row.position_rmse_by_run[1])
    assert row.pose_anees_band == alone.pose_anees_band


def test_far_from_the_truth_at_the_end_is_divergence(plain):
    lost = off_by(plain, [0.0, 0.0, 2.0])
    assert summary_of([lost], divergence_percent=10.0).diverged == 1
    assert summary_of([lost], divergence_percent=90.0).diverged == 0
    assert score_of(lost, divergence_percent=90.0).judged(10.0).figures["diverged"] == 1


def test_what_is_not_known_is_none(plain):
    row = summary_of([run_filter(small_recording(truth=False), "inverse-depth")])
    errors = ("position_rmse_m", "ate_rigid_m", "end_drift_percent", "rpe_translation_percent", "efficiency_percent")
    for name in (*errors, "pose_anees", "pose_anees_band", "landmark_anees"):
        assert getattr(row, name) is None, name
    assert row.nis is not None
    assert set(row.consistency) == {"nis"}
    assert (row.frames, row.rpe, row.landmark_by_range, row.depth_convergence) == (0, (), (), ())
    failed = summary_of([replace(plain, failure="start: no")])
    assert (failed.diverged, failed.position_rmse_m, failed.pose_anees_band) == (1, None, None)


def limit(run, sigma):
    """The same standard deviation of every axis of position (m) and rotation (deg) in every frame."""
    deviations = np.repeat([sigma, np.deg2rad(sigma)], 3)
    return Bound(np.tile(np.diag(deviations**2), (len(run), 1, 1)))


def test_efficiency_is_the_bound_over_the_error_where_both_are_known(plain):
    near, far = off_by(plain, [0.5, 0, 0]), off_by(plain, [0, 0, 1.0], seed=1)
    bounds = {("small", 0): limit(plain, 0.4 / np.sqrt(3))}
    row = summary_of([near, far], bounds=bounds)
    assert row.bound_position_m == pytest.approx(0.4)
    assert row.bound_rotation_deg == pytest.approx(0.4)
    assert row.efficiency_percent == pytest.approx(80.0)
    assert row.efficiency_by_run == pytest.approx((80.0, np.nan), nan_ok=True)
    bounds["small", 1] = limit(plain, 0.8 / np.sqrt(3))
    assert summary_of([near, far], bounds=bounds).efficiency_percent == pytest.approx(80.0)
    row = summary_of([near, far])
    assert (row.bound_position_m, row.efficiency_percent, row.efficiency_by_run) == (None, None, ())


def test_relative_errors_are_weighted_by_their_segments(plain):
    """Two drives of 15 m and 40 m: every segment counts once, whichever run it is of."""
    short, long = (drive(plain, rows, 1.0 + error) for rows, error in ((16, 0.01), (41, 0.04)))
    row = summary_of([short, long])
    assert [(part.length_m, part.segments) for part in row.rpe] == [(5.0, 1 + 4), (10.0, 3)]
    assert row.rpe[0].translation_percent == pytest.approx(6 / 5 * (1 * 1.0 + 4 * 4.0) / 5)
    every = [6 / 5 * 1.0] + 4 * [6 / 5 * 4.0] + 3 * [11 / 10 * 4.0]
    assert row.rpe_translation_percent == pytest.approx(np.mean(every))
    assert row.rpe_rotation_deg_per_100m == pytest.approx(0.0, abs=1e-6)


def drive(run, rows, scale):
    """A metre a frame along z, with an error of scale."""
    along = np.outer(np.arange(float(rows)), [0.0, 0.0, 1.0])
    ahead = np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1))
    grown = {
        name: np.resize(value, (rows, *value.shape[1:]))
        for name, value in vars(run).items()
        if isinstance(value, np.ndarray)
    }
    poses = {"positions": scale * along, "true_positions": along, "orientations": ahead, "true_orientations": ahead}
    counts = {name: np.resize(values, rows) for name, values in run.counts.items()}
    return replace(run, **{**grown, **poses}, counts=counts)


def test_landmarks_are_weighted_by_their_number(plain):
    few, many = (
        replace(plain, landmark_statistics=LandmarkStatistics(nees_count=count, nees=nees * count))
        for count, nees in ((np.full(5, 1.0), 2.0), (np.full(5, 9.0), 4.0))
    )
    row = summary_of([few, many])
    assert row.landmark_anees == pytest.approx(3.8)
    assert [part.anees for part in row.landmark_by_range] == pytest.approx([3.8] * 5)


def test_costs_are_medians_over_frames_and_the_largest_memory(plain):
    slow = {
        "predict_milliseconds": np.full(len(plain), 1.0),
        "update_milliseconds": np.full(len(plain), 4.0),
        "state_size": np.full(len(plain), 90.0),
    }
    row = summary_of([replace(plain, memory_mb=3.0, **slow), replace(plain, memory_mb=7.0, **slow)])
    assert (row.ms_predict, row.ms_update, row.state_size, row.memory_mb) == (1.0, 4.0, 90.0, 7.0)


def test_filters_are_summarised_apart_in_their_order(plain):
    other = replace(plain, filter_name="other")
    assert [row.filter_name for row in scored([other, plain, replace(other, seed=1)])[0]] == ["other", "inverse-depth"]
    with pytest.raises(ValueError, match="of one filter, got inverse-depth, other"):
        summarise([plain, other], RunFigures({}))
    with pytest.raises(ValueError, match="at least one run"):
        summarise([], RunFigures({}))
