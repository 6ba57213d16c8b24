"""A covariance for odometries that have none: what is claimed is true of drives that drift as the model says (20 s)."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import stereo_slam_env as sse
from filters import Pose, nees
from filters.geometry import rotations
from stereo_slam_env.evaluation.drift_model import LengthCheck, drivers
from stereo_slam_env.evaluation.windows import motion_covariances, motions
from stereo_slam_env.recording.recording import adjoints
from stereo_slam_env.recording.trajectory import pose_errors

VARIANCES = 1e-6 * np.array(
    [
        [1.0, 2.0, 4.0, 0.10, 0.20, 0.05],  # white
        [4.0, 2.0, 9.0, 0.02, 0.04, 0.01],  # per metre
        [1.0, 1.0, 1.0, 0.01, 0.01, 0.01],  # per second
        [2.0, 2.0, 2.0, 0.30, 0.60, 0.30],  # per radian
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],  # per inverse track
        [0.1, 0.1, 0.4, 0.001, 0.004, 0.001],  # lasting, per metre
    ]
)


def path(count=600, seed=0, name="odometry"):
    """A winding drive of 60 s, with a stop."""
    rng = np.random.default_rng(seed)
    times = 0.1 * np.arange(count)
    speed = np.where((times > 20.0) & (times < 24.0), 0.0, 4.0 + 2.0 * np.sin(times / 7.0 + seed))
    rate = np.column_stack([0.02 * np.sin(times), 0.2 * np.sin(times / 5.0 + rng.uniform(0, 6)), 0.01 * np.cos(times)])
    poses = [Pose()]
    for k in range(1, count):
        poses.append(poses[-1] @ Pose([0.0, 0.0, 0.1 * speed[k]], rotations.exp_quaternion(0.1 * rate[k])))
    return sse.Trajectory(
        np.array([T.position for T in poses]), np.array([T.orientation for T in poses]), times, gauge=None, name=name
    )


def truth_of(estimate, seed, variances=VARIANCES):
    """A truth that differs from an estimate by errors drawn as the model says, step by step."""
    rng = np.random.default_rng(1000 + seed)
    A = adjoints(estimate.positions, estimate.orientations)
    driven = drivers(estimate)
    rates = rng.normal(size=6) * np.sqrt(variances[5])
    errors, xi = [], np.zeros(6)
    for k in range(len(estimate)):
        if k:
            xi = np.linalg.solve(A[k], A[k - 1] @ xi)
            xi = xi + rng.normal(size=6) * np.sqrt(driven[:, k] @ variances[1:5]) + driven[0, k] * rates
        errors.append(xi + rng.normal(size=6) * np.sqrt(variances[0]))
    rho, phi = np.array(errors)[:, :3], np.array(errors)[:, 3:]
    turns = np.array([rotations.exp_quaternion(angle) for angle in phi])
    return sse.Trajectory(
        estimate.positions + rotations.turned(rotations.matrix(estimate.orientations), rho),
        rotations.multiply(estimate.orientations, turns),
        estimate.timestamps,
        name="truth",
    )


def windows(seconds, estimate):
    first = np.arange(0, len(estimate) - 10 * seconds, 10 * seconds)
    return first, first + 10 * seconds


def window_nees(claimed, truth, seconds):
    first, last = windows(seconds, claimed)
    errors = pose_errors("right", *motions(claimed, first, last), *motions(truth, first, last))
    return nees(errors, motion_covariances(claimed, first, last))


@pytest.fixture(scope="module")
def drives():
    """Forty drives, each with a truth."""
    estimates = [path(seed=seed, name=f"drive {seed}") for seed in range(40)]
    return estimates, [truth_of(estimate, seed) for seed, estimate in enumerate(estimates)]


@pytest.fixture(scope="module")
def claims(drives):
    """What the right model claims of each of them."""
    return [sse.claim(estimate, sse.DriftModel(VARIANCES)) for estimate in drives[0]]


@pytest.mark.parametrize("seconds", [1, 10, 30])
def test_a_claim_is_right_where_errors_grow_as_the_model_says(drives, claims, seconds):
    values = [window_nees(claimed, truth, seconds) for claimed, truth in zip(claims, drives[1], strict=True)]
    assert np.mean(values) / 6.0 == pytest.approx(1.0, abs=0.2)


def test_each_pose_is_claimed_as_seen_from_the_first(drives, claims):
    """Whole runs, judged by `evaluate_trajectory` in the gauge that the claim was made in."""
    scores = [sse.evaluate_trajectory(claimed, truth) for claimed, truth in zip(claims, drives[1], strict=True)]
    assert {score.alignment for score in scores} == {"start"}
    assert np.mean([score.claims["pose"].nees.mean for score in scores]) / 6.0 == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("seconds", [1, 10, 30])
def test_a_written_claim_has_the_covariances_of_all_motions(tmp_path, seconds):
    estimate, model = path(), sse.DriftModel(VARIANCES)
    sse.save_trajectory(tmp_path / "est.square", sse.claim(estimate, model))
    read = sse.load_trajectory(tmp_path / "est.square")
    first, last = windows(seconds, estimate)
    right = model.covariances(estimate, first, last)
    np.testing.assert_allclose(motion_covariances(read, first, last), right, rtol=1e-6, atol=1e-14)
    some = np.arange(0, len(estimate), 5)  # as where the reference has fewer poses
    np.testing.assert_allclose(motion_covariances(read.rows(some), first // 5, last // 5), right, rtol=1e-6, atol=1e-14)


def test_another_world_and_another_body_change_no_nees_of_a_motion(drives, claims):
    claimed, truth = claims[3], drives[1][3]
    world = Pose([100.0, -20.0, 5.0], rotations.exp_quaternion([0.3, -0.2, 1.0]))
    T_bc = Pose([0.3, 0.1, -1.0], rotations.exp_quaternion([0.0, 1.5, 0.2]))
    here = window_nees(claimed, truth, 10)
    np.testing.assert_allclose(window_nees(claimed.moved(world), truth, 10), here, rtol=1e-6)
    np.testing.assert_allclose(window_nees(claimed.of_body(T_bc), truth.of_body(T_bc), 10), here, rtol=0.01)


def test_what_is_learned_from_some_drives_covers_others(drives):
    """Learned from ten, held against thirty: NEES / 6 near 1, 90 % of the windows inside."""
    estimates, truths = drives
    model = sse.calibrate(estimates[:10], truths[:10])
    for seconds in (1, 10):
        values = [
            window_nees(sse.claim(e, model), t, seconds) for e, t in zip(estimates[10:], truths[10:], strict=True)
        ]
        assert 0.8 < np.mean(values) / 6.0 < 1.2
        assert 0.85 < np.mean(np.array(values) <= chi2.ppf(0.9, 6)) < 0.95
    assert model.drives == tuple(f"drive {seed}" for seed in range(10))
    assert [check.seconds for check in model.checks] == [1.0, 3.0, 10.0, 30.0]
    assert all(0.8 < check.coverage < 1.0 for check in model.checks)


@pytest.mark.slow
def test_the_factor_makes_up_for_errors_that_the_model_cannot_have(drives):
    """Drives of which each third one drifts three times as much: the fit alone covers fewer than 90 %."""
    estimates = drives[0]
    truths = [truth_of(e, seed, VARIANCES * (9.0 if seed % 3 == 0 else 1.0)) for seed, e in enumerate(estimates)]
    model = sse.calibrate(estimates[:20], truths[:20])
    assert model.factor > 1.1
    inside = [
        window_nees(sse.claim(e, model), t, 3) <= chi2.ppf(0.9, 6)
        for e, t in zip(estimates[20:], truths[20:], strict=True)
    ]
    assert 0.85 < np.mean(inside) < 0.97


@pytest.mark.slow
def test_few_bad_windows_do_not_rule(drives):
    """A jump of a hundred deviations in one drive of ten changes the variances by less than a factor of 3."""
    estimates, truths = drives[0][:10], list(drives[1][:10])
    jump = np.where(truths[0].timestamps[:, None] > 30.0, [[1.0, 0.0, 0.0]], 0.0)
    spoilt = [replace(truths[0], positions=truths[0].positions + jump), *truths[1:]]
    first, last = windows(1, estimates[1])
    before, after = (
        sse.calibrate(estimates, some).covariances(estimates[1], first, last).trace(axis1=1, axis2=2).mean()
        for some in (truths, spoilt)
    )
    assert after < 3.0 * before


@pytest.mark.slow
def test_few_tracks_make_a_claim_larger_where_they_are_given(drives):
    """Errors by the inverse number of tracks, of which half of each drive has a twentieth: right in both halves."""
    variances = VARIANCES * [[1.0], [0.1], [0.1], [0.1], [0.0], [1.0]]
    variances[4] = [2e-3, 2e-3, 4e-3, 2e-5, 2e-5, 2e-5]
    tracks = np.where(np.arange(600) < 300, 200.0, 10.0)
    estimates = [replace(estimate, tracks=tracks) for estimate in drives[0][:20]]
    truths = [truth_of(estimate, seed, variances) for seed, estimate in enumerate(estimates)]
    known = sse.calibrate(estimates[:10], truths[:10])
    unknown = sse.calibrate([replace(e, tracks=None) for e in estimates[:10]], truths[:10])
    for model, right in ((known, True), (unknown, False)):
        held = zip(estimates[10:], truths[10:], strict=True)
        values = np.array([window_nees(sse.claim(e, model), t, 1) for e, t in held]) / 6.0
        many, few = values[:, :29].mean(), values[:, 31:].mean()
        assert bool(0.75 < many < 1.25 and 0.75 < few < 1.25) is right
    assert few / many > 4.0  # what a model without them cannot know
    with pytest.raises(ValueError, match="drive 3 has none: give both"):
        sse.claim(drives[0][3], known)
    with pytest.raises(ValueError, match="some estimates have numbers of tracks and some have none"):
        sse.calibrate([estimates[0], drives[0][1]], truths[:2])


@pytest.mark.slow
def test_a_new_drive_is_where_the_spread_of_the_others_says():
    """Drives whose variances differ by a factor drawn once a drive: 90 % of new ones in the range, which is wide."""
    rng = np.random.default_rng(5)
    estimates = [path(300, seed=seed, name=f"{seed}") for seed in range(48)]
    truths = [truth_of(e, seed, VARIANCES * np.exp(rng.normal())) for seed, e in enumerate(estimates)]
    inside = []
    for at in range(0, 48, 8):
        model = sse.calibrate(estimates[at : at + 8], truths[at : at + 8])
        low, high = model.drive_range
        assert high > 5.0 * low
        others = [k for k in range(48) if not at <= k < at + 8]
        for k in others:
            nees_of_all = [window_nees(sse.claim(estimates[k], model), truths[k], s).mean() for s in (1, 3, 10)]
            inside.append(low <= np.mean(nees_of_all) / 6.0 <= high)
    assert 0.8 < np.mean(inside) < 0.98


def test_one_drive_promises_no_coverage_and_one_truth_may_be_that_of_all(drives):
    runs = [replace(drives[0][0], name=name) for name in "ab"]
    assert sse.calibrate(runs, drives[1][:1]).drives == ("a", "b")
    model = sse.calibrate(drives[0][:1], drives[1][:1])
    assert (model.factor, model.coverage_error, model.checks, model.drive_range) == (1.0, None, (), None)


def test_a_file_has_all_of_a_model(tmp_path):
    check = LengthCheck(seconds=3.0, drives=4, windows=50, nees=6.5, coverage=0.88)
    numbers = np.arange(1.0, 37.0).reshape(6, 6)
    model = sse.DriftModel(numbers, 1.7, ("a", "b"), 0.02, (check, replace(check, seconds=10.0)), (0.4, 2.5))
    model.write(tmp_path / "model.json")
    again = sse.DriftModel.read(tmp_path / "model.json")
    np.testing.assert_array_equal(again.variances, numbers)
    assert (again.factor, again.drives, again.coverage_error, again.drive_range) == (1.7, ("a", "b"), 0.02, (0.4, 2.5))
    assert [vars(one) for one in again.checks] == [vars(check), {**vars(check), "seconds": 10.0}]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda content: "not JSON", "is no JSON"),
        (lambda content: "[]", "is no drift model"),
        (lambda content: json.dumps({**content, "format": "another"}), "its format is not"),
        (lambda content: json.dumps({**content, "variances": {}}), "'white' is missing"),
        (lambda content: json.dumps({**content, "drives": 3}), "is no drift model"),
        (lambda content: json.dumps(content).replace("1e-06", "-1e-06", 1), "finite numbers >= 0"),
        (lambda content: json.dumps(content).replace("1e-06", "1e999", 1), "finite numbers >= 0"),
        (lambda content: json.dumps(content).replace("1e-06", "0.0", 1), "no pose is exact"),
    ],
)
def test_a_file_that_is_no_model_is_refused_in_one_line(tmp_path, change, complaint):
    (tmp_path / "model.json").write_text(change(sse.DriftModel(VARIANCES).as_dict()))
    with pytest.raises(ValueError, match=rf"\A.*model\.json.*{complaint}.*\Z"):
        sse.DriftModel.read(tmp_path / "model.json")


@pytest.mark.parametrize(
    ("estimate", "truths", "complaint"),
    [
        (lambda e: replace(e, timestamps=None), 1, "has no times"),
        (lambda e: replace(e, positions=e.positions * np.linspace(1.0, 30.0, len(e))[:, None]), 1, "diverged"),
        (lambda e: replace(e, positions=0.5 * e.positions), 1, "a scale of its own"),
        (lambda e: e.of_body(Pose([0.0, 0.0, 0.0], rotations.exp_quaternion([0.0, 1.5, 0.0]))), 1, "body seems"),
        (lambda e: replace(e, timestamps=e.timestamps + 500.0), 1, "poses in common"),
        (lambda e: e.rows(slice(0, 8)), 1, "drive 0 has no two poses 1 s apart .*: give a longer drive"),
        (lambda e: e, 2, "1 estimates and 2 truths"),
    ],
)
def test_what_cannot_be_learned_from_is_refused_with_the_reason(drives, estimate, truths, complaint):
    with pytest.raises(ValueError, match=complaint):
        sse.calibrate([estimate(drives[0][0])], drives[1][:truths])
    if complaint == "has no times":
        with pytest.raises(ValueError, match=complaint):
            sse.claim(estimate(drives[0][0]), sse.DriftModel(VARIANCES))


def test_the_truth_may_be_of_another_body(drives):
    """What is learned is the drift of the estimate's own body."""
    T_bc = Pose([0.3, 0.1, -1.0], rotations.exp_quaternion([0.0, 1.5, 0.2]))
    moved = [truth.of_body(T_bc) for truth in drives[1][:2]]
    model = sse.calibrate(drives[0][:2], moved, body=T_bc)
    right = sse.calibrate(drives[0][:2], drives[1][:2])
    first, last = windows(10, drives[0][0])
    got, wanted = (one.covariances(drives[0][0], first, last) for one in (model, right))
    np.testing.assert_allclose(got, wanted, rtol=1e-6, atol=1e-9)
