"""NEES of the motion over windows, and of references with stated errors (20 s)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import stereo_slam_env as sse
from filters import Pose
from filters.geometry import rotations
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all
from stereo_slam_env.evaluation.windows import nees_floor, window_ends
from stereo_slam_env.recording.recording import GIVEN_TRUTH, SIMULATION, Reference
from stereo_slam_env.recording.trajectory import pose_errors

from ..benchmark.small_recordings import small_recording

STATED = Reference("surveyed", "By hand.", position_jitter=0.05, rotation_jitter=0.01)


def summary_of(runs):
    return summarise_all(runs, figures_of(runs, divergence_percent=10.0))[0]


def seen_by(recording, reference, seed=0):
    """The recording with a truth that has the errors that are stated of it, the first pose included."""
    rng = np.random.default_rng(seed)
    X = Pose(np.zeros(3), rotations.exp_quaternion(reference.misalignment * rng.normal(size=3)))
    poses = [X.inverse() @ frame.truth @ X for frame in recording.frames]
    poses = [
        Pose(
            T.position + reference.position_jitter * rng.normal(size=3),
            rotations.multiply(T.orientation, rotations.exp_quaternion(reference.rotation_jitter * rng.normal(size=3))),
        )
        for T in poses
    ]
    # Estimates begin where the reference does.
    start = replace(recording.start, position=poses[0].position, orientation=poses[0].orientation)
    frames = tuple(replace(frame, truth=T) for frame, T in zip(recording.frames, poses, strict=True))
    return replace(recording, frames=frames, start=start, truth_from=reference)


# ---- windows --------------------------------------------------------------------------------------------------------


def test_windows_do_not_overlap_and_are_as_long_as_they_say():
    times = np.array([0.0, 0.4, 1.0, 1.2, 1.9, 2.1, 5.0, 5.5])
    assert list(window_ends(times, 1.0)) == [(0, 2), (2, 5), (5, 6)]
    assert list(window_ends(0.1 * np.arange(31), 1.0)) == [(0, 10), (10, 20), (20, 30)]
    assert list(window_ends(times, 10.0)) == []


@pytest.mark.parametrize("filter_name", ["inverse-depth", "right-invariant"])
def test_the_motion_of_a_consistent_filter_is_consistent(filter_name):
    """30 drives of 3 windows; by windows on independent noise, within 99.9 % of what chance allows."""
    recordings = [small_recording(seed, 31, odometry=False) for seed in range(30)]
    runs = [
        run_filter(r, filter_name, {"gate": None}, score_map=False, windows=True, seed=seed)
        for seed, r in enumerate(recordings)
    ]
    values = np.concatenate([run.window_nees_1s[np.isfinite(run.window_nees_1s)] for run in runs])
    assert len(values) == 90
    low, high = chi2(6 * 90).ppf([0.0005, 0.9995]) / 90
    assert low < values.mean() < high
    assert all(np.isnan(run.window_nees_10s).all() for run in runs)
    summary = summary_of(runs)
    assert summary.window_nees_1s == pytest.approx(values.mean())
    assert summary.window_nees_10s is None
    assert summary.window_nees_1s_floor is None


def test_an_early_heading_error_that_nobody_knows_of_is_not_in_the_motion():
    """The world of the truth is turned by 30 mrad from the first frame on: what filters cannot see."""
    recording = small_recording(0, 31)
    T = Pose(np.zeros(3), rotations.exp_quaternion(np.array([0.0, 0.03, 0.0])))
    turned = replace(recording, frames=tuple(replace(f, truth=T @ f.truth) for f in recording.frames))
    runs = [run_filter(one, "inverse-depth", {"gate": None}, windows=True) for one in (recording, turned)]
    assert np.nanmean(runs[1].pose_nees[1:]) > 10.0 * np.nanmean(runs[0].pose_nees[1:])
    np.testing.assert_allclose(runs[1].window_nees_1s, runs[0].window_nees_1s, rtol=1e-9)


def test_scoring_windows_changes_no_other_figure():
    recording = small_recording(frames=25)
    plain, with_windows = (run_filter(recording, "shared-anchor", windows=windows) for windows in (False, True))
    assert np.isnan(plain.window_nees_1s).all()
    assert np.isfinite(with_windows.window_nees_1s).sum() == 2
    for name in ("positions", "pose_covariances", "pose_nees", "landmark_nees", "nis", "state_size"):
        np.testing.assert_array_equal(getattr(with_windows, name), getattr(plain, name))


@pytest.mark.usefixtures("third_party")
def test_a_filter_without_clones_has_no_windows():
    run = run_filter(small_recording(frames=25), "odometry-only", windows=True)
    assert run.failure is None
    assert np.isnan(run.window_nees_1s).all()


# ---- stated errors of the reference ---------------------------------------------------------------------------------


def test_the_covariance_of_a_motion_holds_jitter_at_both_ends_and_misalignment():
    """Against drawn ones, within 4 standard errors of each entry."""
    rng = np.random.default_rng(0)
    reference = Reference("surveyed", "By hand.", 0.02, 0.003, 0.004)
    first = Pose(np.array([3.0, 1.0, -2.0]), Rotation.from_rotvec([0.2, 0.5, -0.1]).as_quat())
    last = Pose(np.array([9.0, 0.0, 6.0]), Rotation.from_rotvec([-0.1, 1.4, 0.2]).as_quat())
    true, errors = first.inverse() @ last, []
    for _ in range(5_000):
        X = Pose(np.zeros(3), rotations.exp_quaternion(0.004 * rng.normal(size=3)))
        seen = [
            Pose(
                T.position + 0.02 * rng.normal(size=3),
                rotations.multiply(T.orientation, rotations.exp_quaternion(0.003 * rng.normal(size=3))),
            )
            for T in (first, last)
        ]
        moved = X.inverse() @ (seen[0].inverse() @ seen[1]) @ X
        poses = (true.position, true.orientation, moved.position, moved.orientation)
        errors.append(pose_errors("position-rotation", *(part[None] for part in poses))[0])
    found, stated = np.cov(np.array(errors).T), reference.relative_covariance(first, last)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    assert np.abs((found - stated) / scale).max() < 4.0 * np.sqrt(2.0 / 5_000)
    turn = np.eye(6)
    turn[:3, :3] = first.R_wc
    np.testing.assert_allclose(reference.covariance(first, last), turn @ stated @ turn.T, atol=1e-15)


@pytest.mark.parametrize("filter_name", ["inverse-depth", pytest.param("right-invariant", marks=pytest.mark.slow)])
def test_stated_errors_make_the_score_fair(filter_name):
    """30 drives against a reference whose errors are larger than the filter's: last pose, and motion over 1 s."""
    reference = replace(STATED, misalignment=0.01)
    recordings = [seen_by(small_recording(seed, 31, odometry=False), reference, seed) for seed in range(30)]
    fair = [run_filter(r, filter_name, {"gate": None}, score_map=False, windows=True) for r in recordings]
    low, high = chi2(6 * 30).ppf([0.0005, 0.9995]) / 30
    assert low < np.mean([run.pose_nees[-1] for run in fair]) < high
    assert low < np.mean([run.window_nees_1s[-1] for run in fair]) < high
    unstated = [
        run_filter(replace(r, truth_from=GIVEN_TRUTH), filter_name, {"gate": None}, score_map=False, windows=True)
        for r in recordings
    ]
    for series in ("pose_nees", "window_nees_1s"):
        floor = np.mean([getattr(run, f"{series}_floor")[-1] for run in fair])
        assert floor > 12.0
        found = [getattr(run, series)[-1] for run in unstated]
        assert abs(np.mean(found) - floor) < 4.0 * np.std(found) / np.sqrt(30)


