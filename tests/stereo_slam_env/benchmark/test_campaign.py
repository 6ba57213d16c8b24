"""Filters x seeds: identical streams, resumption, failures, third-party filters (10 s)."""

import errno
import json
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from stereo_slam_env.benchmark import FilterChoice, Scenario, campaign, run_benchmark
from stereo_slam_env.benchmark.recordings.sources import DatasetSource, FactorySource, ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import filter_choice
from stereo_slam_env.benchmark.scenarios.study import Study, study_from
from stereo_slam_env.benchmark.storage import store
from stereo_slam_env.benchmark.storage.result_tables import write_results
from stereo_slam_env.benchmark.storage.store import prepared_study, read_study
from stereo_slam_env.evaluation.trial import Trial

from ..third_party import install

SHORT = Scenario("short", ReferenceSource("short_turn"), seeds=(0, 1), frames=5, gate=None, metrics=("map",))


def test_all_filters_on_all_seeds(tmp_path):
    result = run_benchmark(SHORT, tmp_path / "out", jobs=1)
    assert [(r.seed, r.filter_name) for r in result.runs] == [
        (seed, name) for seed in (0, 1) for name in ("inverse-depth", "dual-bearing", "euclidean")
    ]
    assert all(r.failure is None for r in result.runs)
    assert [s.runs for s in result.summaries] == [2, 2, 2]
    written = json.loads((tmp_path / "out" / "summary.json").read_text())["filters"]
    assert list(written) == [choice.label for choice in SHORT.filters]


@pytest.mark.usefixtures("third_party")
def test_every_filter_hears_exactly_the_same(tmp_path):
    notes = [str(tmp_path / name) for name in "abc"]
    ears = [FilterChoice(f"ear-{i}", "listens", {"notebook": note}) for i, note in enumerate(notes)]
    run_benchmark(SHORT, tmp_path / "out", filters=[*ears[:2], "inverse-depth", ears[2]], seeds=[5], jobs=1)
    heard = {Path(note).read_text() for note in notes}
    assert len(heard) == 1
    assert len(heard.pop()) == 64


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, monkeypatch):
    made = []
    run, make = campaign.run_all_trials, campaign.make_all

    def making(tasks, **how):
        made.extend(task.seed for task in tasks)
        return make(tasks, **how)

    def running(tasks, **how):
        made.extend((task.seed, task.choice.label) for task in tasks)
        return run(tasks, **how)

    monkeypatch.setattr(campaign, "make_all", making)
    monkeypatch.setattr(campaign, "run_all_trials", running)

    def stop_in_the_fifth_trial(done, total):
        assert total == 2 + 6
        if done > 2 + 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_benchmark(SHORT, tmp_path / "out", jobs=1, progress=stop_in_the_fifth_trial)
    assert len(list((tmp_path / "out").glob("trials/*/*.npz"))) == 4
    assert made[:2] == [0, 1]
    made.clear()
    assert len(run_benchmark(SHORT, tmp_path / "out", jobs=1).runs) == 6
    assert made == [(1, "dual-bearing"), (1, "euclidean")]
    made.clear()
    run_benchmark(SHORT, tmp_path / "out", jobs=1)
    assert made == []


