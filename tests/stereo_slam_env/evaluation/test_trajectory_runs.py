"""Runs of one system together: errors, losses, claims on all states, and words that are true of them (5 s)."""

import json
from dataclasses import replace

import numpy as np
import pytest

import stereo_slam_env as sse
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.trajectory_runs import score_runs
from stereo_slam_env.recording.state_beliefs import StateBelief
from stereo_slam_env.report.trajectory_table import headline

from .test_state_claims import NAMES, odometry


def runs(count=6, excess=1.0):
    return [
        (replace(estimate, name=f"{k}"), truth) for k in range(count) for estimate, truth in [odometry(60, k, excess)]
    ]


def away(estimate):
    far = estimate.positions + np.linspace(0, 90, len(estimate))[:, None] ** 2
    return replace(estimate, positions=far)


def scored(pairs):
    return [sse.evaluate_trajectory(*pair) for pair in pairs]


def test_each_state_has_a_row_with_the_band_of_all_runs():
    found = score_runs(scored(runs()))
    assert list(found.claims) == ["pose", "position", "rotation", *NAMES]
    for name in NAMES:
        assert found.claims[name].band == mean_band(3, 6)
        assert len(found.claims[name].each) == 6
        assert found.claims[name].verdict == "consistent, as far as 6 runs can tell"
    assert "But by itself" not in found.words


def test_a_state_that_contradicts_the_verdict_on_the_pose_is_said():
    found = score_runs(scored(runs(excess=3.0)))
    assert found.claims["pose"].verdict.startswith("consistent")
    assert "But by itself velocity is overconfident (" in found.words


def test_errors_are_means_and_the_worst_of_the_runs_that_stayed():
    pairs = runs(3)
    scores = scored([*pairs, (replace(away(pairs[0][0]), name="lost"), pairs[0][1])])
    found = score_runs(scores)
    each = [score.position_rmse_m for score in scores[:3]]
    assert found.errors["position"].mean == pytest.approx(np.mean(each))
    assert (found.errors["position"].worst, found.errors["position"].runs) == (max(each), 3)
    assert found.errors["velocity"].mean == pytest.approx(np.mean([s.state_rmse["velocity"] for s in scores[:3]]))
    assert found.diverged == {"lost": scores[3].diverged_at_s}
    assert found.total == 4


def test_losses_come_before_the_verdict():
    pairs = runs(4)
    pairs[1] = (away(pairs[1][0]), pairs[1][1])
    found = score_runs(scored(pairs), {"7": "no estimate"})
    assert found.words.startswith("Of 5 runs, 1 diverged, ")
    assert "s after the start (median) and 1 left nothing to score: figures are of the others" in found.words
    assert "3 runs together" in found.words
    assert "7 (no estimate)" in found.words
    plain = json.loads(json.dumps(found.as_dict()))
    assert (plain["failed"], list(plain["diverged"]), plain["alignment"]) == ({"7": "no estimate"}, ["1"], "none")


def test_runs_without_claims_are_scored_by_their_errors_where_failures_are_given():
    silent = [(replace(e, covariances=None, states={}), truth) for e, truth in runs(3)]
    found = score_runs(scored(silent), {})
    assert (found.claims, set(found.errors)) == ({}, {"position", "rotation"})
    assert found.words.startswith("0 of 3 runs have a claim that can be judged: two are needed.")
    with pytest.raises(ValueError, match="0 of 3 can be"):
        score_runs(scored(silent))


def test_a_run_that_ends_early_is_named_beside_the_figures_that_it_counts_in():
    pairs = runs(3)
    pairs[1] = (pairs[1][0].rows(slice(0, 30)), pairs[1][1])
    found = score_runs(scored(pairs))
    assert found.ended_early == {"1": pytest.approx(29 / 59)}
    assert found.words.startswith("These ended early, and count as far as they went: 1 (49 %). 3 runs together")
    longer = [(estimate.rows(slice(0, 40)), truth) for estimate, truth in runs(3)]
    assert score_runs(scored(longer)).ended_early == {}  # the truth goes on after all of them


def test_what_would_explain_one_run_is_no_reason_to_leave_it_out_and_what_explains_all_is():
    """A scale of 3 %, which the errors of a run may look like by chance, and an input has in every run."""

    def scaled(pair):
        return replace(pair[0], positions=1.03 * pair[0].positions), pair[1]

    pairs = runs(5)
    scores = scored([scaled(pairs[0]), *pairs[1:]])
    assert "has a scale of its own" in scores[0].claim.obstacle
    found = score_runs(scores)
    assert (len(found.runs), found.left_out) == (5, {})
    assert found.claims["position"].mean > 3.0 * score_runs(scores[1:]).claims["position"].mean
    with pytest.raises(ValueError, match="0 of 5 can be"):
        score_runs(scored(map(scaled, pairs)))


def test_runs_of_the_same_name_are_told_apart():
    pairs = [(replace(estimate, name="est", covariances=None, states={}), truth) for estimate, truth in runs(2)]
    assert set(score_runs(scored(pairs), {}).left_out) == {"est (1)", "est (2)"}


def test_runs_that_claim_their_states_alone_are_judged_by_these():
    pairs = [(replace(estimate, covariances=None), truth) for estimate, truth in runs(6)]
    scores = scored(pairs)
    found = score_runs(scores, {})
    assert (found.judged, len(found.runs)) == ("velocity", 6)
    assert "pose" not in found.claims
    assert found.words.startswith("6 runs together: velocity ANEES / 3 is ")
    assert "it claims no covariance of its pose; as far as one run can tell velocity is " in headline(scores[0])


def test_a_state_of_some_runs_is_judged_by_these():
    pairs = runs(4)
    pairs[0] = (replace(pairs[0][0], states={}), pairs[0][1])
    velocity = pairs[1][0].states["velocity"]
    half = {"velocity": StateBelief(velocity.values)}
    pairs[1] = (replace(pairs[1][0], states=half), pairs[1][1])
    found = score_runs(scored(pairs))
    assert len(found.claims["velocity"].each) == 2
    assert found.errors["velocity"].runs == 3


def test_a_verdict_that_hangs_on_the_alignment_says_so():
    assert "depends on the alignment" not in score_runs(scored(runs(4))).words
    pairs = []
    for estimate, truth in runs(4):
        P = estimate.covariances * np.linspace(1.0, 4.0, 60)[:, None, None]
        pairs.append((replace(estimate, covariances=P, gauge=None, positions=estimate.positions + 0.04), truth))
    found = score_runs(scored(pairs))
    assert set(found.other_gauges) >= {"none", "rigid"}
    assert "It depends on the alignment: it is " in found.words
