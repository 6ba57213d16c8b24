"""The trial table, read without our code (1 s)."""

import sqlite3
from contextlib import closing

import pytest

from stereo_slam_env.benchmark import FilterChoice, Scenario, run_benchmark
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.study import study_from
from stereo_slam_env.benchmark.storage import result_tables
from stereo_slam_env.benchmark.storage.result_tables import SCHEMA, write_trial_table
from stereo_slam_env.evaluation.figures import trial_columns

BASE = Scenario("grid", ReferenceSource("short_turn"), seeds=(0, 1), gate=None, metrics=("map",)).as_dict()
FILTERS = [{"name": "euclidean", "options": {"min_disparity": 5.0}}]
GRID = {"options.sigma": [1.0, 2.0], "frames": [4]}
STUDY = study_from({**BASE, "filters": FILTERS, "frames": False, "grid": GRID})


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run_benchmark(STUDY, tmp_path_factory.mktemp("table") / "out", jobs=1)


def rows(path, query):
    with closing(sqlite3.connect(path)) as database:
        return database.execute(query).fetchall()


def test_one_row_a_trial_with_the_factors_as_columns(finished):
    path = finished.out / "trials.sqlite"
    columns = 'cell, "factor.options.sigma", "factor.frames", filter, seed, position_rmse_m, series'
    found = rows(path, f"SELECT {columns} FROM trials")
    assert all((finished.out / row[6]).is_file() for row in found)
    assert [row[:5] for row in found] == [
        (f"sigma-{sigma}_frames-4", sigma, 4, "euclidean", seed) for sigma in (1.0, 2.0) for seed in (0, 1)
    ]
    assert [row[5] for row in found] == [s for cell in finished.cells for s in cell.summaries[0].position_rmse_by_run]


def test_every_column_is_explained(finished):
    path = finished.out / "trials.sqlite"
    names = [row[1] for row in rows(path, "PRAGMA table_info(trials)")]
    meanings = {name: (unit, meaning) for name, unit, meaning in rows(path, "SELECT * FROM columns")}
    assert list(meanings) == names
    assert {figure.column for figure in trial_columns() if not figure.is_optional} <= set(names)
    assert meanings["pose_anees_per_dof"][1].endswith("here by 6, so 1 is ideal")
    assert all(meaning for _, meaning in meanings.values())
    assert meanings["position_rmse_m"][0] == "m"
    assert rows(path, "PRAGMA user_version") == [(SCHEMA,)]


def test_pandas_and_polars_read_it(finished):
    pandas = pytest.importorskip("pandas", reason="needs pandas")
    polars = pytest.importorskip("polars", reason="needs polars")
    with closing(sqlite3.connect(finished.out / "trials.sqlite")) as database:
        table = pandas.read_sql("SELECT * FROM trials", database)
        same = polars.read_database("SELECT * FROM trials", database)
    assert table.groupby("factor.options.sigma").position_rmse_m.mean().diff().iloc[-1] > 0
    assert same["position_rmse_m"].to_list() == table.position_rmse_m.to_list()


def test_what_is_not_known_is_null(tmp_path):
    scenario = Scenario("s", ReferenceSource("short_turn"), frames=3, metrics=())
    run_benchmark(scenario, tmp_path / "out", filters=[FilterChoice("e", "euclidean")], jobs=1)
    path = tmp_path / "out" / "trials.sqlite"
    assert rows(path, "SELECT landmark_rmse_m, bound_position_m, failure FROM trials") == [(None, None, None)]


def test_a_table_that_cannot_be_written_leaves_the_old_one(finished, monkeypatch):
    path = finished.out / "trials.sqlite"
    before = path.read_bytes()
    monkeypatch.setattr(result_tables, "SCHEMA", "no number")
    with pytest.raises(OSError, match=r"trials\.sqlite cannot be written"):
        write_trial_table(path, finished.cells)
    assert path.read_bytes() == before
    assert [p.name for p in finished.out.glob("*.part")] == []