def test_a_resumed_run_looks_at_each_finished_trial_once_before_it_works(tmp_path, monkeypatch):
    run_benchmark(SHORT, tmp_path / "out", jobs=1)
    looked_at, look = [], store.load_provenance
    monkeypatch.setattr(store, "load_provenance", lambda path, **how: looked_at.append(path) or look(path, **how))

    def stop_before_work(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_benchmark(SHORT, tmp_path / "out", jobs=1, progress=stop_before_work)
    assert sorted(looked_at) == sorted((tmp_path / "out").glob("trials/*/*.npz"))


def test_what_an_interruption_breaks_on_its_way_out_is_an_interruption(tmp_path):
    def interrupted_while_it_writes(done, total):
        try:
            raise KeyboardInterrupt
        finally:
            raise ValueError("Can't close the ZIP file while there is an open writing handle on it")

    with pytest.raises(KeyboardInterrupt):
        run_benchmark(SHORT, tmp_path / "out", jobs=1, progress=interrupted_while_it_writes)


def test_a_full_disk_loses_no_finished_trial(tmp_path, monkeypatch):
    written = []
    write = campaign.RunDirectory.save_trial

    def until_full(self, *trial):
        if len(written) == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        written.append(trial)
        write(self, *trial)

    monkeypatch.setattr(campaign.RunDirectory, "save_trial", until_full)
    with pytest.raises(OSError, match="No space left"):
        run_benchmark(SHORT, tmp_path / "out", jobs=1)
    monkeypatch.undo()
    kept = sorted((tmp_path / "out").glob("trials/*/*.npz"))
    times = [path.stat().st_mtime_ns for path in kept]
    assert len(kept) == 3
    assert len(run_benchmark(SHORT, tmp_path / "out", jobs=1).runs) == 6
    assert [path.stat().st_mtime_ns for path in kept] == times


def test_a_resumed_run_says_the_same_as_one_in_one_go(tmp_path):
    whole = run_benchmark(SHORT, tmp_path / "whole", jobs=1)
    run_benchmark(SHORT, tmp_path / "parts", filters=["dual-bearing"], seeds=[1], jobs=1)
    parts = run_benchmark(SHORT, tmp_path / "parts", jobs=1)
    for a, b in zip(whole.runs, parts.runs, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)


@pytest.mark.usefixtures("third_party")
def test_filters_that_crash_or_hang_never_take_the_run_down(tmp_path):
    filters = ["crashes", "hangs", "euclidean"]
    scenario = SHORT.replaced(frame_time_limit=1.0)
    crashing, hanging, sound = run_benchmark(scenario, tmp_path / "out", filters=filters, seeds=[0], jobs=1).summaries
    assert crashing.failures == ("seed 0, its process ended with code 7",)
    assert hanging.failures == ("seed 0, no sign of life for 1 s",)
    assert (crashing.diverged, hanging.diverged, sound.diverged) == (1, 1, 0)


@pytest.mark.usefixtures("third_party")
def test_filters_that_fail_never_take_the_run_down(tmp_path):
    filters = ["raises", "inverse-depth", "returns-nan"]
    result = run_benchmark(SHORT, tmp_path / "out", filters=filters, jobs=1)
    failing, sound, lost = result.summaries
    assert (failing.diverged, sound.diverged, lost.diverged) == (2, 0, 2)
    assert failing.failures[0] == "seed 0, frame 2: RuntimeError: the third frame is too much"
    assert sound.position_rmse_m < 0.2
    assert lost.failures[1] == "seed 1, frame 2: its position is not finite"


def test_a_tiny_third_party_filter_is_benchmarked_by_name(tmp_path, monkeypatch):
    """And one that cannot be imported is reported by its name."""
    site = tmp_path / "site"
    site.mkdir()
    module = 'from filters import InverseDepthStereoEKF\nclass Mine(InverseDepthStereoEKF):\n    """Mine."""\n'
    install(site, "my_filter_package", module, {"mine": "Mine"})
    install(site, "broken_filter_package", "import no_such_module\n", {"broken": "Broken"})
    monkeypatch.syspath_prepend(str(site))
    result = run_benchmark(SHORT, tmp_path / "out", filters=["mine", "inverse-depth", "broken"], jobs=1)
    mine, original, broken = result.summaries
    assert mine.filter_name == "mine"
    assert (mine.position_rmse_m, mine.options) == (original.position_rmse_m, original.options)
    assert (broken.diverged, original.diverged) == (2, 0)
    assert "'broken'" in broken.failures[0]
    assert "no_such_module" in broken.failures[0]


@pytest.mark.parametrize(
    ("filters", "complaint"),
    [
        (["inverse-dept"], "did you mean 'inverse-depth'"),
        ([FilterChoice("x", "euclidean", {"min_disparty": 5})], "did you mean 'min_disparity'"),
        ([FilterChoice("x", "inverse-depth", {"landmark": "cubic"})], "landmark must be one of"),
    ],
)
def test_wrong_filters_are_refused_before_any_work(tmp_path, filters, complaint):
    with pytest.raises(ValueError, match=complaint):
        run_benchmark(SHORT, tmp_path / "out", filters=filters)
    assert not (tmp_path / "out").exists()


def test_a_filter_that_joins_later_hears_what_the_others_heard(tmp_path, monkeypatch):
    call = Scenario("x", FactorySource("unsteady_source:make"), filters=(filter_choice("euclidean"),), seeds=(0,))
    (tmp_path / "unsteady_source.py").write_text(
        "import numpy as np\n"
        "from stereo_slam_env.benchmark.recordings.reference_problem import short_turn\n"
        "def make(seed):\n"
        "    return short_turn(int(np.random.default_rng().integers(1_000_000)), frames=4)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    (alone,) = run_benchmark(call, tmp_path / "out", jobs=1).runs
    again, later = run_benchmark(call, tmp_path / "out", filters=["euclidean", "inverse-depth"], jobs=1).runs
    np.testing.assert_array_equal(later.true_positions, alone.true_positions)
    np.testing.assert_array_equal(again.positions, alone.positions)


def test_a_stored_recording_replays_as_it_was(tmp_path):
    first = run_benchmark(SHORT, tmp_path / "out", seeds=[1], jobs=1)
    (path,) = (tmp_path / "out").glob("recordings/*/*.npz")
    again = Scenario("again", DatasetSource(str(path)), filters=SHORT.filters, gate=None, metrics=("map",))
    replayed = run_benchmark(again, tmp_path / "again", jobs=1)
    for a, b in zip(first.runs, replayed.runs, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)


def test_cells_that_differ_in_the_filters_share_their_recordings(tmp_path):
    grid = {"noise.independent_pixels": [0.5, 1.0], "options.sigma": [1.0, 2.0]}
    study = study_from({**SHORT.as_dict(), "seeds": [0], "filters": ["inverse-depth"], "grid": grid})
    result = run_benchmark(study, tmp_path, jobs=1)
    assert len(list(tmp_path.glob("recordings/*/*.npz"))) == 2
    assert len({cell.summaries[0].position_rmse_m for cell in result.cells}) == 4
    factors = json.loads((tmp_path / "summary.json").read_text())["cells"]["independent_pixels-0.5_sigma-2.0"][
        "factors"
    ]
    assert factors == {"noise.independent_pixels": 0.5, "options.sigma": 2.0}
    one = read_study(tmp_path / "cells" / "independent_pixels-0.5_sigma-2.0")
    assert write_results(one)[0].summaries[0].position_rmse_m == result.cells[1].summaries[0].position_rmse_m


def test_a_benchmark_is_named_by_its_preset_or_its_file(tmp_path):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\nkind = "reference"\nframes = 4\nseeds = 1\nfilters = ["euclidean"]\n'
        'metrics = []\noptions = { name = "short_turn" }\n'
    )
    assert len(run_benchmark(str(tmp_path / "mine.toml"), tmp_path / "out", jobs=1).runs) == 1
    result = run_benchmark("reference-turn", tmp_path / "preset", filters=["euclidean"], seeds=[3], jobs=1)
    assert [r.seed for r in result.runs] == [3]
    with pytest.raises(ValueError, match="did you mean 'reference-turn'"):
        run_benchmark("reference-tur", tmp_path / "x")


def test_of_more_seeds_than_are_kept_the_figures_are_kept(tmp_path):
    """The same figures, summaries and table, bit for bit, from files of which most have no trajectory."""
    three = SHORT.replaced(seeds=(0, 1, 2), metrics=("map", "bound"))
    whole = run_benchmark(three, tmp_path / "whole", jobs=1)
    thin = run_benchmark(three.replaced(kept_seeds=1), tmp_path / "thin", jobs=1)
    timed = {"ms_per_frame", "ms_predict", "ms_update", "memory_mb"}

    def untimed(row):
        return {key: value for key, value in row.items() if key not in timed}

    for label in whole.figures:
        for key, figures in whole.figures[label].of_run.items():
            assert untimed(thin.figures[label].of_run[key]) == untimed(figures)
    for a, b in zip(whole.summaries, thin.summaries, strict=True):
        assert json.dumps(untimed(a.as_dict())) == json.dumps(untimed(b.as_dict()))
    assert {run.seed for run in thin.runs} == {0}
    kept = {path.name for path in (tmp_path / "thin").rglob("seed-*")}
    assert "seed-0000.npz" in kept  # recordings and bounds
    assert "seed-0001.npz" not in kept
    sizes = [path.stat().st_size for path in sorted((tmp_path / "thin").glob("trials/*/euclidean.npz"))]
    assert sizes[1] < 0.5 * sizes[0]
    with closing(sqlite3.connect(tmp_path / "thin" / "trials.sqlite")) as table:
        assert table.execute("select count(*) from trials").fetchone() == (9,)


def test_to_keep_more_seeds_runs_those_again_and_a_filter_that_joins_hears_the_same(tmp_path):
    thin = SHORT.replaced(seeds=(0, 1, 2), kept_seeds=1, filters=SHORT.filters[:1])
    run_benchmark(thin, tmp_path / "out", jobs=1)
    more = read_study(tmp_path / "out").cells[0]
    assert more.missing() == []
    joined = run_benchmark(thin.replaced(filters=SHORT.filters[:2]), tmp_path / "out", jobs=1)
    assert [len(figures.of_run) for figures in joined.figures.values()] == [3, 3]  # or it would be refused
    kept = thin.replaced(kept_seeds=2, filters=SHORT.filters[:2])
    (directory,) = prepared_study(tmp_path / "out", Study.of(kept)).cells
    assert {seed for seed, _ in directory.missing()} == {1}


def test_figures_are_computed_with_the_trial_and_not_with_the_report(tmp_path, monkeypatch):
    run_benchmark(SHORT, tmp_path / "out", jobs=1)
    monkeypatch.setattr(Trial, "alarm", property(lambda trial: pytest.fail("the monitor is replayed")))
    (result,) = write_results(read_study(tmp_path / "out"))
    assert len(result.figures) == len(SHORT.filters)


def test_trajectories_are_those_of_the_first_ten_recordings_and_on_demand_of_all(tmp_path):
    one = SHORT.replaced(seeds=tuple(range(11)), filters=(filter_choice("euclidean"),), metrics=())
    run_benchmark(one, tmp_path / "out", jobs=1)
    names = [f"seed-{seed:04d}" for seed in range(11)]
    assert sorted(path.name for path in (tmp_path / "out" / "trajectories").iterdir()) == names[:10]
    read_study(tmp_path / "out").write_trajectories()
    assert sorted(path.name for path in (tmp_path / "out" / "trajectories").iterdir()) == names
