"""The table of figures: the row of one trial, and every place that shows a figure (6 s)."""

import io
import json
import re
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from filters.geometry import rotations
from stereo_slam_env.benchmark import FilterChoice, ReferenceSource, Scenario, run_benchmark
from stereo_slam_env.evaluation.cramer_rao import cramer_rao_bound
from stereo_slam_env.evaluation.figures import FIGURES, LARGEST, Figure, readable, trial_columns, trial_figures
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.trial import Trial
from stereo_slam_env.report.console import show_results
from stereo_slam_env.report.page import on_page
from stereo_slam_env.report.tables import figures_table

from ...synthetic_runs import scored
from ..benchmark.small_recordings import small_recording
from .test_cramer_rao import MOTION

KINDS = {"text": str, "integer": int, "real": float}


def row_of(run, divergence_percent=10.0, bound=None):
    return trial_figures(Trial(run, divergence_percent, bound))


@pytest.fixture(scope="module")
def plain():
    return run_filter(small_recording(frames=30), "inverse-depth", seed=4, label="mine")


def test_the_row_has_the_documented_columns_of_the_documented_kinds(plain):
    row = row_of(plain, bound=cramer_rao_bound(small_recording(frames=30), MOTION))
    assert list(row) == [figure.name for figure in trial_columns() if not figure.is_optional]
    not_scored = {name for name in row if "window" in name or "floor" in name}
    assert {row[name] for name in not_scored} == {None}
    for name, value in row.items():
        if name not in ("failure", "alarm_s", "alarm") and name not in not_scored:
            assert type(value) is KINDS[FIGURES[name].kind], name
    assert row["failure"] is row["alarm_s"] is row["alarm"] is None
    assert (row["filter"], row["recording"], row["seed"], row["frames"]) == ("mine", "small", 4, 29)


def test_its_figures_are_those_of_the_run(plain):
    off = replace(
        plain,
        positions=plain.true_positions + np.array([0.3, 0.0, 0.4]),
        linear_velocities=plain.true_linear_velocities + np.array([0.0, 0.5, 1.2]),
    )
    row = row_of(off)
    assert row["position_rmse_m"] == pytest.approx(0.5)
    assert row["end_error_m"] == pytest.approx(0.5)
    assert row["velocity_rmse_m_s"] == pytest.approx(1.3)
    assert row["path_m"] == pytest.approx(0.5 * 28, rel=1e-3)
    assert row["end_drift_percent"] == pytest.approx(100 * 0.5 / row["path_m"])
    R_wc, P = rotations.matrix(plain.orientations[-1]), plain.pose_covariances[-1, :3, :3]
    ahead = R_wc[:, 2]
    signed = -(ahead @ [0.3, 0.0, 0.4]) / np.sqrt(ahead @ P @ ahead)
    assert row["end_forward_error_sigma"] == pytest.approx(signed)
    assert row["position_anees"] == pytest.approx(plain.position_nees[1:].mean())
    assert row["updated"] == plain.counts["updated"].sum()
    assert row["diverged"] == 0
    assert row_of(off, divergence_percent=1.0)["diverged"] == 1


def test_a_row_and_the_summary_of_its_run_say_the_same(plain):
    bound = cramer_rao_bound(small_recording(frames=30), MOTION)
    row, summary = (row_of(plain, bound=bound), scored([plain], bounds={("small", 4): bound})[0][0].figures)
    shared = [name for name in row if name in summary and name not in ("failure",)]
    assert len(shared) > 20
    for name in shared:
        assert row[name] == pytest.approx(summary[name]), name


def test_a_failed_run_has_its_events_and_nothing_else(plain):
    row = row_of(replace(plain, failure="frame 2: oops"))
    assert (row["diverged"], row["failure"], row["frames"]) == (1, "frame 2: oops", 0)
    assert row["updated"] == plain.counts["updated"].sum()
    known = {name for name, value in row.items() if value is not None and FIGURES[name].kind == "real"}
    assert known == set()


def test_without_truth_what_it_is_needed_for_is_none():
    row = row_of(run_filter(small_recording(truth=False), "inverse-depth"))
    for name in ("seed", "position_rmse_m", "pose_anees", "landmark_anees", "rpe_translation_percent", "path_m"):
        assert row[name] is None, name
    for name in ("nis", "ms_per_frame", "map_size", "state_size"):
        assert row[name] is not None, name
    assert (row["frames"], row["rpe_segments"], row["diverged"]) == (0, 0, 0)


