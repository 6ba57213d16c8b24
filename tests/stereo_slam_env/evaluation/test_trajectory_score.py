"""Judgement of any trajectory, of several together, and of pairs without a truth; against smfeval (15 s)."""

import json
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

import stereo_slam_env as sse
from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.evaluation import trajectory_metrics as metrics
from stereo_slam_env.evaluation.bands import block_length, mean_band, mean_interval, stationary_rows
from stereo_slam_env.evaluation.claims import crps, energy_scores
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.trajectory_runs import score_runs
from stereo_slam_env.evaluation.trial import estimate_of, reference_of
from stereo_slam_env.recording.recording import Reference
from stereo_slam_env.recording.trajectory import Trajectory
from stereo_slam_env.recording.trajectory_files import load_trajectory, save_trajectory

from ..benchmark.small_recordings import small_recording

needs_smfeval = pytest.mark.skipif(find_spec("smfeval") is None, reason="needs smfeval (extra dev)")


def drives(count=400, seed=0, inflate=1.0, size=1.0, **about):
    """A winding drive, and an estimate whose independent errors have `inflate` times the claimed covariance."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(count)
    positions = np.cumsum(np.column_stack([np.sin(t / 5), 0.1 * np.cos(t / 3), np.cos(t / 5)]), axis=0)
    orientations = Rotation.from_rotvec(np.column_stack([0 * t, t / 5, 0.1 * np.sin(t)])).as_quat()
    factor = 0.02 * rng.normal(size=(count, 6, 6))
    covariances = size**2 * (factor @ factor.swapaxes(1, 2) + 1e-5 * np.eye(6))
    errors = np.sqrt(inflate) * (np.linalg.cholesky(covariances) @ rng.normal(size=(count, 6, 1)))[..., 0]
    poses = [Pose(p, q) @ Pose.exp(e).inverse() for p, q, e in zip(positions, orientations, errors, strict=True)]
    estimate = Trajectory(
        np.array([T.position for T in poses]),
        np.array([T.orientation for T in poses]),
        t,
        covariances,
        **{"tangent": "right", "name": "mine", "body": "camera", **about},
    )
    return estimate, Trajectory(positions, orientations, t, name="truth", body="camera")


def test_a_true_claim_is_found_consistent():
    """Means, coverage and log score of independent errors, within 99.9 % of what chance allows."""
    estimate, truth = drives(2000)
    score = sse.evaluate_trajectory(estimate, truth)
    assert score.frames == 1999
    for name, dof in (("pose", 6), ("position", 3), ("rotation", 3)):
        claim, n = score.claims[name], score.frames
        low, high = chi2(dof * n).ppf([0.0005, 0.9995]) / n
        assert low < claim.nees.mean < high
        assert claim.nees.low < dof < claim.nees.high
        assert 0.9 < claim.scale_gap < 1.1
        for probability, share in claim.coverage.items():
            low, high = binom(n, probability).ppf([0.0005, 0.9995]) / n
            assert low <= share <= high
        assert claim.log_score.mean == pytest.approx(claim.calibration + claim.sharpness)
        assert claim.calibration == pytest.approx(0.5 * claim.nees.mean)
        assert claim.verdict.startswith("consistent")


@pytest.mark.parametrize("tangent", ["position-rotation", "right", "left"])
def test_the_doubt_of_a_reference_is_carried_into_the_error_of_the_estimate(tangent):
    """All error is the reference's, along its own axes: NEES of a reference that is as wrong as it says is exact."""
    _, truth = drives(60)
    rng = np.random.default_rng(8)
    sigmas = np.array([3.0, 0.1, 0.02]) * 1e-3
    shifts = sigmas * rng.standard_normal((60, 3))
    doubt = np.tile(np.diag([*sigmas**2, *np.full(3, 1e-12)]), (60, 1, 1))
    reference = replace(truth, positions=truth.positions + shifts, covariances=doubt)
    estimate = replace(truth, covariances=np.tile(1e-18 * np.eye(6), (60, 1, 1)), tangent=tangent, name="mine")
    score = sse.evaluate_trajectory(estimate, reference)
    expected = np.sum((shifts[1:] / sigmas) ** 2, axis=1).mean()
    assert score.claims["pose"].nees.mean == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(("inflate", "verdict"), [(9.0, "overconfident"), (1 / 25.0, "too cautious")])
