"""The run directory (1 s)."""

import csv
import json
from dataclasses import fields, replace

import numpy as np
import pytest

from filters.geometry import rotations
from stereo_slam_env.benchmark import run_benchmark
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import Scenario, filter_choice
from stereo_slam_env.benchmark.scenarios.streams import stream_digest
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.storage import store
from stereo_slam_env.benchmark.storage.result_tables import write_results
from stereo_slam_env.benchmark.storage.run_files import packed_run
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import FilterSummary
from stereo_slam_env.recording.archive import packed_recording

from ..small_recordings import small_recording

SCENARIO = Scenario(
    "small", ReferenceSource("short_turn"), filters=(filter_choice("euclidean"),), seeds=(0, 1), metrics=("map",)
)


def opened(out, scenario):
    """The only cell of a study of one scenario."""
    (directory,) = store.prepared_study(out, Study.of(scenario)).write_settings().cells
    return directory


def fill(out, scenario=SCENARIO, failure=None):
    """A finished run in `out`."""
    directory = opened(out, scenario)
    for seed, choice in directory.missing():
        recording = small_recording(seed)
        about = {"name": recording.name, "frames": len(recording), "R": recording.noise.R.tolist()}
        about["stream_sha256"] = stream_digest(recording)
        directory.save_recording(seed, packed_recording(recording), about)
        run = run_filter(recording, choice.name, choice.options, seed=seed, label=choice.label)
        content = packed_run(replace(run, failure=failure), directory.provenance(seed, choice))
        directory.save_trial(seed, choice, content)
    write_results(store.read_study(out))
    return directory


@pytest.fixture
def finished(tmp_path):
    return fill(tmp_path / "out")


def test_the_summary_has_the_designed_keys_and_every_other_figure(finished):
    summary = json.loads((finished.out / "summary.json").read_text())
    assert summary["version"] == store.VERSION
    row = summary["filters"]["euclidean"]
    designed = (
        "position_rmse_m ate_rigid_m end_drift_percent pose_anees pose_anees_band nis ms_per_frame frames diverged"
    )
    assert set(row) >= set(designed.split())
    assert set(row) >= {f.name for f in fields(FilterSummary)} - {"filter_name", "figures"}
    assert row["runs"] == 2
    assert [r["seed"] for r in summary["recordings"]] == [0, 1]


def test_nan_never_reaches_json(tmp_path):
    directory = fill(tmp_path / "out", failure="frame 3: gone")
    text = (directory.out / "summary.json").read_text()
    row = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in summary.json"))["filters"]["euclidean"]
    assert row["position_rmse_m"] is None
    assert row["position_rmse_by_run"] == [None, None]
    assert row["failures"] == ["seed 0, frame 3: gone", "seed 1, frame 3: gone"]


def test_the_table_is_written_as_csv_too(finished):
    text = (finished.out / "summary.csv").read_text()
    assert not set(text) & set("{}[]")
    (row,) = csv.DictReader(text.splitlines())
    summary = json.loads((finished.out / "summary.json").read_text())["filters"]["euclidean"]
    assert row["filter"] == "euclidean"
    assert float(row["ate_rigid_m"]) == summary["ate_rigid_m"]
    assert float(row["pose_anees_per_dof"]) == pytest.approx(summary["pose_anees"] / 6)
    low, high = (float(row[f"pose_anees_per_dof_{end}"]) for end in ("low", "high"))
    assert (low, high) == pytest.approx(tuple(end / 6 for end in summary["pose_anees_band"]))
    assert (row["runs"], row["failed"], row["option.min_disparity"]) == ("2", "0", "4.0")


def test_the_settings_are_the_exact_inputs(finished):
    settings = json.loads((finished.out / "settings.json").read_text())
    assert Scenario.from_dict(settings["scenario"]) == SCENARIO
    assert settings["versions"]["numpy"] == np.__version__
    assert settings["scenario"]["gate"] == 0.99
    assert settings["scenario"]["filters"][0]["options"] == {"min_disparity": 4.0}


