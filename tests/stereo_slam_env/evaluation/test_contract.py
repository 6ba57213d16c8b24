"""A covariance that is none is a failure of the run, in its frame, wherever filters are run (40 s)."""

import dataclasses

import numpy as np
import pytest

import stereo_slam_env as sse
from filters import BodyVelocity, StereoObservation
from filters.checks.consistency import are_definite, fault_of, nees
from stereo_slam_env.benchmark import ReferenceSource, Scenario
from stereo_slam_env.benchmark.head_to_head import Bench
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.run_figures import figures_of, summarise_all

from ...filters.false_claims import FROM, LIES, liar
from ..benchmark.small_recordings import small_recording

FRAME = FROM - 1
"""The tenth update is that of frame 9."""


@pytest.fixture(scope="module")
def recording():
    return small_recording(frames=30)


def summary_of(*runs):
    figures = figures_of(runs, divergence_percent=10.0)
    return summarise_all(runs, figures)[0]


# ---- what is a covariance --------------------------------------------------------------------------------------------


def random_covariances(count=200, size=6):
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(count, size, size))
    units = 10.0 ** rng.uniform(-8, 8, (count, size))
    return units[:, :, None] * (roots @ roots.swapaxes(1, 2) + 0.01 * np.eye(size)) * units[:, None, :]


def test_it_does_not_depend_on_units():
    """Condition numbers up to 1e36 by units alone; of the correlations up to 1e5."""
    P = random_covariances()
    assert are_definite(P).all()
    assert not are_definite(-P).any()
    errors = np.random.default_rng(2).normal(size=(len(P), 6)) * np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    scale = 1.0 / np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    scaled = scale[:, :, None] * P * scale[:, None, :]
    np.testing.assert_allclose(nees(errors, P), nees(errors * scale, scaled), rtol=1e-6)


def test_of_small_matrices_the_determinant_says_what_the_eigenvalues_say():
    """From far apart to touching zero, and beyond it."""
    P = random_covariances(2000, 3)
    P[:, 0, 1] = P[:, 1, 0] = P[:, 0, 1] * np.linspace(0.9, 1.3, len(P))
    P[::7] = np.ones((3, 3)) + 10.0 ** -np.arange(len(P[::7]), dtype=float)[:, None, None] * np.eye(3)
    expected = [fault_of(one) is None for one in P]
    assert 0.2 < np.mean(expected) < 0.9
    np.testing.assert_array_equal(are_definite(P), expected)


@pytest.mark.parametrize(
    ("P", "fault"),
    [
        (np.eye(6), None),
        (np.diag([1e-12, 1e-12, 1e-12, 1.0, 1.0, 1e6]), None),  # a known position
        (np.zeros((6, 6)), "is not positive definite"),
        (-np.eye(6), "is not positive definite"),
        (np.ones((6, 6)), "is not positive definite"),  # of rank one
        (np.full((6, 6), np.nan), "is not finite"),
        (np.eye(6) + 1e-6 * np.tri(6, k=-1), r"is not symmetric"),
    ],
)
def test_what_is_wrong_is_said(P, fault):
    found = fault_of(P)
    assert found is None if fault is None else found.startswith(fault)
    assert are_definite(P[None])[0] == (fault is None)
    assert np.isnan(nees(np.ones((1, 6)), P[None])[0]) == (fault is not None)


def test_semi_definite_will_do_where_something_may_be_known():
    assert fault_of(np.zeros((6, 6)), definite=False) is None
    assert fault_of(np.diag([-1e-18, 1.0]), definite=False) is None  # rounding
    assert fault_of(np.diag([-1e-3, 1.0]), definite=False).startswith("is not positive semi-definite")
    assert fault_of(np.zeros((0, 3, 3))) is None


# ---- one run ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize(
    ("where", "said"),
    [
        ("pose", "its covariance"),
        ("pose_error", "its covariance"),
        ("velocity", "its velocity covariance"),
        ("forecast", "its covariance of landmark "),
    ],
)
def test_such_a_frame_is_a_failure_of_the_run(recording, where, said, lie):
    run = run_filter(recording, liar(where, lie))
    if (where, lie) == ("velocity", "zero"):  # as odometry without errors states it
        assert run.failure is None
        return
    wrong = {"zero": "is not positive definite", "NaN": "is not finite", "asymmetric": "is not symmetric"}
    if lie == "negative":
        wrong[lie] = "is not positive semi-definite" if where == "velocity" else "is not positive definite"
    assert run.failure.startswith(f"frame {FRAME}: {said}")
    assert wrong[lie] in run.failure
    assert np.isnan(run.positions[FRAME:]).all() or where == "forecast"