def test_a_claim_that_is_wrong_by_a_factor_is_told_that_factor(inflate, verdict):
    score = sse.evaluate_trajectory(*drives(2000, inflate=inflate))
    for claim in score.claims.values():
        assert claim.scale_gap == pytest.approx(inflate, rel=0.1)
        assert claim.verdict.startswith(f"{verdict}: errors are ")
    assert score.claims["pose"].error_ratio == pytest.approx(inflate**0.5, rel=0.05)


def test_errors_are_those_of_the_metrics():
    estimate, truth = drives()
    score = sse.evaluate_trajectory(estimate, truth)
    pair = estimate.positions[1:], truth.positions[1:]
    assert score.position_rmse_m == metrics.ate_unaligned(*pair)
    assert score.ate_rigid_m == metrics.ate_rigid(*pair)
    assert score.path_m == metrics.path_length(pair[1])
    assert score.end_drift_percent == metrics.end_drift_percent(*pair)
    angles = metrics.rotation_errors(estimate.orientations[1:], truth.orientations[1:])
    assert score.rotation_rmse_deg == pytest.approx(np.rad2deg(metrics.root_mean_square(angles)))


# ---- which poses belong together, and in which world ----------------------------------------------------------------


def test_poses_are_paired_by_time_each_once():
    estimate, truth = drives(100)
    later = replace(estimate, timestamps=estimate.timestamps + 0.004)
    score = sse.evaluate_trajectory(later, truth.rows(np.arange(0, 100, 2)))
    assert (score.frames, score.unmatched) == (49, 50)
    np.testing.assert_array_equal(score.times, truth.timestamps[2::2])
    with pytest.raises(ValueError, match="0 poses in common"):
        sse.evaluate_trajectory(replace(estimate, timestamps=estimate.timestamps + 0.05), truth)
    assert sse.evaluate_trajectory(replace(estimate, timestamps=estimate.timestamps + 0.03), truth, max_gap=0.031)


def test_files_without_times_are_paired_row_by_row(tmp_path):
    estimate, truth = drives(60)
    save_trajectory(tmp_path / "truth.kitti", truth)
    score = sse.evaluate_trajectory(estimate, tmp_path / "truth.kitti")
    assert score.position_rmse_m == pytest.approx(sse.evaluate_trajectory(estimate, truth).position_rmse_m, abs=1e-8)
    assert [window.seconds for window in score.windows] == [1.0, 3.0]
    with pytest.raises(ValueError, match="estimate has 59 poses, reference 60"):
        sse.evaluate_trajectory(estimate.rows(slice(1, None)), tmp_path / "truth.kitti")


@pytest.mark.parametrize("align", ["start", "rigid"])
def test_another_world_is_aligned_and_the_claims_with_it(align):
    T = Pose(np.array([30.0, -5.0, 8.0]), Rotation.from_rotvec([0.5, 2.0, -0.3]).as_quat())
    estimate, truth = drives()
    exact = replace(truth, covariances=estimate.covariances, tangent="left", name="exact").moved(T)
    aligned = sse.evaluate_trajectory(exact, truth, align=align)
    assert aligned.alignment == align
    assert aligned.position_rmse_m < 1e-9
    assert aligned.claims["pose"].nees.mean < 1e-6
    assert sse.evaluate_trajectory(exact, truth).position_rmse_m > 10.0
    here = sse.evaluate_trajectory(estimate, truth, align=align).claims["pose"].nees.mean
    there = sse.evaluate_trajectory(estimate.moved(T), truth, align=align).claims["pose"].nees.mean
    assert there == pytest.approx(here, rel=1e-6)


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_an_alignment_that_is_not_determined_is_refused(speed):
    t = 0.1 * np.arange(50)
    positions = np.array([5.0, 6.0, 7.0]) + np.outer(speed * t, [1.0, 0.0, 2.0])
    straight = Trajectory(positions, np.tile([0.0, 0.0, 0.0, 1.0], (50, 1)), t)
    with pytest.raises(ValueError, match="does not determine a rigid alignment: align by 'start'"):
        sse.evaluate_trajectory(straight, straight, align="rigid")
    score = sse.evaluate_trajectory(straight, straight, align="start")
    assert score.position_rmse_m == pytest.approx(0.0, abs=1e-12)
    assert (score.end_drift_percent is None) == (speed == 0.0)


