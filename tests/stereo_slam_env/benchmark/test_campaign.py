"""Filters x seeds: identical streams, resumption, failures, third-party filters (10 s)."""

import json
from pathlib import Path

import numpy as np
import pytest

from stereo_slam_env.benchmark import FilterChoice, Scenario, campaign, run
from stereo_slam_env.benchmark.scenario import filter_choice

from ..third_party import install, third_party  # noqa: F401 (a fixture)

SHORT = Scenario("short", "reference", {"name": "short_turn"}, seeds=(0, 1), frames=5, gate=None)


def test_all_filters_on_all_seeds(tmp_path):
    result = run(SHORT, tmp_path / "out", jobs=1, report=False)
    assert [(r.seed, r.filter_name) for r in result.runs] == [
        (seed, name) for seed in (0, 1) for name in ("inverse-depth", "dual-bearing", "euclidean")
    ]
    assert all(r.failure is None for r in result.runs)
    assert [s.runs for s in result.summaries] == [2, 2, 2]
    assert set(json.loads((tmp_path / "out" / "summary.json").read_text())["filters"]) == {
        "inverse-depth",
        "dual-bearing",
        "euclidean",
    }


@pytest.mark.slow
def test_processes_change_nothing_but_the_time(tmp_path):
    alone = run(SHORT, tmp_path / "one", jobs=1, report=False)
    together = run(SHORT, tmp_path / "two", jobs=2, report=False)
    for a, b in zip(alone.runs, together.runs, strict=True):
        assert (a.seed, a.filter_name) == (b.seed, b.filter_name)
        np.testing.assert_allclose(a.positions, b.positions, atol=1e-12)
        np.testing.assert_array_equal(a.true_positions, b.true_positions)


@pytest.mark.usefixtures("third_party")
def test_every_filter_hears_exactly_the_same(tmp_path):
    notes = [str(tmp_path / name) for name in "abc"]
    ears = [FilterChoice(f"ear-{i}", "listens", {"notebook": note}) for i, note in enumerate(notes)]
    run(SHORT, tmp_path / "out", filters=[*ears[:2], "inverse-depth", ears[2]], seeds=[5], jobs=1, report=False)
    heard = {Path(note).read_text() for note in notes}
    assert len(heard) == 1
    assert len(heard.pop()) == 64


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, monkeypatch):
    made = []
    run_filter = campaign.run_filter

    def counted(recording, name, *args, **options):
        made.append((options["seed"], name))
        return run_filter(recording, name, *args, **options)

    monkeypatch.setattr(campaign, "run_filter", counted)

    def stop_in_the_fifth_trial(done, total):
        assert total == 6
        if done > 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(SHORT, tmp_path / "out", jobs=1, report=False, progress=stop_in_the_fifth_trial)
    assert len(list((tmp_path / "out").glob("trials/*/*.npz"))) == 4
    made.clear()
    assert len(run(SHORT, tmp_path / "out", jobs=1, report=False).runs) == 6
    assert made == [(1, "dual-bearing"), (1, "euclidean")]
    made.clear()
    run(SHORT, tmp_path / "out", jobs=1, report=False)
    assert made == []


def test_a_resumed_run_says_the_same_as_one_in_one_go(tmp_path):
    whole = run(SHORT, tmp_path / "whole", jobs=1, report=False)
    run(SHORT, tmp_path / "parts", filters=["dual-bearing"], seeds=[1], jobs=1, report=False)
    parts = run(SHORT, tmp_path / "parts", jobs=1, report=False)
    for a, b in zip(whole.runs, parts.runs, strict=True):
        np.testing.assert_array_equal(a.positions, b.positions)


@pytest.mark.usefixtures("third_party")
def test_filters_that_fail_never_take_the_run_down(tmp_path):
    filters = ["raises", "inverse-depth", "returns-nan"]
    result = run(SHORT, tmp_path / "out", filters=filters, jobs=1, report=False)
    failing, sound, lost = result.summaries
    assert (failing.diverged, sound.diverged, lost.diverged) == (2, 0, 2)
    assert failing.failures[0] == "seed 0, frame 2: RuntimeError: the third frame is too much"
    assert sound.position_rmse_m < 0.2
    assert "NaN" in lost.failures[1]


def test_a_tiny_third_party_filter_is_benchmarked_by_name(tmp_path, monkeypatch):
    module = (
        'from filters import InverseDepthStereoEKF\nclass Mine(InverseDepthStereoEKF):\n    """A filter of mine."""\n'
    )
    site = tmp_path / "site"
    site.mkdir()
    install(site, "my_filter_package", module, {"mine": "Mine"})
    monkeypatch.syspath_prepend(str(site))
    result = run(SHORT, tmp_path / "out", filters=["mine", "inverse-depth"], jobs=1, report=False)
    mine, original = result.summaries
    assert mine.filter_name == "mine"
    assert mine.position_rmse_m == original.position_rmse_m
    assert mine.options == original.options


def test_a_plugin_that_cannot_be_imported_is_reported_by_name(tmp_path, monkeypatch):
    site = tmp_path / "site"
    site.mkdir()
    install(site, "broken_filter_package", "import no_such_module\n", {"broken": "Broken"})
    monkeypatch.syspath_prepend(str(site))
    broken, sound = run(SHORT, tmp_path / "out", filters=["broken", "euclidean"], jobs=1, report=False).summaries
    assert broken.diverged == 2
    assert "'broken'" in broken.failures[0]
    assert "no_such_module" in broken.failures[0]
    assert sound.diverged == 0


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
        run(SHORT, tmp_path / "out", filters=filters, report=False)
    assert not (tmp_path / "out").exists()


def test_a_source_that_cannot_be_repeated_is_found_out(tmp_path, monkeypatch):
    call = Scenario("x", "factory", {"call": "unsteady_source:make"}, filters=(filter_choice("euclidean"),), seeds=(0,))
    (tmp_path / "unsteady_source.py").write_text(
        "import numpy as np\n"
        "from stereo_slam_env.benchmark.reference_problem import short_turn\n"
        "def make(seed):\n"
        "    return short_turn(int(np.random.default_rng().integers(1_000_000)), frames=4)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    run(call, tmp_path / "out", jobs=1, report=False)
    with pytest.raises(ValueError, match="its source is not deterministic"):
        run(call, tmp_path / "out", filters=["euclidean", "inverse-depth"], jobs=1, report=False)


def test_no_jobs_is_refused(tmp_path):
    with pytest.raises(ValueError, match="jobs must be >= 1"):
        run(SHORT, tmp_path, jobs=0)
