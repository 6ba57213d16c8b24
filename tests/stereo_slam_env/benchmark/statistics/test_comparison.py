"""What is said to have changed between two runs (3 s)."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from stereo_slam_env.benchmark import Scenario, run_benchmark
from stereo_slam_env.benchmark.recordings.sources import ReferenceSource
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice
from stereo_slam_env.benchmark.scenarios.study import Cell, Study
from stereo_slam_env.benchmark.statistics.comparison import compare
from stereo_slam_env.benchmark.statistics.differences import Finding

from ....synthetic_runs import THREE, make_runs, scored

OURS = (FilterChoice("ours", "inverse-depth"),)
SOURCE = ReferenceSource("short_turn", {"landmarks": 12})
SCENARIO = Scenario("tiny", SOURCE, filters=OURS, seeds=tuple(range(9)), frames=5, gate=None)


def bench(out, **changes):
    return run_benchmark(SCENARIO.replaced(**changes), out, jobs=1).out


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    return bench(tmp_path_factory.mktemp("before") / "run")


def result(runs):
    return SimpleNamespace(runs=runs, figures=scored(runs)[1])


def worsened(runs, name, factor):
    """The same runs, but the errors of one filter are larger by a factor that is not quite the same in each."""
    return [
        replace(
            run,
            positions=run.true_positions
            + (factor * (1 + 0.02 * np.sin(run.seed))) * (run.positions - run.true_positions),
        )
        if run.filter_name == name
        else run
        for run in runs
    ]


def changes_of(comparison, **wanted):
    return [c for c in comparison.changes if all(getattr(c, key) == value for key, value in wanted.items())]


def test_only_what_was_changed_is_said_to_have_changed():
    runs = make_runs(THREE, seeds=range(8), frames=60)
    comparison = compare(result(runs), result(worsened(runs, "dual-bearing", 1.3)))
    assert {(c.filter_name, c.measure) for c in comparison.shown} == {
        ("dual-bearing", "position error"),
        ("dual-bearing", "rigid ATE"),
    }
    (position,) = changes_of(comparison, filter_name="dual-bearing", measure="position error")
    assert position.finding is Finding.WORSE
    assert position.after / position.before == pytest.approx(1.3, abs=0.02)
    low, high = position.interval_percent
    assert 25 < low < 30 < high < 35
    assert comparison.headline.startswith(
        "Worse after than before, run by run: position error of dual-bearing: 30 % larger ("
    )
    (same,) = changes_of(comparison, filter_name="euclidean", measure="position error")
    assert same.words == "the same in all 8 runs"
    back = compare(result(worsened(runs, "dual-bearing", 1.3)), result(runs))
    assert back.headline.startswith("Better after than before, run by run: position error of dual-bearing")


def test_times_that_changed_too_leave_the_other_changes_as_sure_as_they_were():
    before = make_runs(THREE, seeds=range(8), frames=60)
    after = worsened(before, "dual-bearing", 1.3)
    slower = [replace(run, milliseconds=(1.5 + 0.01 * run.seed) * run.milliseconds) for run in after]
    wanted = {"filter_name": "dual-bearing", "measure": "position error"}
    ((alone,), (beside,)) = (changes_of(compare(result(before), result(runs)), **wanted) for runs in (after, slower))
    assert (beside.interval_percent, beside.difference.p_value) == (alone.interval_percent, alone.difference.p_value)


def test_a_change_in_one_run_of_eight_is_not_shown():
    runs = make_runs(THREE[:1], seeds=range(8), frames=40)
    worse = worsened(runs, "inverse-depth", 3.0)
    comparison = compare(result(runs), result([worse[0], *runs[1:]]))
    assert comparison.shown == ()
    assert comparison.headline.startswith("No difference is shown in ")


def test_too_few_runs_are_called_so():
    runs = make_runs(THREE[:1], seeds=range(3), frames=40)
    comparison = compare(result(runs), result(worsened(runs, "inverse-depth", 3.0)))
    assert comparison.headline == "No difference is shown in 7 comparisons: 3 runs are too few, 7 are needed."


def test_divergences_have_a_test_of_their_own():
    runs = make_runs(THREE[:1], seeds=range(9), frames=40)
    broken = [replace(run, failure="frame 9: gone") if run.seed < 8 else run for run in runs]
    (change,) = changes_of(compare(result(runs), result(broken)), measure="diverged runs")
    assert change.finding is Finding.WORSE
    assert change.words == "0 of 9 runs before, 8 of 9 after"
    once = result([replace(run, failure="frame 9: gone") if run.seed < 1 else run for run in runs])
    (change,) = changes_of(compare(result(runs), once), measure="diverged runs")
    assert change.words == "0 of 9 runs before, 1 of 9 after, which may be chance"
    comparison = compare(once, once)
    assert changes_of(comparison, measure="diverged runs")[0].words == "the same 1 of 9 runs"
    assert comparison.headline == "Nothing has changed but perhaps the time."


def test_what_only_one_of_them_has_is_named():
    before, after = make_runs(THREE[:2], seeds=range(7), frames=30), make_runs(THREE[1:], seeds=range(1, 9), frames=30)
    comparison = compare(result(before), result(after))
    assert (comparison.filters_before, comparison.filters_after) == (("inverse-depth",), ("euclidean",))
    assert comparison.recordings_before == ("drive-0 (seed 0)",)
    assert comparison.recordings_after == ("drive-7 (seed 7)", "drive-8 (seed 8)")
    assert {change.filter_name for change in comparison.changes} == {"dual-bearing"}
    assert all(change.difference.count == 6 for change in comparison.changes)
    with pytest.raises(ValueError, match="have no filter in common: inverse-depth against euclidean"):
        compare(result(before[::2]), result(after[1::2]))


def test_the_same_run_has_not_changed(stored):
    comparison = compare(stored, stored)
    assert comparison.paired
    assert comparison.shown == ()
    assert comparison.headline == "Nothing has changed but perhaps the time."
    assert str(stored) in (comparison.before, comparison.after)
    assert not any("code" in warning for warning in comparison.warnings)
    assert comparison.as_rows() == []
    assert str(comparison).splitlines()[-1] == "ours: the same in all runs."
    with pytest.raises(ValueError, match="holds no run"):
        compare(stored.parent, stored)


def test_stored_runs_are_paired_by_the_digest_of_their_measurements(stored, tmp_path):
    other = bench(tmp_path / "out", noise={"independent_pixels": 3.0})
    comparison = compare(stored, other)
    assert comparison.paired
    assert any("settings of the two runs differ in noise" in warning for warning in comparison.warnings)
    assert any(c.measure == "NIS / dof" and c.finding is Finding.WORSE for c in comparison.changes)
    assert "farther from its ideal" in comparison.headline


def test_other_measurements_are_not_paired_and_the_reader_is_told(stored, tmp_path):
    other = bench(tmp_path / "out", source=SCENARIO.source.replaced(sigma=4.0))
    comparison = compare(str(stored), other)
    assert not comparison.paired
    assert "short-turn (seed 0) and 8 more are not the same in both runs" in comparison.warnings[0]
    (position,) = changes_of(comparison, filter_name="ours", measure="position error")
    assert "unpaired runs" in position.words


def test_times_of_different_machines_are_not_comparable(stored, tmp_path):
    other = shutil.copytree(stored, tmp_path / "out")
    assert any("Times were measured in two sessions" in warning for warning in compare(stored, other).warnings)
    settings = json.loads((other / "settings.json").read_text())
    settings["versions"]["platform"] = "Amiga"
    (other / "settings.json").write_text(json.dumps(settings))
    (warning,) = (w for w in compare(stored, other).warnings if "Times" in w)
    assert warning.startswith("Times are not comparable: the two runs differ in platform (")
    assert "Amiga" in warning


def test_a_grid_is_compared_cell_by_cell(tmp_path):
    gates = (0.9, 0.95, 0.99)
    cells = [Cell(f"gate-{gate}", {"gate": gate}, SCENARIO.replaced(gate=gate, seeds=(0, 1))) for gate in gates]
    before = run_benchmark(Study("grid", tuple(cells)), tmp_path / "before", jobs=1)
    comparison = compare(before, shutil.copytree(before.out, tmp_path / "after"))
    assert comparison.paired
    assert {change.filter_name for change in comparison.changes} == {f"gate-{gate}: ours" for gate in gates}
    assert all(change.difference.count == 2 for change in comparison.changes)
    assert comparison.headline == "Nothing has changed but perhaps the time."
    assert comparison.rest == ("gate-0.9, gate-0.95 and gate-0.99: the same in all runs.",)


def test_recordings_of_another_kind_are_refused_in_one_line(stored, tmp_path):
    other = bench(tmp_path / "out", source=ReferenceSource("long_drive", {"landmarks": 12}), seeds=(0,))
    kinds = r"\A[^\n]*'reference' \(name 'short_turn'\)[^\n]*'long_drive'[^\n]*on the same kind of recordings\Z"
    with pytest.raises(ValueError, match=kinds):
        compare(stored, other)


def test_runs_without_any_common_figure_are_not_called_the_same():
    runs = make_runs(THREE[:1], seeds=range(3), frames=20)
    timeless = [replace(run, milliseconds=np.full(20, np.nan), failure="frame 1: gone") for run in runs]
    comparison = compare(result(runs), result(timeless))
    assert "Nothing has changed" not in comparison.headline
    assert "3 runs are too few" in comparison.headline