@pytest.mark.parametrize(
    ("change", "options", "complaint"),
    [
        ({"body": "imu"}, {}, "poses of imu, reference of camera"),
        ({}, {"up": "w"}, "up must be one of x, y, z, got 'w'"),
        ({}, {"align": "rigid", "align_seconds": -1.0}, "align_seconds"),
        ({}, {"align": "sim3", "align_seconds": 0.0}, "one pose does not determine the scale"),
        ({}, {"align": "yaw"}, "align must be one of none, start, gravity-yaw, rigid, sim3, got 'yaw'"),
        ({}, {"max_gap": 0.0}, "max_gap"),
    ],
)
def test_what_cannot_be_compared_is_refused(change, options, complaint):
    estimate, truth = drives(20)
    with pytest.raises(ValueError, match=complaint):
        sse.evaluate_trajectory(replace(estimate, **change), truth, **options)


# ---- claims ---------------------------------------------------------------------------------------------------------


def test_without_covariances_there_are_errors_and_no_claims():
    estimate, truth = drives(50)
    score = sse.evaluate_trajectory(replace(estimate, covariances=None), truth)
    assert score.claims == {}
    assert {window.nees for window in score.windows} == {None}
    assert score.position_rmse_m > 0


def test_what_the_reference_claims_of_itself_is_added():
    """Errors of both, each as claimed: consistent; by the estimate's claim alone it is not."""
    rng = np.random.default_rng(3)
    estimate, truth = drives(2000)
    sigmas = np.repeat([0.05, 0.02], 3)
    errors = sigmas * rng.normal(size=(2000, 6))
    seen = replace(
        truth,
        positions=truth.positions + errors[:, :3],
        orientations=rotations.multiply(truth.orientations, rotations.exp_quaternion(errors[:, 3:])),
        covariances=np.tile(np.diag(sigmas**2), (2000, 1, 1)),
    )
    fair = sse.evaluate_trajectory(estimate, seen).claims["pose"]
    assert 5.7 < fair.nees.mean < 6.3
    assert sse.evaluate_trajectory(estimate, replace(seen, covariances=None)).claims["pose"].nees.mean > 12.0


@pytest.mark.parametrize("lie", [0.0, -1.0])
@pytest.mark.parametrize("doubt", [None, 1.0])
def test_covariances_that_are_none_are_counted_and_the_claim_is_none(lie, doubt):
    """Also where the reference states errors of its own, which would make the sum definite."""
    estimate, truth = drives(400)
    stated = None if doubt is None else np.tile(doubt * np.eye(6), (400, 1, 1))
    covariances = estimate.covariances.copy()
    covariances[10:15] *= lie
    false = replace(estimate, covariances=covariances)
    score = sse.evaluate_trajectory(false, replace(truth, covariances=stated))
    assert score.unusable == 5
    claim = score.claims["pose"]
    assert (claim.frames, claim.unusable) == (394, 5)
    assert claim.verdict == "none: 5 of 399 covariances are not positive definite"
    assert {window.nees for window in score.windows if window.seconds == 1.0} == {None}
    honest = sse.evaluate_trajectory(estimate, truth)
    assert score.against(honest).log_score_difference is None
    assert honest.against(honest).log_score_difference is not None


def test_the_first_pose_may_be_known_exactly():
    """Both start there, and it is not scored."""
    estimate, truth = drives(400)
    covariances = estimate.covariances.copy()
    covariances[0] = 0.0
    score = sse.evaluate_trajectory(replace(estimate, covariances=covariances), truth)
    assert score.unusable == 0
    assert score.windows[0].nees is not None


def test_a_file_whose_covariances_are_all_none_is_refused():
    estimate, truth = drives(50)
    with pytest.raises(ValueError, match=r"none of the covariances of .* is positive definite: correct them, or leave"):
        sse.evaluate_trajectory(replace(estimate, covariances=np.zeros((50, 6, 6))), truth)