def test_trajectories_are_in_the_formats_of_tum_and_kitti(finished):
    run = finished.load()[0][0]
    estimate = np.loadtxt(finished.out / "trajectories" / "seed-0000" / "euclidean.tum")
    np.testing.assert_allclose(estimate, np.column_stack([run.timestamps, run.positions, run.orientations]), atol=1e-9)
    truth = np.loadtxt(finished.out / "trajectories" / "seed-0000" / "truth.tum")
    np.testing.assert_allclose(truth[:, 1:4], run.true_positions, atol=1e-9)
    rows = np.loadtxt(finished.out / "trajectories" / "seed-0000" / "euclidean.kitti").reshape(-1, 3, 4)
    np.testing.assert_allclose(rows[:, :, 3], run.positions, atol=1e-9)
    np.testing.assert_allclose(rows[:, :, :3], rotations.matrix(run.orientations), atol=1e-9)


def test_a_finished_run_is_read_back_from_its_directory(finished):
    (again,) = store.read_study(finished.out).cells
    assert again.scenario == SCENARIO
    assert again.missing() == []
    np.testing.assert_array_equal(again.load()[0][1].positions, finished.load()[0][1].positions)


def test_only_what_is_not_there_is_missing(finished):
    finished.trial_path(1, SCENARIO.filters[0]).unlink()
    assert finished.missing() == [(1, SCENARIO.filters[0])]
    with pytest.raises(ValueError, match=r"euclidean\.npz is missing: the run is not finished"):
        finished.load()


def test_more_seeds_and_filters_may_join(finished):
    more = SCENARIO.replaced(seeds=(0, 1, 2), filters=(*SCENARIO.filters, filter_choice("inverse-depth")))
    assert len(opened(finished.out, more).missing()) == 4


def test_other_settings_are_refused_and_nothing_is_lost(finished):
    before = (finished.out / "settings.json").read_text()
    with pytest.raises(ValueError, match=r"holds a run with gate = 0.99, now it is 0.9: choose another"):
        opened(finished.out, SCENARIO.replaced(gate=0.9))
    changed = SCENARIO.filters[0].replaced(options={"min_disparity": 5.0})
    with pytest.raises(ValueError, match=r"euclidean\.npz was made with other options"):
        run_benchmark(SCENARIO.replaced(filters=(changed,)), finished.out, jobs=1)
    assert (finished.out / "settings.json").read_text() == before


def test_a_damaged_trial_is_named(finished):
    path = finished.trial_path(0, SCENARIO.filters[0])
    path.write_bytes(path.read_bytes()[:500])
    for use in (finished.missing, finished.load):
        with pytest.raises(ValueError, match=r"seed-0000/euclidean\.npz is damaged .*delete it"):
            use()


def test_filters_that_were_not_given_the_same_stream_are_found_out(tmp_path):
    scenario = SCENARIO.replaced(filters=(filter_choice("euclidean"), filter_choice("inverse-depth")), seeds=(0,))
    directory = fill(tmp_path / "out", scenario)
    run = directory.load()[0][1]
    provenance = directory.provenance(0, scenario.filters[1])
    provenance["recording"]["stream_sha256"] = "other"
    directory.save_trial(0, scenario.filters[1], packed_run(run, provenance))
    with pytest.raises(ValueError, match="were not given the same recording"):
        directory.load()


def test_a_directory_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match="is not empty and holds no run"):
        opened(tmp_path, SCENARIO)
    with pytest.raises(ValueError, match="is a file: give a directory"):
        opened(tmp_path / "thesis.tex", SCENARIO)
    with pytest.raises(ValueError, match=r"holds no run: it has no settings\.json, give the directory of a run"):
        store.read_study(tmp_path)


@pytest.mark.parametrize("name", ["study.json", "settings.json"])
def test_damaged_settings_are_named(finished, name):
    (finished.out / "study.json").unlink()
    (finished.out / name).write_text('{"scenario": ')
    with pytest.raises(ValueError, match=rf"{name} is damaged"):
        store.read_study(finished.out)
