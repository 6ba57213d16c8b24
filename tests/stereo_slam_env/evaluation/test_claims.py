"""Scores of claims: CRPS and energy score, runs taken together, pairs without a truth (10 s)."""

import json
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

import stereo_slam_env as sse
from stereo_slam_env.evaluation.bands import mean_band
from stereo_slam_env.evaluation.claims import crps, energy_scores
from stereo_slam_env.evaluation.trajectory_runs import score_runs

from .test_trajectory_score import drives

needs_smfeval = pytest.mark.skipif(find_spec("smfeval") is None, reason="needs smfeval (extra dev)")


def gaussians(count=40):
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(count, 3, 3))
    return 2.0 * rng.normal(size=(count, 3)), factor @ factor.swapaxes(1, 2) + 0.1 * np.eye(3)


def test_the_energy_score_is_the_mean_that_it_stands_for():
    """Against 20,000 draws."""
    errors, covariances = gaussians(5)
    rng = np.random.default_rng(2)
    for e, P, found in zip(errors, covariances, energy_scores(errors, covariances), strict=True):
        a, b = (rng.multivariate_normal(np.zeros(3), P, size=20_000) for _ in range(2))
        wanted = np.linalg.norm(a - e, axis=1).mean() - 0.5 * np.linalg.norm(a - b, axis=1).mean()
        assert found == pytest.approx(wanted, rel=0.03)


@needs_smfeval
def test_crps_is_that_of_smfeval():
    from smfeval.scoring.crps import translation_crps
    from smfeval.steps import GaussianStep

    errors, covariances = gaussians()
    for e, P, found in zip(errors, covariances, crps(errors, covariances), strict=True):
        full = np.eye(6)
        full[:3, :3] = P
        step = GaussianStep(0.0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), full)
        assert found == pytest.approx(translation_crps(step, e), rel=1e-12)


# ---- runs of one estimator ------------------------------------------------------------------------------------------


def biased_runs(count, excess, seed=0):
    """Runs whose errors are constant over a run, so that the NEES of each is one draw; `excess` times too large."""
    rng = np.random.default_rng(seed)
    _, truth = drives(30)
    claimed = np.tile(1e-4 * np.eye(6), (30, 1, 1))
    runs = []
    for k in range(count):
        e = np.sqrt(excess) * 0.01 * rng.normal(size=6)
        turned = sse.Trajectory(np.zeros((1, 3)), [[0, 0, 0, 1]]).pose(0).exp(np.concatenate([np.zeros(3), -e[3:]]))
        poses = [truth.pose(row) for row in range(30)]
        orientations = [(pose @ turned).orientation for pose in poses]
        run = replace(truth, positions=truth.positions - e[:3], orientations=orientations, covariances=claimed)
        runs.append(sse.evaluate_trajectory(replace(run, name=f"run {k}"), truth))
    return runs


def test_many_runs_show_what_none_of_them_shows():
    scores = biased_runs(20, excess=2.0)
    found = score_runs(scores)
    pose = found.claims["pose"]
    assert pose.each == tuple(score.claims["pose"].nees.mean for score in scores)
    assert pose.mean == pytest.approx(np.mean(pose.each))
    assert pose.band == mean_band(6, 20)
    assert pose.alone > 12
    assert pose.verdict.startswith("overconfident")
    assert f"{pose.alone} of 20 would pass for consistent" in found.words
    right = score_runs(biased_runs(20, excess=1.0, seed=3)).claims["pose"]
    assert right.verdict == "consistent, as far as 20 runs can tell"
    assert right.inside > 0.9
    json.dumps(found.as_dict())


def test_runs_that_diverged_or_claim_nothing_are_named_and_left_out():
    scores = biased_runs(3, excess=1.0)
    estimate, truth = drives(30, name="silent")
    silent = sse.evaluate_trajectory(replace(estimate, covariances=None), truth)
    away = replace(estimate, name="away", positions=estimate.positions + np.linspace(0, 900, 30)[:, None] ** 2)
    diverged = sse.evaluate_trajectory(away, truth)
    found = score_runs([*scores, silent, diverged])
    assert found.runs == ("run 0", "run 1", "run 2")
    assert set(found.left_out) == {"silent", "away"}
    assert "the estimate diverged" in found.words
    with pytest.raises(ValueError, match="from two on, 1 of 2 can be"):
        score_runs([scores[0], silent])


def test_runs_may_have_other_frames():
    _, truth = drives(60)
    estimates = [drives(60, seed=k, name=str(k))[0] for k in range(3)]
    scores = [sse.evaluate_trajectory(one.rows(np.arange(k, 60, 2)), truth) for k, one in enumerate(estimates)]
    found = score_runs(scores)
    assert len(found.times) == len(np.unique(np.concatenate([score.times for score in scores])))
    widths = found.claims["pose"].bands[1] - found.claims["pose"].bands[0]
    assert len(np.unique(widths)) == 2  # one or two runs have a frame at a time


# ---- without a truth ------------------------------------------------------------------------------------------------


def test_two_estimates_without_a_truth_contradict_each_other_or_not():
    """Independent errors: the difference has the sum of both claims; one claim that is too small is found."""
    right, _ = drives(1000, seed=1, name="one")
    other, _ = drives(1000, seed=2, name="other")
    score = sse.evaluate_trajectory(right, other, pair=True)
    assert score.alignment == "rigid"
    assert score.verdict == "the two claims do not contradict each other"
    assert 0.9 < score.claims["pose"].nees.mean / 6.0 < 1.1
    bold, _ = drives(1000, seed=2, inflate=9.0, name="bold")
    verdict = sse.evaluate_trajectory(right, bold, pair=True).verdict
    assert verdict.startswith("the two claims together are overconfident: differences are at least 2.")
    with pytest.raises(ValueError, match="pair needs covariances in both files"):
        sse.evaluate_trajectory(right, replace(other, covariances=None), pair=True)