def test_windows_hold_the_motion_and_a_lower_bound_of_its_nees():
    """For independent errors the bound is the value; small ones, since a motion turns with its first pose."""
    estimate, truth = drives(4001, size=0.1)
    score = sse.evaluate_trajectory(estimate, truth)
    windows = score.windows
    found = [(window.seconds, window.windows) for window in windows]
    assert found == [(1.0, 400), (3.0, 133), (10.0, 40), (30.0, 13), (100.0, 4)]
    one = windows[0]
    assert 5.4 < one.nees < 6.6
    common = Pose(np.zeros(3), rotations.exp_quaternion(np.array([0.0, 0.01, 0.0])))
    turned = sse.evaluate_trajectory(estimate.moved(common), truth)
    assert turned.windows[0].translation_rmse_m == pytest.approx(one.translation_rmse_m, rel=1e-6)
    assert turned.position_rmse_m > 3.0 * score.position_rmse_m


def test_a_score_is_json():
    score = sse.evaluate_trajectory(*drives(60))
    again = json.loads(json.dumps(score.as_dict()))
    assert again["claims"]["pose"]["coverage"]["0.9"] == score.claims["pose"].coverage[0.9]
    assert again["windows"][0]["windows"] == 5


# ---- two estimates --------------------------------------------------------------------------------------------------


def test_the_better_of_two_estimates_is_named():
    good, truth = drives(1000, seed=1, name="good")
    bad, _ = drives(1000, seed=2, inflate=4.0, name="bad")
    scores = [sse.evaluate_trajectory(one, truth) for one in (good, bad)]
    verdict = scores[0].against(scores[1])
    ratio, low, high = verdict.error_ratio
    assert low < ratio < high < 1.0
    assert ratio == pytest.approx(scores[0].position_rmse_m / scores[1].position_rmse_m)
    claimed = [score.claims["pose"].log_score.mean for score in scores]
    assert verdict.log_score_difference.mean == pytest.approx(claimed[0] - claimed[1])
    assert verdict.log_score_difference.high < 0.0
    assert verdict.words.count("good is better") == 2
    again, _ = drives(1000, seed=3, name="again")
    assert scores[0].against(sse.evaluate_trajectory(again, truth)).words.count("not significant") >= 1
    assert "not significant" in scores[0].against(scores[0]).words


def test_estimates_of_other_times_are_not_compared():
    a, truth = drives(60)
    b = sse.evaluate_trajectory(a.rows(slice(0, 30)), truth)
    with pytest.raises(ValueError, match="0 scored poses in common"):
        sse.evaluate_trajectory(a.rows(slice(31, None)), truth).against(b)


# ---- the uncertainty of a mean over one run -------------------------------------------------------------------------


def correlated(rng, count, memory):
    values = np.zeros(count)
    for k, shock in enumerate(rng.normal(size=count)):
        values[k] = memory * values[k - 1] + shock
    return values


def test_the_interval_of_a_mean_knows_of_correlation():
    """First-order autoregression, 400 values with a memory of 10: an interval for independent ones holds in 35 %."""
    rng = np.random.default_rng(0)
    holds = [0.0 in mean_interval(correlated(rng, 400, 0.9)) for _ in range(100)]
    assert 0.78 <= np.mean(holds) <= 0.97
    assert np.mean([0.0 in mean_interval(rng.normal(size=400)) for _ in range(100)]) >= 0.88


def test_a_short_or_constant_series_has_blocks_of_one():
    assert block_length(np.arange(7.0)) == 1.0
    assert block_length(np.full(50, 2.0)) == 1.0
    assert mean_interval(np.full(50, 2.0)).low == 2.0
    assert np.isnan(mean_interval(np.zeros(0)).mean)


def test_blocks_go_on_by_one_and_have_the_mean_length():
    rows = stationary_rows(500, 8.0, np.random.default_rng(0), 200)
    goes_on = np.diff(rows, axis=1) % 500 == 1
    assert 1.0 / (1.0 - goes_on.mean()) == pytest.approx(8.0, rel=0.05)


# ---- other tools ----------------------------------------------------------------------------------------------------


