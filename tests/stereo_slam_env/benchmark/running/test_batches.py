"""Batches: the bits of one by one; what goes wrong in one is what goes wrong alone (30 s)."""

import json
import os
import sqlite3
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from filters.catalogue.registry import named_filters
from stereo_slam_env.benchmark import Scenario, preset_study, run_benchmark
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource, StreetSource
from stereo_slam_env.benchmark.running import tasks
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice
from stereo_slam_env.benchmark.scenarios.streams import make_recording, make_recordings
from stereo_slam_env.benchmark.storage.run_files import load_run
from stereo_slam_env.recording.archive import packed_recording

from ...evaluation.test_batch_run import plain

OURS = sorted(name for name in named_filters() if name != "inertial")  # whose samples no scenario has
SHORT = Scenario("short", ReferenceSource("short_turn"), seeds=tuple(range(5)), frames=5, gate=None, metrics=("map",))


def quick(**changes):
    (cell,) = preset_study("quick").cells
    return cell.scenario.replaced(**{"frames": 60, "seeds": (0, 1, 2), **changes})


@pytest.fixture
def few_are_timed(monkeypatch):
    from stereo_slam_env.benchmark import campaign

    monkeypatch.setattr(campaign, "TIMED", 1)


def rows_of(out):
    with closing(sqlite3.connect(out / "trials.sqlite")) as database:
        database.row_factory = sqlite3.Row
        return [dict(row) for row in database.execute("select * from trials order by filter, seed")]


def of_times(name):
    return name.startswith("ms_") or name == "memory_mb"


def assert_same_trials(out, other):
    """Every stored number but times, to the bit."""
    paths = sorted(path.relative_to(out) for path in out.glob("trials/*/*.npz"))
    assert paths == sorted(path.relative_to(other) for path in other.glob("trials/*/*.npz")) != []
    for path in paths:
        one, two = load_run(out / path), load_run(other / path)
        assert plain(one.run) == plain(two.run), path
        figures = [{k: v for k, v in stored.score.figures.items() if not of_times(k)} for stored in (one, two)]
        assert plain(figures[0]) == plain(figures[1]), path
        assert plain(one.score.segments) == plain(two.score.segments), path
    for kind in ("recordings", "bounds"):
        kept = sorted(path.relative_to(out) for path in out.rglob("*.npz") if kind in path.parts)
        assert kept
        assert all((out / path).read_bytes() == (other / path).read_bytes() for path in kept), kind
    for row, same in zip(rows_of(out), rows_of(other), strict=True):
        assert {k: v for k, v in row.items() if not of_times(k)} == {k: v for k, v in same.items() if not of_times(k)}


def test_recordings_made_at_once_have_the_bytes_of_those_made_one_by_one():
    """Also with traffic, corruptions and odometry; a street each."""
    source = StreetSource({"route": "right-turn", "moving_cars": 3, "noise": "heavy-tailed"})
    corrupted = quick(source=source, corruptions=({"kind": "outliers", "share": 0.1},), frames=40)
    for scenario in (quick(), corrupted):
        seeds = (3, 0, 11)
        made = [packed_recording(recording) for recording in make_recordings(scenario, seeds)]
        assert made == [packed_recording(make_recording(scenario, seed)) for seed in seeds]


def test_whole_drives_made_at_once_end_where_each_ends():
    scenario = quick(source=StreetSource({"route": "right-turn"}), frames=None)
    made = [packed_recording(recording) for recording in make_recordings(scenario, (0, 1))]
    assert made == [packed_recording(make_recording(scenario, seed)) for seed in (0, 1)]


@pytest.mark.timeout(300)
def test_a_study_in_batches_has_the_figures_of_one_by_one(tmp_path, monkeypatch, few_are_timed):
    """All shipped filters on the streets of the preset."""
    scenario = quick(filters=tuple(map(filter_choice, OURS)), frames=25)
    run_benchmark(scenario, tmp_path / "batches", jobs=1)
    monkeypatch.setattr("stereo_slam_env.benchmark.running.tasks.goes_in_a_batch", lambda task: False)
    run_benchmark(scenario, tmp_path / "alone", jobs=1)
    assert_same_trials(tmp_path / "batches", tmp_path / "alone")


def test_times_are_those_of_the_drives_that_were_run_one_by_one(tmp_path, few_are_timed):
    result = run_benchmark(quick(frames=20), tmp_path / "out", jobs=1)
    for run in result.runs:
        assert np.isfinite(run.milliseconds[1:]).all() == (run.seed == 0)
    for summary in result.summaries:
        alone = result.figures[summary.filter_name].of_run
        (timed,) = [row["ms_per_frame"] for row in alone.values() if row["ms_per_frame"] is not None]
        assert summary.ms_per_frame == pytest.approx(timed)
        assert (summary.timed, summary.runs) == (1, 3)


def test_strangers_and_the_first_drives_are_run_one_by_one():
    task = tasks.Task(0, quick(), 3, filter_choice("inverse-depth"), b"", timed=False)
    assert tasks.goes_in_a_batch(task)
    assert not tasks.goes_in_a_batch(replace(task, timed=True))
    assert not tasks.goes_in_a_batch(replace(task, choice=filter_choice("listens")))
    assert not tasks.goes_in_a_batch(replace(task, scenario=quick().replaced(metrics=("windows",))))


@pytest.mark.parametrize("how", ["crash", "raise"])
def test_a_batch_that_fails_is_done_one_by_one(tmp_path, monkeypatch, few_are_timed, how):
    """What takes the process of a batch down takes nothing else down."""

    def fail(*_, **__):
        if how == "crash":
            os._exit(7)
        raise ArithmeticError("in the batch")

    scenario = SHORT.replaced(filters=tuple(map(filter_choice, ("inverse-depth", "euclidean"))))
    monkeypatch.setattr("stereo_slam_env.benchmark.running.tasks._filter_all", fail)
    result = run_benchmark(scenario, tmp_path / "out", jobs=1)
    assert all(run.failure is None for run in result.runs)
    assert [summary.timed for summary in result.summaries] == [5, 5]


def test_an_interrupted_campaign_goes_on_where_it_stopped(tmp_path, few_are_timed):
    def stop_after_a_batch(done, total):
        if done >= 2 + 5:
            raise KeyboardInterrupt

    scenario = SHORT.replaced(filters=tuple(map(filter_choice, ("inverse-depth", "euclidean"))))
    with pytest.raises(KeyboardInterrupt):
        run_benchmark(scenario, tmp_path / "out", jobs=1, progress=stop_after_a_batch)
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("trials/*/*.npz")}
    assert 0 < len(kept) < 10
    run_benchmark(scenario, tmp_path / "out", jobs=2)
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    run_benchmark(scenario, tmp_path / "whole", jobs=2)
    resumed, whole = (json.loads((tmp_path / out / "summary.json").read_text())["filters"] for out in ("out", "whole"))
    for label, row in whole.items():
        assert row["position_rmse_by_run"] == resumed[label]["position_rmse_by_run"]