@pytest.mark.parametrize("lie", ["zero", "negative", "asymmetric"])
def test_so_is_a_window_of_a_motion(lie):
    recording = small_recording(frames=30)
    run = run_filter(recording, liar("relative_pose", lie), windows=True)
    assert run.failure.startswith("frame 10: its covariance of the relative pose is not ")
    assert run_filter(recording, liar("nowhere", lie), windows=True).failure is None


def test_frames_that_are_not_scored_are_a_figure(recording):
    false, true = (summary_of(run_filter(recording, liar(where, "zero"))) for where in ("pose", "nowhere"))
    assert (false.frames_not_scored, true.frames_not_scored) == (30 - FRAME, 0)
    assert false.pose_anees is None
    assert false.diverged == 1
    assert false.failures[0].startswith(f"frame {FRAME}: its covariance")


def test_without_a_truth_no_frame_is_to_be_scored():
    run = run_filter(small_recording(truth=False), "inverse-depth")
    assert summary_of(run).frames_not_scored == 0


def test_a_landmark_without_a_place_is_counted_not_scored(recording):
    class NoPlace(liar("nowhere", "zero")):
        def forecast(self, ids=None):
            forecast = super().forecast(ids)
            uvd = forecast.uvd.copy()
            uvd[:2] = np.nan
            return dataclasses.replace(forecast, uvd=uvd)

    run = run_filter(recording, NoPlace)
    assert run.failure is None
    assert summary_of(run).landmarks_not_scored == 2 * len(recording)


# ---- what is legal ---------------------------------------------------------------------------------------------------


NAMES = ("inverse-depth", "right-invariant", "unscented", "submaps", "coloured-noise", "dead-reckoning")


@pytest.mark.parametrize("name", NAMES)
def test_a_start_that_is_exact_is_legal(recording, name):
    """The first frame then has a covariance of zero, and is not scored."""
    start = dataclasses.replace(recording.start, covariance=np.zeros((12, 12)))
    run = run_filter(dataclasses.replace(recording, start=start), name)
    assert run.failure is None
    assert (run.pose_covariances[0] == 0.0).all()
    assert np.isnan(run.pose_nees[0])
    assert np.isfinite(run.pose_nees[1:]).all()
    assert summary_of(run).frames_not_scored == 0


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("exact", [False, True])
def test_standing_still_is_legal(recording, name, exact):
    """Also with odometry that states no errors at all, so that the velocity is known exactly."""
    first = recording.frames[0]
    rng = np.random.default_rng(0)
    odometry = BodyVelocity(np.zeros(3), np.zeros(3), np.zeros((6, 6))) if exact else None
    frames = tuple(
        dataclasses.replace(
            frame,
            observation=StereoObservation(
                first.observation.ids, first.observation.uvd + rng.normal(size=first.observation.uvd.shape)
            ),
            truth=first.truth,
            truth_velocity=None,
            odometry=odometry,
        )
        for frame in recording.frames
    )
    start = dataclasses.replace(recording.start, covariance=None, linear_velocity=np.zeros(3))
    run = run_filter(dataclasses.replace(recording, frames=frames, start=start), name)
    assert run.failure is None
    assert summary_of(run).frames_not_scored == 0


# ---- every way to run one --------------------------------------------------------------------------------------------


SAID = f"frame {FRAME}: its covariance is not positive definite"


def test_evaluate_and_compare_say_so(recording):
    evaluation = sse.evaluate(liar("pose", "zero"), recording)
    assert evaluation.figures.failures[0].startswith(SAID)
    assert "frames not scored" in str(evaluation)
    comparison = sse.compare([liar("pose_error", "negative"), "inverse-depth"], recording)
    liars, other = comparison.summaries
    assert liars.failures[0].startswith(SAID)
    assert (liars.pose_anees, liars.diverged, other.diverged) == (None, 1, 0)


def test_a_unit_test_of_a_filter_says_so():
    on = Scenario("s", ReferenceSource("short_turn"), frames=15)
    with pytest.raises(AssertionError, match=SAID):
        Bench(2)(liar("pose_error", "zero"), scenario=on).assert_consistent()