@needs_smfeval
@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("memory", [0.0, 0.5, 0.95])
def test_the_length_of_a_block_is_that_of_smfeval_in_any_unit(memory, unit):
    from smfeval.scoring.summary import politis_white_block_length

    values = correlated(np.random.default_rng(4), 700, memory)
    assert block_length(unit * values) == pytest.approx(politis_white_block_length(values), rel=1e-9)


@needs_smfeval
def test_the_translation_figures_are_those_of_smfeval(tmp_path, capsys):
    estimate, truth = drives(300, inflate=2.0, gauge="se3")
    save_trajectory(tmp_path / "est.square", estimate)
    save_trajectory(tmp_path / "truth.tum", truth)
    save_trajectory(tmp_path / "truth.square", truth)
    arguments = ["nees", str(tmp_path / "est.square"), str(tmp_path / "truth.tum"), "--ref-body-frame", "camera"]
    assert import_module("smfeval.cli.main").main([*arguments, "--json"]) == 0
    theirs = json.loads(capsys.readouterr().out)
    ours = sse.evaluate_trajectory(tmp_path / "est.square", tmp_path / "truth.square").claims["position"]
    assert ours.claimed_scale_gap == pytest.approx(theirs["k"], rel=1e-6)
    # Ours is carried through the alignment, theirs is as claimed.
    assert ours.scale_gap == pytest.approx(theirs["k"], rel=1e-2)
    assert ours.coverage[0.9] == pytest.approx(theirs["coverage"], abs=1e-2)
    assert ours.nees.mean == pytest.approx(theirs["anees"]["anees"], rel=1e-2)


@needs_smfeval
def test_the_log_score_of_each_pose_is_that_of_smfeval():
    from smfeval.scoring import gaussian_log_score_components
    from smfeval.steps import GaussianStep

    estimate, truth = drives(50)
    score = sse.evaluate_trajectory(estimate, truth)
    for k in range(1, 50):
        step = GaussianStep(k * 0.1, estimate.positions[k], estimate.orientations[k], estimate.covariances[k])
        theirs = gaussian_log_score_components(step, truth.positions[k], truth.orientations[k]).translation
        assert score.nees["position"][k - 1] == pytest.approx(theirs.nees, rel=1e-8)
        assert score.log_scores["position"][k - 1] == pytest.approx(theirs.log_score, rel=1e-8)


# ---- runs of this package -------------------------------------------------------------------------------------------

STATED = Reference("surveyed", "By hand.", 0.003, 0.0004, 0.002)


@pytest.mark.parametrize("reference", [None, STATED])
@pytest.mark.parametrize("filter_name", ["inverse-depth", "right-invariant", "shared-anchor"])
def test_a_run_written_to_files_has_the_nees_of_its_own_figures(tmp_path, filter_name, reference):
    """Whatever error definition the filter has, and whatever is stated of the reference."""
    recording = small_recording(frames=40)
    if reference is not None:
        recording = replace(recording, truth_from=replace(reference, settled_at=0.5))
    options = {"error": "so3"} if filter_name == "shared-anchor" else {}
    run = run_filter(recording, filter_name, options, score_map=False)
    for name, trajectory in (("est", estimate_of(run)), ("truth", reference_of(run))):
        save_trajectory(tmp_path / f"{name}.square", trajectory)
    score = sse.evaluate_trajectory(tmp_path / "est.square", tmp_path / "truth.square")
    assert load_trajectory(tmp_path / "est.square").name == filter_name
    for what in ("pose", "position", "rotation"):
        series = getattr(run, f"{what}_nees")[1:]
        np.testing.assert_allclose(
            score.nees[what], series[np.isfinite(series)], rtol=1e-9 if reference is None else 1e-7
        )


def test_a_path_of_half_a_metre_has_a_drift():
    _, truth = drives(30)
    scale = 0.5 / np.linalg.norm(np.diff(truth.positions[1:], axis=0), axis=1).sum()
    short = replace(truth, positions=scale * truth.positions)
    moved = replace(short, positions=short.positions + np.linspace(0.0, 0.01, 30)[:, None] * [1.0, 0.0, 0.0])
    assert sse.evaluate_trajectory(moved, short).end_drift_percent == pytest.approx(2.0, rel=1e-2)


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