def test_the_floor_is_what_a_consistent_filter_would_have():
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(2, 6, 6))
    P, C = factor @ factor.swapaxes(1, 2) + 0.1 * np.eye(6)
    errors = rng.multivariate_normal(np.zeros(6), P + C, 200_000)
    values = np.einsum("ki,ij,kj->k", errors, np.linalg.inv(P), errors)
    assert values.mean() == pytest.approx(nees_floor(P, C), abs=4.0 * values.std() / np.sqrt(len(values)))


def test_where_nothing_is_stated_nothing_changes():
    recording = small_recording(frames=25)
    exact, stated = (run_filter(replace(recording, truth_from=one), "inverse-depth") for one in (SIMULATION, STATED))
    assert np.isnan(exact.pose_nees_floor).all()
    np.testing.assert_array_equal(exact.pose_errors, stated.pose_errors)
    assert (stated.pose_nees[1:] < exact.pose_nees[1:]).all()
    assert (stated.pose_nees_floor[1:] > 6.0).all()


def test_frames_in_which_the_reference_settles_are_not_scored():
    recording = replace(small_recording(frames=30), truth_from=replace(SIMULATION, settled_at=1.15))
    run = run_filter(recording, "inverse-depth", windows=True)
    assert np.isnan(run.pose_nees[:12]).all()
    assert np.isfinite(run.pose_nees[12:]).all()
    assert np.flatnonzero(np.isfinite(run.window_nees_1s)).tolist() == [22]
    assert np.isfinite(run.pose_errors).all()
    figures = figures_of([run], divergence_percent=10.0)["inverse-depth"].of_run["small", None]
    assert figures["frames"] == 18
    late = np.linalg.norm(run.positions - run.true_positions, axis=1)[12:]
    assert figures["position_rmse_m"] == pytest.approx(np.sqrt(np.mean(late**2)))
    assert "settled at 1.15 s: scored from there on" in str(run.reference)
    found = [moment.nees for moment in sse.run("inverse-depth", recording)]
    np.testing.assert_allclose(found, run.pose_nees, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"position_jitter": -1.0}, "position_jitter of a reference must be >= 0 and finite, got -1.0"),
        ({"rotation_jitter": np.inf}, "rotation_jitter"),
        ({"misalignment": np.nan}, "misalignment"),
        ({"settled_at": np.nan}, "settled_at of a reference must be a time or None, got nan"),
    ],
)
def test_impossible_errors_of_a_reference_are_refused(change, complaint):
    with pytest.raises(ValueError, match=complaint):
        replace(SIMULATION, **change)


def test_a_reference_says_its_errors():
    said = str(replace(STATED, misalignment=0.002))
    assert "Its stated errors: jitter of 50 mm, jitter of 10 mrad, misalignment of 2 mrad." in said
