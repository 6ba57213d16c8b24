"""The row of one trial (0.5 s)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stereo_slam_env.evaluation.cramer_rao import cramer_rao_bound
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.trial_metrics import COLUMNS, trial_figures

from ...synthetic_runs import scored
from ..benchmark.small_recordings import small_recording
from .test_cramer_rao import MOTION

KINDS = {"text": str, "integer": int, "real": float}


@pytest.fixture(scope="module")
def plain():
    return run_filter(small_recording(frames=30), "inverse-depth", seed=4, label="mine")


def test_the_row_has_the_documented_columns_of_the_documented_kinds(plain):
    row = trial_figures(plain, divergence_percent=10.0, bound=cramer_rao_bound(small_recording(frames=30), MOTION))
    assert list(row) == list(COLUMNS)
    for name, value in row.items():
        if name not in ("failure", "alarm_s", "alarm"):
            assert type(value) is KINDS[COLUMNS[name].kind], name
    assert row["failure"] is row["alarm_s"] is row["alarm"] is None
    assert (row["filter"], row["recording"], row["seed"], row["frames"]) == ("mine", "small", 4, 29)


def test_its_figures_are_those_of_the_run(plain):
    off = replace(plain, positions=plain.true_positions + np.array([0.3, 0.0, 0.4]))
    row = trial_figures(off, divergence_percent=10.0)
    assert row["position_rmse_m"] == pytest.approx(0.5)
    assert row["end_error_m"] == pytest.approx(0.5)
    assert row["path_m"] == pytest.approx(0.5 * 28, rel=1e-3)
    assert row["end_drift_percent"] == pytest.approx(100 * 0.5 / row["path_m"])
    assert row["position_anees"] == pytest.approx(plain.position_nees[1:].mean())
    assert row["updated"] == plain.counts["updated"].sum()
    assert row["diverged"] == 0
    assert trial_figures(off, divergence_percent=1.0)["diverged"] == 1


def test_a_row_and_the_summary_of_its_run_say_the_same(plain):
    bound = cramer_rao_bound(small_recording(frames=30), MOTION)
    row, summary = (
        trial_figures(plain, divergence_percent=10.0, bound=bound),
        vars(scored([plain], bounds={("small", 4): bound})[0][0]),
    )
    shared = [name for name in row if name in summary and name not in ("failure",)]
    assert len(shared) > 20
    for name in shared:
        assert row[name] == pytest.approx(summary[name]), name


def test_a_failed_run_has_its_events_and_nothing_else(plain):
    row = trial_figures(replace(plain, failure="frame 2: oops"), divergence_percent=10.0)
    assert (row["diverged"], row["failure"], row["frames"]) == (1, "frame 2: oops", 0)
    assert row["updated"] == plain.counts["updated"].sum()
    known = {name for name, value in row.items() if value is not None and COLUMNS[name].kind == "real"}
    assert known == set()


def test_without_truth_what_it_is_needed_for_is_none():
    row = trial_figures(run_filter(small_recording(truth=False), "inverse-depth"), divergence_percent=10.0)
    for name in ("seed", "position_rmse_m", "pose_anees", "landmark_anees", "rpe_translation_percent", "path_m"):
        assert row[name] is None, name
    for name in ("nis", "ms_per_frame", "map_size", "state_size"):
        assert row[name] is not None, name
    assert (row["frames"], row["rpe_segments"], row["diverged"]) == (0, 0, 0)


def test_a_bound_of_another_recording_is_refused(plain):
    with pytest.raises(ValueError, match="bound must have one entry a frame: 12 entries, 30 frames"):
        trial_figures(plain, divergence_percent=10.0, bound=cramer_rao_bound(small_recording(frames=12), MOTION))


def test_the_manual_has_the_table_of_the_columns():
    manual = (Path(__file__).parents[3] / "docs" / "metrics.md").read_text(encoding="utf-8")
    rows = [f"| `{name}` | {column.unit} | {column.kind} | {column.meaning} |" for name, column in COLUMNS.items()]
    assert "\n".join(rows) + "\n" in manual
