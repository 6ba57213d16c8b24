"""One filter on one recording has one answer, by whichever public road it is asked (20 s)."""

from dataclasses import replace

import numpy as np
import pytest

import stereo_slam_env as sse
from stereo_slam_env.benchmark import Cell, ReferenceSource, Scenario, Study, preset, run_benchmark
from stereo_slam_env.benchmark.head_to_head import Bench
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice
from stereo_slam_env.benchmark.storage.store import read_study
from stereo_slam_env.cli import app as cli
from stereo_slam_env.datasets import load
from stereo_slam_env.frontend.camera_motion import needed_motion
from stereo_slam_env.recording.filter_setup import FilterSetup

from ..datasets.small_folders import kitti07

NAMES = ("inverse-depth", "euclidean")
PLAIN = Scenario("plain", ReferenceSource("short_turn", {"landmarks": 12}), gate=None, metrics=())
SETUPS = {
    "as the presets": {"noise": {"independent_pixels": 1.0}},
    "everything else": {
        "use_odometry": True,
        "gate": 0.9,
        "consensus": True,
        "noise": {"diagonal": [1.0, 0.7, 2.0]},
        "motion": {"sigma_acceleration": 1.0},
        "divergence_percent": 1.0,
    },
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("setup", SETUPS)
def test_every_road_has_the_same_digits(tmp_path, setup, name):
    scenario = PLAIN.replaced(**SETUPS[setup], filters=(filter_choice(name),), seeds=(1,), frames=10)
    recording = sse.make_recording(scenario, 1)
    result = run_benchmark(scenario, tmp_path / "run", jobs=1)
    (run,) = result.runs
    wanted = result.summaries[0].position_rmse_m

    sse.save_recording(tmp_path / "saved.npz", recording)
    (stored,) = (tmp_path / "run").glob("recordings/*/seed-0001.npz")
    found = {
        "evaluate": sse.evaluate(name, recording).figures,
        "evaluate, saved": sse.evaluate(name, sse.load(tmp_path / "saved.npz")).figures,
        "evaluate, stored by the benchmark": sse.evaluate(name, sse.load(stored)).figures,
        "compare, scenario": sse.compare([name], scenario, seeds=[1]).summaries[0],
        "compare, recording": sse.compare([name], recording).summaries[0],
        "bench": Bench()(name, against="dual-bearing", scenario=scenario, seeds=[1]).summary,
    }
    assert {road: figures.position_rmse_m for road, figures in found.items()} == dict.fromkeys(found, wanted)
    assert {figures.diverged for figures in found.values()} == {result.summaries[0].diverged}
    positions = [moment.hold().pose.position for moment in sse.run(name, recording)]
    np.testing.assert_array_equal(positions, run.positions)

    arguments = ["--filters", name, "--jobs", "1", "--out", str(tmp_path / "replay")]
    assert cli.main(["replay", str(tmp_path / "saved.npz"), *arguments]) == 0
    replayed = read_study(tmp_path / "replay").cells[0]
    assert replayed.scenario.filter_setup == recording.filter_setup
    again = replayed.load()[0][0]
    np.testing.assert_allclose(again.positions, run.positions, rtol=0.0, atol=1e-9)  # clones for the windows beside it


def test_the_case_of_the_street():
    """The simulated sensor, with odometry in the recording that the scenario does not give to the filters."""
    scenario = preset("quick").replaced(frames=8)
    recording = sse.make_recording(scenario, 1)
    assert any(frame.odometry is not None for frame in recording.frames)
    row = sse.compare(["inverse-depth"], scenario, seeds=[1]).summaries[0].position_rmse_m
    assert sse.evaluate("inverse-depth", recording).figures.position_rmse_m == row
    told = sse.evaluate("inverse-depth", recording, use_odometry=True, gate=0.99)
    assert told.figures.position_rmse_m != row
    assert told.setup.use_odometry
    assert "odometry used" in str(told)
    assert told.series.options["gate"] == 0.99


def test_what_states_nothing_is_set_up_alike_and_options_win():
    recording = replace(sse.make_recording(PLAIN, 0)[:8], stated_setup=None)
    usual = sse.evaluate("inverse-depth", recording)
    assert usual.setup == FilterSetup(use_odometry=False)  # it has none
    assert usual.series.options["gate"] == 0.99
    compared = sse.compare(["inverse-depth"], recording)
    assert compared.summaries[0].position_rmse_m == usual.figures.position_rmse_m
    assert compared.settings["filter setup"] == str(usual.setup)
    assert compared.settings["options"]["inverse-depth"] == dict(usual.series.options)
    joint = replace(recording, stated_setup=FilterSetup(consensus=True))
    assert "consensus" not in sse.evaluate("inverse-depth", joint, gate=None).series.options
    assert sse.evaluate("inverse-depth", joint).series.options["consensus"]


def test_a_file_that_states_nothing_is_set_up_as_it_was_before_it_was_saved(tmp_path):
    recording = sse.make_recording(PLAIN, 0)
    theirs = replace(recording, truth_from=replace(recording.truth_from, kind="unknown"), stated_setup=None)
    sse.save_recording(tmp_path / "theirs.npz", theirs)
    assert load(tmp_path / "theirs.npz").stated_setup is None
    found = sse.evaluate("inverse-depth", theirs).series.positions
    np.testing.assert_array_equal(sse.evaluate("inverse-depth", load(tmp_path / "theirs.npz")).series.positions, found)
    np.testing.assert_allclose(replayed(tmp_path, "theirs.npz"), found, rtol=0.0, atol=1e-9)


def test_tracks_of_real_pictures_state_what_replay_does(tmp_path):
    (tmp_path / "tracks").mkdir()
    read = sse.load(kitti07(tmp_path / "tracks"))
    assert read.filter_setup.consensus
    assert read.filter_setup.motion["sigma_acceleration"] == needed_motion(read).sigma_acceleration
    found = sse.evaluate("inverse-depth", read).series.positions
    np.testing.assert_allclose(replayed(tmp_path, "tracks"), found, rtol=0.0, atol=1e-9)


def replayed(folder, name):
    assert cli.main(["replay", str(folder / name), "--filters", "inverse-depth", "--out", str(folder / "run")]) == 0
    return read_study(folder / "run").cells[0].load()[0][0].positions


def test_cells_that_share_a_recording_keep_their_own_setups(tmp_path):
    cells = [PLAIN.replaced(gate=gate, frames=6, filters=(filter_choice("inverse-depth"),)) for gate in (None, 0.5)]
    study = Study("gates", tuple(Cell(f"gate-{cell.gate}", {"gate": str(cell.gate)}, cell) for cell in cells))
    run_benchmark(study, tmp_path / "run", jobs=1)
    kept = read_study(tmp_path / "run").cells
    assert [cell.load()[0][0].options["gate"] for cell in kept] == [None, 0.5]
    (stored,) = (tmp_path / "run").glob("recordings/*/*.npz")
    assert sse.load(stored).stated_setup is None


MISTAKES = [("inverse-dept", {}, "did you mean 'inverse-depth'"), ("inverse-depth", {"gat": 0.9}, "option 'gat'")]


@pytest.mark.parametrize(("name", "options", "message"), MISTAKES)
def test_a_misspelt_name_is_refused_before_anything_runs(name, options, message):
    recording = sse.make_recording(PLAIN, 0)
    for ask in (
        lambda: sse.evaluate(name, recording, **options),
        lambda: sse.run(name, recording, **options),
        lambda: sse.compare([name], recording, options={name: options}),
        lambda: Bench()(name, scenario=PLAIN, seeds=1, options=options),
    ):
        with pytest.raises(ValueError, match=message):
            ask()


def test_a_search_that_each_filter_guides_has_no_recording():
    scenario = PLAIN.replaced(search="forecast")
    for ask in (lambda: sse.make_recording(scenario, 0), lambda: sse.compare(["inverse-depth"], scenario, seeds=1)):
        with pytest.raises(ValueError, match="search 'forecast' has no recording"):
            ask()
