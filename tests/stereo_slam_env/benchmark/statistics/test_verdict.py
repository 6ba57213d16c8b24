"""What the report may claim, from runs with a known answer (< 2 s)."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.differences import Finding
from stereo_slam_env.benchmark.statistics.measures import POSE_NEES, POSITION, TIME, compare_all
from stereo_slam_env.benchmark.statistics.sentences import sentence
from stereo_slam_env.benchmark.statistics.verdict import Consistency, against_best, consistency, judge
from stereo_slam_env.evaluation.run_figures import RunFigures

from ....synthetic_runs import THREE, THREE_ONE_DIVERGING, Behaviour, changed, make_runs, scored

ANY = scored(make_runs(THREE[:1], frames=20))[0][0]


def summary(**changes):
    figures = {name: changes.pop(name) for name in tuple(changes) if name in ANY.figures}
    return replace(changed(ANY, **figures), filter_name="other", **changes)


def compared(ours, theirs, comparisons=1, **about_other):
    """The best filter, with these errors run by run, against the other."""
    ours, theirs = (
        RunFigures({("drive", i): {"position_rmse_m": e, "diverged": np.isnan(e)} for i, e in enumerate(values)})
        for values in (ours, theirs)
    )
    return against_best(summary(**about_other), ours, theirs, comparisons)


HARDNESS = np.exp(np.random.default_rng(1).standard_normal(10))
"""How hard each recording is, the same for both filters: it cancels in a paired comparison."""


def test_a_constant_gap_is_found_although_recordings_differ_more_than_filters():
    noise = np.exp(0.03 * np.random.default_rng(2).standard_normal(10))
    comparison = compared(HARDNESS, 1.2 * HARDNESS * noise)
    assert comparison.shown
    assert comparison.difference.finding is Finding.WORSE
    low, high = comparison.difference.interval_percent
    assert low < 20 < high
    assert 0 < low < high < 30
    assert "% larger" in comparison.words


def test_equal_filters_are_not_ranked():
    false_alarms = 0
    for seed in range(200):
        noise = np.exp(0.2 * np.random.default_rng(seed).standard_normal(10))
        false_alarms += compared(HARDNESS, HARDNESS * noise).difference.shown
    assert false_alarms / 200 < 0.06


@pytest.mark.parametrize(
    ("ours", "theirs", "says"),
    [
        ([0.10], [0.20], "the error of other is 100 % larger on this drive, but one drive proves nothing"),
        ([0.10, 0.11, 0.12], [0.20, 0.22, 0.21], "3 runs are too few to compare it with other, 6 are needed"),
        ([0.10, 0.11, 0.12], [0.10, 0.11, 0.12], "the error of other is the same in all 3 runs"),
    ],
)
def test_few_runs_show_nothing(ours, theirs, says):
    comparison = compared(ours, theirs)
    assert not comparison.shown
    assert comparison.difference.interval_percent is None
    assert says in comparison.words


@pytest.mark.parametrize(
    ("lost", "words"), [(1, "in 1 of 8 runs, which may be chance, and run by run its error is "), (7, "7 of 8 runs")]
)
def test_one_divergence_may_be_chance_and_many_are_not(lost, words):
    runs = make_runs((THREE[0], replace(THREE[2], name="wild", error_m=0.6)), seeds=range(8), frames=60)
    runs = [replace(r, failure="frame 3: gone") if r.filter_name == "wild" and r.seed < lost else r for r in runs]
    comparison = judge(*scored(runs)).comparisons["wild"]
    assert comparison.shown
    assert comparison.divergences.only_a == lost
    assert words in comparison.words
    assert ("chance" in comparison.words) == (lost == 1)


@pytest.mark.parametrize(
    ("anees", "state"),
    [
        *((6.0, Consistency.CONSISTENT), (20.0, Consistency.OVERCONFIDENT)),
        *((1.0, Consistency.CAUTIOUS), (None, Consistency.UNKNOWN)),
    ],
)
def test_consistency_is_the_place_in_the_band(anees, state):
    assert consistency(summary(pose_anees=anees, pose_anees_band=(4.0, 8.0))) is state


def test_a_filter_that_diverged_is_never_the_best():
    lucky = Behaviour("lucky", 0.001)
    runs = make_runs((lucky, *THREE[:2]), frames=60)
    summaries, figures = scored(runs)
    assert judge(summaries, figures).best == "lucky"
    summaries = [changed(s, diverged=1) if s.filter_name == "lucky" else s for s in summaries]
    verdict = judge(summaries, figures)
    assert verdict.best != "lucky"
    assert "lucky, the first of the 3 filters, diverged in 1 of 5 runs, which may be chance." in verdict.headline


def test_the_headline_answers_every_question_in_its_own_sentence():
    runs = make_runs((Behaviour("sharp", 0.02, milliseconds=6.0), Behaviour("quick", 0.4)), seeds=range(8), frames=120)
    found, figures = scored(runs)
    summaries = [changed(s, efficiency_percent=93.4, bound_position_m=0.0187) for s in found]
    verdict = judge(summaries, figures)
    assert list(verdict.answers) == ["best", "consistent", "limit", "cost"]
    assert "at 95 % confidence, 8 paired runs" in verdict.answers["best"]
    assert verdict.answers["limit"] == "Its efficiency is 93 % (8 runs) of the Cramér–Rao bound, 0.0187 m."
    assert re.search(r"ms a frame, 5\d % more than quick\.$", verdict.answers["cost"])
    assert all("sharp" in verdict.answers[question] for question in ("best", "consistent", "cost"))
    assert verdict.headline == " ".join(verdict.answers.values())
    assert "limit" not in judge(*scored(runs)).answers


def test_many_rivals_do_not_make_a_long_headline():
    behaviours = [Behaviour(f"near-{k}", 0.1) for k in range(7)]
    behaviours += [Behaviour(f"far-{k}", 1.0 + 0.1 * k) for k in range(5)]
    runs = make_runs(behaviours, seeds=range(10), frames=60)
    best = judge(*scored(runs)).answers["best"]
    assert "and 3 more are not significant; the error of far-" in best
    assert best.endswith("; and 2 more: at 95 % confidence, 10 paired runs.")


def test_too_few_runs_for_many_rivals_are_called_that_and_not_a_result():
    behaviours = [Behaviour("sharp", 0.02), *(Behaviour(f"blunt-{k}", 1.0) for k in range(5))]
    for seeds, words in (
        (1, "One drive proves nothing about blunt-0, blunt-1, blunt-2 and 2 more."),
        (6, "6 runs are too few to compare it with blunt-0, blunt-1, blunt-2 and 2 more, 8 are needed."),
    ):
        assert words in judge(*scored(make_runs(behaviours, seeds=range(seeds), frames=60))).answers["best"]


def test_too_few_runs_are_those_of_the_rivals_that_have_so_few():
    """Two rivals with 3 runs beside one with 8: 3 are too few, not 8."""
    errors = {"best": 0.1, "near": 0.105, "brief-0": 0.3, "brief-1": 0.3}
    behaviours = [Behaviour(name, error) for name, error in errors.items()]
    runs = make_runs(behaviours, seeds=range(8), frames=60)
    runs = [run for run in runs if not run.filter_name.startswith("brief") or run.seed < 3]
    verdict = judge(*scored(runs))
    best = verdict.answers["best"]
    assert {c.difference.count for c in verdict.undecided} == {3, 8}
    assert "3 runs are too few for a comparison" in best
    assert "8 runs are too few" not in best
    assert best.endswith(": at 95 % confidence, 8 paired runs.")


def test_each_filter_is_held_against_each_other_one_by_every_question():
    runs = make_runs((*THREE[:2], replace(THREE[2], error_m=0.6)), seeds=range(10), frames=120)
    table = compare_all(*scored(runs))
    assert [m.label for m in table.measures] == ["position error", "rotation error", "pose NEES / 6", "time"]
    assert len(table.cells) == 4 * 3 * 2
    worse = table.cell(POSITION, "euclidean", "inverse-depth")
    better = table.cell(POSITION, "inverse-depth", "euclidean")
    assert (worse.finding, better.finding) == (Finding.WORSE, Finding.BETTER)
    assert better.estimate == -worse.estimate
    assert table.cell(TIME, "euclidean", "dual-bearing").finding is Finding.BETTER
    worse_nees = table.cell(POSE_NEES, "euclidean", "inverse-depth")
    assert "farther from its ideal" in sentence("change", POSE_NEES, worse_nees)
    assert table.cell(POSITION, "inverse-depth", "inverse-depth") is None


def test_all_may_be_held_against_a_baseline():
    runs = make_runs(THREE, seeds=range(8), frames=60)
    table = compare_all(*scored(runs), baseline="dual-bearing")
    pairs = {("inverse-depth", "dual-bearing"), ("euclidean", "dual-bearing")}
    assert {(name, against) for _, name, against in table.cells} == pairs | {pair[::-1] for pair in pairs}
    with pytest.raises(ValueError, match="baseline must be one of inverse-depth, dual-bearing, euclidean, got 'dual'"):
        compare_all(*scored(runs), baseline="dual")


def test_a_filter_without_a_common_run_is_told_in_a_sentence_of_its_own():
    runs = make_runs(THREE[:2], seeds=range(8), frames=60)
    apart = [run for run in runs if (run.filter_name == THREE[0].name) == (run.seed < 4)]
    verdict = judge(*scored(apart))
    (other,) = verdict.comparisons
    assert f" No run to compare with {other}." in verdict.answers["best"]


def test_no_survivor_has_its_own_words():
    runs = make_runs(THREE_ONE_DIVERGING[2:], frames=240)
    assert judge(*scored(runs)).headline == "There is no verdict: euclidean diverged in 5 of 5 runs."


def test_divergence_is_judged_by_the_limit_of_the_scenario():
    """Errors of 5 % of the way: with a limit of 1 % all is lost, and that is no chance."""
    off = Behaviour("off", 10.0)
    runs = make_runs((THREE[0], off), seeds=range(10), frames=240)
    strict, lenient = (judge(*scored(runs, divergence_percent=percent)) for percent in (1.0, 90.0))
    assert strict.comparisons["off"].divergences.only_a == 10
    assert strict.comparisons["off"].words == "off diverged in 10 of 10 runs"
    assert lenient.comparisons["off"].divergences.only_a == 0
    assert "diverged" not in lenient.headline


def test_equal_filters_tie():
    twin = Behaviour("twin", 0.1)
    runs = make_runs((twin, Behaviour("clumsy", 0.4)), seeds=range(8), frames=60)
    copies = [
        replace(run, filter_name="copy", positions=run.true_positions + 1.0001 * (run.positions - run.true_positions))
        for run in runs
        if run.filter_name == "twin"
    ]
    verdict = judge(*scored([*runs, *copies]))
    assert verdict.leaders == ("twin", "copy")
    assert verdict.is_shown
    assert verdict.answers["best"].startswith("twin and copy tie as the most accurate, with a position error of ")
    assert "the same to within 0.1 % in all 8 runs" in verdict.headline
    assert "The error of clumsy is" in verdict.headline
    assert not re.search(r"[+−]0\.?0* ", verdict.headline)
    alone = judge(*scored([run for run in [*runs, *copies] if run.filter_name != "clumsy"]))
    assert alone.answers["best"].startswith("twin and copy tie: their position error is ")
    assert not alone.is_shown
