"""Every sentence of a verdict is true of the runs it is about: few, short, lost, equal, without truth (5 s)."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import binomtest, wilcoxon

from stereo_slam_env.benchmark.statistics.policy_verdict import judge_policies
from stereo_slam_env.benchmark.statistics.verdict import judge
from stereo_slam_env.report.overview import overview

from ....synthetic_runs import Behaviour, make_bounds, make_runs, scored

GOOD, FAIR, CLUMSY = Behaviour("good", 0.10), Behaviour("fair", 0.11), Behaviour("clumsy", 0.8)
BOLD, SHY = Behaviour("bold", 0.10, overconfidence=8.0), Behaviour("shy", 0.10, overconfidence=0.1)


def situation(behaviours, seeds=1, frames=60, lost=(), failed=True, truth="full", bounds=False):
    """Runs of made-up filters; `lost`: how many runs of each filter fail, or else stray, by its name."""
    runs = make_runs(behaviours, range(seeds), frames, truth)
    lost = dict(lost)
    astray = np.array([1e3, 0.0, 0.0])
    runs = [
        run
        if run.seed >= lost.get(run.filter_name, 0)
        else replace(run, failure="frame 3: gone")
        if failed
        else replace(run, positions=run.positions + np.linspace(0, 1, len(run))[:, None] * astray)
        for run in runs
    ]
    return scored(runs, bounds=make_bounds(runs) if bounds else None)


def headline(*behaviours, **how):
    return judge(*situation(behaviours, **how)).headline


SAID = {
    "one run of four frames": (
        ((GOOD,), {"frames": 5}),
        ["it is consistent, as far as one run of 4 frames can tell."],
        ["knows how wrong", "runs"],
    ),
    "one run": (((GOOD,), {"seeds": 1}), ["it is consistent, as far as one run can tell."], ["knows", "by the mean"]),
    "two runs": (((GOOD, FAIR), {"seeds": 2}), ["as far as 2 runs can tell.", "2 runs are too few"], ["most accurate"]),
    "five runs": (((GOOD, CLUMSY), {"seeds": 5}), ["as far as 5 runs can tell.", "6 are needed"], ["most accurate"]),
    "ten runs": (((GOOD, CLUMSY), {"seeds": 10}), ["most accurate", "by the mean of 10 runs."], ["as far as"]),
    "one run, overconfident": (
        ((BOLD,), {}),
        ["above its band (0.21 to 2.41): it is overconfident, as far as one run can tell."],
        [],
    ),
    "one run, too cautious": (((SHY,), {}), ["more uncertainty than it has, as far as one run can tell."], []),
    "ten runs, overconfident": (((BOLD,), {"seeds": 10}), ["it is overconfident, by the mean of 10 runs."], []),
    "one run with a bound": (((GOOD,), {"bounds": True}), ["(1 run) of the Cramér–Rao bound"], []),
    "the first filter fails in the only run": (
        ((FAIR, GOOD), {"lost": {"fair": 1}}),
        ["fair, the first of the 2 filters, failed in the only run. good has the smallest position error of the"],
        ["chance", "most accurate", "1 of 1"],
    ),
    "the first filter strays in the only run": (
        ((FAIR, GOOD), {"lost": {"fair": 1}, "failed": False}),
        ["fair, the first of the 2 filters, diverged in the only run. good has"],
        ["chance", "most accurate", "1 of 1"],
    ),
    "another filter fails in the only run": (
        ((GOOD, FAIR), {"lost": {"fair": 1}}),
        ["good has the smallest position error of the filters that never diverged", "fair failed in the only run."],
        ["chance", "most accurate", "the first of"],
    ),
    "another filter fails in all of three": (
        ((GOOD, FAIR), {"seeds": 3, "lost": {"fair": 3}}),
        ["fair failed in 3 of 3 runs."],
        ["chance", "most accurate"],
    ),
    "another filter fails in all of eight": (
        ((GOOD, FAIR), {"seeds": 8, "lost": {"fair": 8}}),
        ["good is the most accurate", "fair failed in 8 of 8 runs."],
        ["chance"],
    ),
    "another filter fails once in eight": (
        ((GOOD, FAIR), {"seeds": 8, "lost": {"fair": 1}}),
        ["fair failed in 1 of 8 runs, which may be chance"],
        ["most accurate", "the first of"],
    ),
    "the first filter fails once in eight": (
        ((GOOD, FAIR), {"seeds": 8, "lost": {"good": 1}}),
        ["good, the first of the 2 filters, failed in 1 of 8 runs, which may be chance."],
        ["most accurate", "good failed"],
    ),
    "the only filter fails": (((GOOD,), {"lost": {"good": 1}}), ["no verdict: good failed in the only run."], []),
    "all fail": (
        ((GOOD, FAIR), {"seeds": 2, "lost": {"good": 2, "fair": 2}}),
        ["None came through every run: good failed in 2 of 2 runs; fair failed in 2 of 2 runs."],
        ["ground truth"],
    ),
    "no truth": (((GOOD, FAIR), {"truth": "none"}), ["There is no ground truth here"], ["consistent", "best"]),
    "too short": (((GOOD,), {"frames": 3}), ["Too short for a verdict: 2 frames"], ["consistent", "no ground truth"]),
}  # fmt: skip


@pytest.mark.parametrize("name", SAID)
def test_what_is_said_of_a_situation(name):
    (behaviours, how), says, says_not = SAID[name]
    said = headline(*behaviours, **how)
    for words in says:
        assert words in said
    for words in says_not:
        assert words not in said


def test_filters_that_are_equal_in_the_only_run_tie_in_it():
    runs = make_runs((GOOD,), range(1), 60)
    said = judge(*scored([*runs, *(replace(run, filter_name="twin") for run in runs)])).headline
    assert said.startswith("good and twin tie: their position error is ")
    assert "the same in the only run" in said


def test_runs_that_failed_and_runs_that_strayed_are_both_named():
    runs = make_runs((GOOD, FAIR), range(4), 60)
    far = np.linspace(0, 1, 60)[:, None] * [1e3, 0.0, 0.0]
    runs = [replace(r, positions=r.positions + far) if (r.filter_name, r.seed) == ("fair", 0) else r for r in runs]
    runs = [replace(r, failure="frame 3: gone") if (r.filter_name, r.seed) == ("fair", 1) else r for r in runs]
    assert "fair diverged or failed in 2 of 4 runs" in judge(*scored(runs)).headline


COUNTS = (1, 2, 5, 6, 8, 10)
LOST = ({}, {"good": 1}, {"fair": 1}, {"fair": 99}, {"good": 99}, {"good": 99, "fair": 99, "clumsy": 99})
ALL = [
    (count, frames, lost, failed)
    for count, frames, lost, failed in product(COUNTS, (5, 60), LOST, (True, False))
    if lost or failed
]


@pytest.mark.parametrize(("count", "frames", "lost", "failed"), ALL)
def test_no_sentence_says_more_than_the_runs_show(count, frames, lost, failed):
    summaries, figures = situation((GOOD, FAIR, CLUMSY), count, frames, lost, failed)
    verdict = judge(summaries, figures)
    said = verdict.headline
    assert "knows how wrong" not in said
    for judged in re.findall(r"it is (?:consistent|overconfident)[^.]*\.|than it has[^.]*\.", said):
        hedge = "as far as" if count < 6 else f"by the mean of {count} runs"
        assert hedge in judged
        assert ("of 4 frames" in judged or "frames in all" in judged) == (frames == 5)
    assert f"{count} of {count} runs, which may be chance" not in said
    assert "1 of 1 runs" not in said
    if lost.get("good") and verdict.best is not None:
        assert said.startswith("good, the first of the 3 filters, ")
    if "most accurate" in said:
        assert all(is_shown(figures, verdict.best, s.filter_name, len(summaries) - 1) for s in summaries)


def is_shown(figures, best, other, comparisons):
    """Whether a signed-rank test of the errors, or a binomial one of the losses, shows the best one to be better."""
    if other == best:
        return True
    keys = list(figures[best].of_run)
    ours, theirs = ([figures[name].of_run[key] for key in keys] for name in (best, other))
    gaps = [
        np.log(b["position_rmse_m"] / a["position_rmse_m"])
        for a, b in zip(ours, theirs, strict=True)
        if a["position_rmse_m"] and b["position_rmse_m"]
    ]
    losses = sum(b["diverged"] > a["diverged"] for a, b in zip(ours, theirs, strict=True))
    p_values = [wilcoxon(gaps).pvalue if len(gaps) > 1 else 1.0, binomtest(losses, losses).pvalue if losses else 1.0]
    return min(p_values) * comparisons <= 0.05


@pytest.mark.parametrize("count", COUNTS)
def test_the_table_of_answers_calls_worse_only_what_is_shown_to_be(count):
    summaries, figures = situation((GOOD, FAIR, CLUMSY), count, 60, {"fair": 1})
    verdict = judge(summaries, figures)
    page = str(overview(summaries, verdict))
    shown = [c for c in verdict.comparisons.values() if c.difference.finding.value == "worse"]
    assert ("worse" in page) == bool(shown)
    assert (f"consistent, by {count} run" in page) == (count < 6)
    if count == 1:
        assert "failed 1/1" in page


def test_policies_that_claim_the_same_are_not_ranked():
    runs = make_runs((GOOD,), range(8), 60)
    runs += [replace(run, filter_name="twin") for run in runs]
    for baseline in ("good", "twin"):
        said = judge_policies(*scored(runs), baseline=baseline).headline
        assert said.startswith(f"No policy leaves the pose less uncertain at the end than {baseline}")
