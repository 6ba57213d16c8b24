"""The decision rule, in every direction, on made-up numbers (< 1 s)."""

from itertools import product

import numpy as np
import pytest

from filters.catalogue.registry import usual_options
from stereo_slam_env.paper.paper_claims import (
    EUCLIDEAN,
    FILTERS,
    REAL,
    RENDERED,
    SIMULATION,
    TABLE,
    Claim,
    ClaimFinding,
    ClaimVerdict,
    Interval,
    Range,
    Sentence,
    decide,
    describe,
    single_interval,
)

NAN, INFINITY = float("nan"), float("inf")
SENTENCE = Sentence("key", "4.3", "what the paper says", "what is measured", "figure-4")
HOLDS, FAILS, OPEN = Interval(0.8, 0.7, 0.9), Interval(1.3, 1.2, 1.4), Interval(1.0, 0.9, 1.1)
BELOW_ONE = Range(high=1.0)


def claim(measured, conditions):
    return Claim(SENTENCE, tuple(ClaimFinding(c, m, BELOW_ONE) for c, m in zip(conditions, measured, strict=True)))


def grid(**factors):
    return [dict(zip(factors, levels, strict=True)) for levels in product(*factors.values())]


@pytest.mark.parametrize(
    ("measured", "asked", "verdict"),
    [
        (Interval(0.8, 0.7, 0.9), Range(high=1.0), ClaimVerdict.HOLDS),
        (Interval(0.8, 0.7, 1.0), Range(high=1.0), ClaimVerdict.HOLDS),  # the limit belongs to the range
        (Interval(1.2, 1.1, 1.3), Range(high=1.0), ClaimVerdict.DOES_NOT_HOLD),
        (Interval(0.9, 0.7, 1.1), Range(high=1.0), ClaimVerdict.NOT_SHOWN),
        (Interval(1.1, 0.9, 1.3), Range(high=1.0), ClaimVerdict.NOT_SHOWN),
        (Interval(0.95, 0.945, 0.955), Range(0.94, 0.96), ClaimVerdict.HOLDS),
        (Interval(0.97, 0.965, 0.975), Range(0.94, 0.96), ClaimVerdict.DOES_NOT_HOLD),
        (Interval(0.84, 0.83, 0.85), Range(0.94, 0.96), ClaimVerdict.DOES_NOT_HOLD),
        (Interval(0.95, 0.90, 1.00), Range(0.94, 0.96), ClaimVerdict.NOT_SHOWN),  # true or not: too little was measured
        (Interval(5.0, 3.0, INFINITY), Range(low=1.21), ClaimVerdict.HOLDS),
        (Interval(0.5, NAN, NAN), Range(high=1.0), ClaimVerdict.NOT_SHOWN),
        (Interval(NAN, NAN, NAN), Range(), ClaimVerdict.NOT_SHOWN),
    ],
)
def test_one_condition(measured, asked, verdict):
    assert decide(measured, asked) is verdict


@pytest.mark.parametrize(
    ("measured", "verdict", "says"),
    [
        ([HOLDS, HOLDS], ClaimVerdict.HOLDS, "holds"),
        ([FAILS, FAILS], ClaimVerdict.DOES_NOT_HOLD, "does not hold"),
        ([OPEN, OPEN], ClaimVerdict.NOT_SHOWN, "not shown"),
        ([HOLDS, FAILS], ClaimVerdict.HOLDS_ONLY_IF, "holds only if noise: a"),
        ([FAILS, HOLDS], ClaimVerdict.HOLDS_ONLY_IF, "holds only if noise: b"),
        ([HOLDS, OPEN], ClaimVerdict.NOT_SHOWN, "not shown (holds if noise: a; undecided under 1 of 2)"),
        ([OPEN, FAILS], ClaimVerdict.NOT_SHOWN, "not shown (does not hold if noise: b; undecided under 1 of 2)"),
        (
            [HOLDS, FAILS, OPEN],
            ClaimVerdict.HOLDS_ONLY_IF,
            "holds only if noise: a (not shown under 1 of 3 conditions)",
        ),
    ],
)
def test_all_conditions_of_a_claim(measured, verdict, says):
    judged = claim(measured, grid(noise="abc"[: len(measured)]))
    assert judged.verdict is verdict
    assert judged.says == says


