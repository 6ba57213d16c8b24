"""What is claimed against what is true, in words, for made-up policies whose truth is known (3 s)."""

import numpy as np
import pytest

from stereo_slam_env.benchmark.statistics.differences import Difference, signed
from stereo_slam_env.benchmark.statistics.policy_verdict import Agreement, agreement_of, judge_policies
from stereo_slam_env.benchmark.statistics.verdict import Consistency
from stereo_slam_env.report.overview import policy_overview

from ....synthetic_runs import Behaviour, make_runs, scored

SEEDS = range(24)
FIXED = Behaviour("fixed", 0.10)
BETTER = Behaviour("greedy", 0.04)
NO_BETTER = Behaviour("boasts", 0.10, overconfidence=2.0)
MODEST = Behaviour("modest", 0.04, overconfidence=0.4)
WORSE = Behaviour("dreams", 0.30)
SAME = Behaviour("other", 0.10)


def judged(*behaviours, seeds=SEEDS):
    runs = make_runs((FIXED, *behaviours), seeds, frames=60)
    summaries, figures = scored(runs)
    return judge_policies(summaries, figures, baseline="fixed"), summaries


def test_a_policy_that_claims_less_and_is_better_is_believed():
    verdict, _ = judged(BETTER)
    found = verdict.comparisons["greedy"]
    assert (found.agreement, found.is_sound) == (Agreement.AGREE, True)
    assert found.words.startswith("greedy claims 60 % less uncertainty of the final position than fixed (")
    assert "% smaller along the drive" in found.words
    assert found.words.endswith("claim and truth agree.")
    assert verdict.best == "greedy"
    assert "greedy leaves the pose least uncertain at the end" in verdict.headline
    assert "Claim and truth agree." in verdict.headline
    assert "Not to be taken at its word" not in verdict.headline


def test_a_policy_that_claims_less_and_is_no_better_is_not():
    verdict, _ = judged(NO_BETTER)
    found = verdict.comparisons["boasts"]
    assert (found.agreement, found.consistency) == (Agreement.DISAGREE, Consistency.OVERCONFIDENT)
    assert "claims 50 % less uncertainty" in found.words
    assert "the true position error does not differ significantly (" in found.words
    assert "claim and truth disagree; and it is overconfident, by the mean of 24 runs" in found.words
    assert "Not to be taken at its word: boasts;" in verdict.headline


def test_a_policy_that_is_better_and_does_not_claim_it_disagrees_too():
    found = judged(MODEST)[0].comparisons["modest"]
    assert found.agreement is Agreement.DISAGREE
    assert found.consistency is Consistency.CAUTIOUS
    assert "and it claims more uncertainty than it has" in found.words


def test_a_worse_policy_that_owns_up_to_it_agrees():
    verdict, _ = judged(WORSE)
    found = verdict.comparisons["dreams"]
    assert (verdict.best, found.agreement) == ("fixed", Agreement.AGREE)
    assert "claims 200 % more uncertainty of the final position than fixed" in found.words
    assert "% larger along the drive" in found.words


@pytest.mark.parametrize(
    ("claim", "truth", "expected"),
    [
        (-0.3, (-0.5, -0.1), Agreement.AGREE),
        (-0.3, (-0.5, 0.1), Agreement.OPEN),
        (-0.3, (-0.2, 0.1), Agreement.DISAGREE),
        (-0.3, (0.1, 0.2), Agreement.DISAGREE),
        (0.3, (-0.1, 0.4), Agreement.OPEN),
    ],
)
def test_what_the_truth_says_to_a_claim(claim, truth, expected):
    def difference(low, high):
        sure = low > 0 or high < 0
        return Difference(20, 0.5 * (low + high), (low, high), 0.01 if sure else 0.5)

    assert agreement_of(difference(claim - 0.05, claim + 0.05), [difference(*truth)] * 2) is expected


def test_few_runs_show_nothing():
    found = judged(BETTER, seeds=range(3))[0].comparisons["greedy"]
    assert found.agreement is Agreement.NOTHING_SHOWN
    assert "3 paired runs are too few, 6 are needed" in found.words
    assert f"along the drive {signed(found.path.percent)} %; at the end" in found.words  # no interval


def test_intervals_grow_with_the_number_of_policies():
    one = judged(BETTER)[0].comparisons["greedy"].path
    three = judged(BETTER, WORSE, SAME)[0].comparisons["greedy"].path
    assert (one.comparisons, three.comparisons) == (1, 3)
    assert np.diff(three.interval) > np.diff(one.interval)


def test_policies_that_diverged_are_not_the_best():
    runs = make_runs((FIXED, Behaviour("lost", 0.02, diverges=True)), SEEDS, frames=240)
    verdict = judge_policies(*scored(runs, divergence_percent=1.0), baseline="fixed")
    assert verdict.best == "fixed"
    assert "Lost: lost diverged in " in verdict.headline


def test_the_baseline_must_take_part():
    runs = make_runs((BETTER, SAME), range(2), frames=30)
    with pytest.raises(ValueError, match="baseline must be one of greedy, other, got 'fixed'"):
        judge_policies(*scored(runs), baseline="fixed")


def test_the_first_screen_has_a_row_a_policy_and_a_sentence_for_each():
    verdict, summaries = judged(BETTER, NO_BETTER)
    markup = policy_overview(summaries, verdict)
    assert (markup.count("<tr>"), markup.count("<li>")) == (1 + 3, 2)
    words = ("What does it claim at the end?", "How wrong is it then?", "baseline", ">yes<", ">no<", "not significant")
    assert [said for said in words if said not in markup] == []