def test_a_bound_of_another_recording_is_refused(plain):
    with pytest.raises(ValueError, match="bound must have one entry a frame: 12 entries, 30 frames"):
        row_of(plain, bound=cramer_rao_bound(small_recording(frames=12), MOTION))


def test_the_manual_names_every_figure():
    manual = (Path(__file__).parents[3] / "docs" / "metrics.md").read_text(encoding="utf-8")
    assert [name for name in FIGURES if f"`{name}`" not in manual] == []


def largest_error(trial):
    return np.linalg.norm(trial.run.positions - trial.run.true_positions, axis=1)[trial.scored].max()


MEANING = "largest position error of the scored frames"
GAP = Figure("largest_error_m", "largest position error", "m", "accuracy", MEANING, largest_error, LARGEST)


def test_a_figure_added_to_the_table_is_everywhere(tmp_path, monkeypatch):
    monkeypatch.setitem(FIGURES, GAP.name, GAP)
    scenario = Scenario("tiny", ReferenceSource("short_turn", {"landmarks": 12}), seeds=(0, 1), frames=5, gate=None)
    result = run_benchmark(scenario, tmp_path / "out", filters=[FilterChoice("ours", "euclidean")], jobs=1)
    largest = result.summaries[0].largest_error_m
    assert largest > result.summaries[0].position_rmse_m
    summary = json.loads((result.out / "summary.json").read_text(encoding="utf-8"))
    assert summary["filters"]["ours"]["largest_error_m"] == largest
    with closing(sqlite3.connect(result.out / "trials.sqlite")) as database:
        assert database.execute("SELECT max(largest_error_m) FROM trials").fetchone() == (largest,)
        about = database.execute("SELECT unit, meaning FROM columns WHERE name = 'largest_error_m'").fetchone()
    assert about == ("m", GAP.meaning)
    console = Console(file=io.StringIO(), width=120)
    show_results(console, result.summaries)
    assert re.search(
        rf"^largest position error, m +{re.escape(GAP.text(largest))} *$", console.file.getvalue(), re.MULTILINE
    )
    report = on_page(figures_table(result.summaries, ["accuracy"]))
    assert "Largest position error<small>m</small>" in report
    assert f">{GAP.text(largest)}</td>" in report


@pytest.mark.parametrize(
    "figure", [figure for figure in FIGURES.values() if figure.ideal], ids=lambda figure: figure.name
)
def test_what_a_consistent_filter_has_is_shown_as_one_and_twice_that_as_two(figure):
    assert figure.of({figure.name: figure.ideal}) == 1.0
    assert figure.of({figure.name: 2.0 * figure.ideal}) == 2.0
    assert figure.text(figure.ideal).startswith("1")
    assert figure.ideal == 1.0 or figure.label.endswith(f" / {figure.ideal:g}")


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        *(("position_rmse_m", 0.000312, "0.000312"), ("position_rmse_m", 0.0312, "0.0312")),
        *(("position_rmse_m", 0.155, "0.155"), ("position_rmse_m", 3.25, "3.250")),
        *(("position_rmse_m", 0.0000031, "3.10·10⁻⁶"), ("position_rmse_m", 0.0, "0.000")),
        *(("position_rmse_m", 17_123.0, "17,000"), ("position_rmse_m", 1.7e9, "1.7·10⁹")),
        *(("pose_anees", 6.3, "1.05"), ("pose_anees", 0.12, "0.020"), ("position_rmse_m", None, "–")),
        *(("efficiency_percent", 93.4, "93"), ("efficiency_percent", 0.42, "0.4")),
        *(("rejected", 3, "3"), ("rejected", 0, "0"), (None, 0.0834, "0.0834"), (None, 999.6, "1,000")),
        *((None, 1234.5, "1,230"), (None, 17_123.0, "17,000"), (None, -320_000.0, "-320,000"), (None, 0.0, "0")),
        *((None, 1.4e9, "1.4·10⁹"), (None, -2.5e-12, "-2.5·10⁻¹²"), (None, np.nan, "–"), (None, None, "–")),
    ],
)
def test_numbers_for_people_have_digits_that_count_and_no_exponents_of_programs(name, value, text):
    """Those of a figure, or any others."""
    assert (readable(value) if name is None else FIGURES[name].text(value)) == text