def test_a_claim_that_nothing_was_found_about_is_not_shown():
    assert Claim(SENTENCE, ()).verdict is ClaimVerdict.NOT_SHOWN
    assert Claim(SENTENCE, ()).says == "–"


def test_a_claim_is_judged_in_each_place_and_over_all():
    """Held in simulation and refuted on real drives: it holds under conditions; undecided drives do not refute it."""
    simulated = ClaimFinding({"noise": "a"}, HOLDS, BELOW_ONE)
    refuted, open_ = (ClaimFinding({"drive": name}, x, BELOW_ONE, REAL) for name, x in (("1", FAILS), ("2", OPEN)))
    judged = Claim(SENTENCE, (simulated, refuted, open_))
    assert judged.verdict is ClaimVerdict.HOLDS_ONLY_IF
    assert judged.at(SIMULATION).says == "holds"
    assert judged.at(RENDERED).findings == ()
    assert judged.at(REAL).says == "not shown (does not hold if drive: 1; undecided under 1 of 2)"
    assert Claim(SENTENCE, (simulated, open_)).verdict is ClaimVerdict.NOT_SHOWN
    assert Claim(SENTENCE, (refuted, refuted)).verdict is ClaimVerdict.DOES_NOT_HOLD


def test_one_drive_is_one_draw_of_six_numbers():
    """The interval covers the true ratio of variances in 95 % of the draws."""
    draws = np.random.default_rng(0).chisquare(6, 20_000) / 6.0 * 3.0  # claimed variance a third of the true one
    intervals = [single_interval(nees) for nees in draws[:4000]]
    covered = np.mean([one.low <= 3.0 <= one.high for one in intervals])
    assert covered == pytest.approx(0.95, abs=0.012)
    assert decide(single_interval(15.0), Range(0.83, 1.21)) is ClaimVerdict.DOES_NOT_HOLD
    assert decide(single_interval(1.0), Range(0.83, 1.21)) is ClaimVerdict.NOT_SHOWN


def test_sentences_have_a_figure_a_limit_that_is_explained_and_the_order_of_the_paper():
    assert all(entry["figure"] in TABLE["figures"] for entry in TABLE["sentences"])
    assert all(about["because"] for about in TABLE["limits"].values())
    assert {entry["limit"] for entry in TABLE["sentences"] if "limit" in entry} == set(TABLE["limits"])
    sections = [entry["section"].split(",")[0] for entry in TABLE["sentences"] if entry["key"] != "consistent"]
    assert sections == sorted(sections, key=lambda section: (section != "abstract", section))


def test_xyz_has_the_guard_that_comparisons_give_it():
    assert FILTERS[EUCLIDEAN][1] == usual_options("euclidean")


def test_conditions_are_named_by_what_they_share():
    every = grid(noise=["uvd", "pixels"], R=["diagonal", "full"], landmark=["near", "far"])

    def named(*wanted):
        return describe([c for c in every if tuple(c.values()) in wanted], every)

    assert named(("uvd", "diagonal", "near"), ("uvd", "diagonal", "far")) == "noise: uvd, R: diagonal"
    assert named(("uvd", "diagonal", "near")) == "noise: uvd, R: diagonal, landmark: near"
    right = [
        (noise, R, landmark) for noise, R in (("uvd", "diagonal"), ("pixels", "full")) for landmark in ("near", "far")
    ]
    assert named(*right) == "noise: uvd, R: diagonal; or noise: pixels, R: full"


def test_several_levels_of_a_factor_are_listed():
    every = grid(noise=["a", "b"], depth=["15 m", "30 m", "45 m"])
    chosen = [c for c in every if c["noise"] == "a" and c["depth"] != "15 m"]
    assert describe(chosen, every) == "noise: a, depth: 30 m or 45 m"


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (Range(high=2.0), "at most 2"),
        (Range(low=1.21), "at least 1.21"),
        (Range(0.94, 0.96), "0.94 to 0.96"),
        (Range(2, 2), "2"),
    ],
)
def test_a_range_says_what_is_asked(asked, words):
    assert str(asked) == words
