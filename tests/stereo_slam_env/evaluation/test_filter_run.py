"""One filter on one recording (2 s)."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from filters import ConstantVelocity, StereoEKF, StereoNoise, make_filter
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.results import COUNTS, peak_memory_mb
from stereo_slam_env.evaluation.windows import WINDOW_SERIES
from stereo_slam_env.recording.recording import Reference

from ...synthetic_runs import summary_of
from ..benchmark.small_recordings import CAMERA, DT, SPEED, small_recording

STATUS = Path("/proc/self/status")


@pytest.mark.usefixtures("third_party")
def test_the_first_frame_only_initialises_and_the_others_predict_first():
    """Exact odometry from an exact start: dead reckoning is right in every frame, so no step is missing or doubled."""
    recording = small_recording()
    run = run_filter(recording, "odometry-only")
    np.testing.assert_allclose(run.positions, run.true_positions, atol=1e-9)
    np.testing.assert_array_equal(run.positions[0], 0.0)
    np.testing.assert_allclose(run.timestamps, DT * np.arange(len(recording)))
    assert np.isnan(run.state_size).all()  # it does not tell


@pytest.mark.usefixtures("third_party")
def test_odometry_can_be_withheld():
    run = run_filter(small_recording(), "odometry-only", use_odometry=False)
    np.testing.assert_allclose(run.positions[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(run.positions[:, 2], SPEED * run.timestamps)


def test_the_run_is_what_driving_the_filter_by_hand_gives():
    recording = small_recording()
    run = run_filter(recording, "inverse-depth", {"gate": None}, use_odometry=False)
    by_hand = make_filter("inverse-depth", camera=CAMERA, noise=recording.noise, gate=None)
    start = recording.start
    by_hand.reset(start)
    with threadpool_limits(limits=1):  # as in the run: several threads add up in another order
        for k, frame in enumerate(recording.frames):
            if k:
                by_hand.predict(frame.timestamp - recording.frames[k - 1].timestamp)
            report = by_hand.update(frame.observation)
    assert run.failure is None
    np.testing.assert_array_equal(run.positions[-1], by_hand.pose.position)
    np.testing.assert_array_equal(run.pose_covariances[-1], by_hand.pose.covariance)
    assert run.nis[-1] == report.nis
    assert run.counts["map_size"][-1] == len(by_hand.landmarks.ids)
    assert run.state_size[-1] == by_hand.state_size
    error, covariance = by_hand.pose_error(frame.truth.position, frame.truth.orientation)
    assert run.pose_nees[-1] == pytest.approx(error @ np.linalg.solve(covariance, error))
    for nees, part in ((run.position_nees, slice(0, 3)), (run.rotation_nees, slice(3, 6))):
        assert nees[-1] == pytest.approx(error[part] @ np.linalg.solve(covariance[part, part], error[part]))


def test_only_an_independent_truth_gives_a_nees():
    """An odometry from the same images is no truth: the distance to it is told, but no covariance is for that."""
    recording = small_recording()
    true = run_filter(recording, "inverse-depth")
    from_images = replace(recording, truth_from=Reference("odometry", "By hand."))
    run = run_filter(from_images, "inverse-depth", windows=True)
    assert np.isnan(run.window_nees_1s).all()
    np.testing.assert_array_equal(run.pose_errors, true.pose_errors)
    for name in ("pose_nees", "position_nees", "rotation_nees", "landmark_nees"):
        assert np.isfinite(getattr(true, name)[1:]).all()
        assert np.isnan(getattr(run, name)).all()
    assert run.landmark_statistics.nees_count.sum() == 0
    assert run.reference == from_images.reference


def test_every_array_has_a_row_a_frame_and_finite_values():
    recording = small_recording()
    run = run_filter(recording, "inverse-depth")
    for name, value in vars(run).items():
        if isinstance(value, np.ndarray):
            assert len(value) == len(recording), name
            if name not in ("pose_nees_floor", *WINDOW_SERIES):  # not asked for
                assert np.isfinite(value).all(), name
    assert set(run.counts) == set(COUNTS)
    np.testing.assert_allclose(run.milliseconds, run.predict_milliseconds + run.update_milliseconds)
    assert run.memory_mb >= 0.0
    assert (run.milliseconds > 0).all()
    assert run.counts["initialised"][0] == len(recording.frames[0].observation)
    assert [trace.label for trace in run.traces] == ["near", "far"]


def test_without_truth_only_the_errors_are_unknown():
    run = run_filter(small_recording(truth=False), "inverse-depth")
    assert run.failure is None
    for name in ("pose_nees", "pose_errors", "landmark_nees", "landmark_rmse", "true_positions"):
        assert np.isnan(getattr(run, name)).all(), name
    assert np.isfinite(run.positions).all()
    assert np.isfinite(run.nis).all()


def test_consistency_figures_are_those_of_the_noise():
    """NIS and both NEES average to about their degrees of freedom when the assumed noise is the true one."""
    runs = [
        run_filter(small_recording(seed), "inverse-depth", {"gate": None}, use_odometry=False) for seed in range(12)
    ]
    nis = np.array([run.nis[1:].sum() / run.nis_dof[1:].sum() for run in runs])
    assert nis.mean() == pytest.approx(1.0, abs=0.1)
    assert np.mean([run.landmark_nees[1:] for run in runs]) == pytest.approx(3.0, abs=0.4)
    assert 3.0 < np.mean([run.pose_nees[1:] for run in runs]) < 9.0


def test_assumed_noise_replaces_that_of_the_recording():
    recording = small_recording()
    wary = run_filter(recording, "inverse-depth", noise=StereoNoise.independent_pixels(3.0))
    assert wary.nis[1:].sum() < 0.3 * run_filter(recording, "inverse-depth").nis[1:].sum()


@pytest.mark.usefixtures("third_party")
@pytest.mark.parametrize(
    ("name", "failure"),
    [
        ("raises", "frame 2: RuntimeError: the third frame is too much"),
        ("returns-nan", "frame 2: its position is not finite"),
    ],
)
def test_a_filter_that_fails_is_a_result(name, failure):
    made = run_filter(small_recording(), "no-such-filter")
    assert made.failure.startswith("start: ValueError: filter must be one of")
    assert np.isnan(made.positions).all()
    run = run_filter(small_recording(), name)
    assert run.failure == failure
    assert np.isfinite(run.positions[:2]).all()
    assert np.isnan(run.positions[2:]).all()
    assert np.isfinite(run.true_positions).all()


class _Wordless(Exception):
    def __str__(self):
        raise RuntimeError("no words")


@pytest.mark.parametrize(
    ("error", "failure"),
    [
        (_Wordless(), "frame 0: _Wordless: its message cannot be read"),
        (ValueError("\x1b[2J\x07red"), "frame 0: ValueError: \\x1b[2J\\x07red"),
        (KeyError(), "frame 0: KeyError: no message"),
    ],
)
def test_whatever_an_exception_says_is_a_plain_line(error, failure):
    class Failing(StereoEKF):
        def update(self, observation):
            raise error

    assert run_filter(small_recording(), Failing).failure == failure


@pytest.mark.usefixtures("third_party")
def test_common_options_go_to_the_filters_that_know_them():
    common = {"gate": 0.9, "motion": {"sigma_acceleration": 1.0, "sigma_angular_acceleration": 0.1}}
    recording = small_recording()
    assert run_filter(recording, "inverse-depth", common_options=common).options == common
    assert run_filter(recording, "inverse-depth", {"gate": None}, common_options=common).options["gate"] is None
    refused = run_filter(recording, "inverse-depth", common_options={"gate": 2.0})
    assert refused.failure.startswith("start: ValueError: gate must be")
    foreign = run_filter(recording, "odometry-only", {"spread": 0.2}, common_options=common)
    assert foreign.failure is None
    assert foreign.options == {"spread": 0.2}


class _ItsOwnWay(StereoEKF):
    """Has a motion model of its own, passed on beside the others' options."""

    open_options = StereoEKF.open_options - {"motion"}

    def __init__(self, camera, noise, **options):
        super().__init__(camera, noise, motion=ConstantVelocity(2.0, 0.4), **options)


def test_a_filter_with_a_motion_model_of_its_own_keeps_it_and_the_result_says_so():
    common = {"gate": 0.9, "motion": {"sigma_acceleration": 1.0, "sigma_angular_acceleration": 0.1}}
    recording = small_recording()
    run = run_filter(recording, _ItsOwnWay, common_options=common)
    alone = run_filter(
        recording,
        "inverse-depth",
        {"motion": {"sigma_acceleration": 2.0, "sigma_angular_acceleration": 0.4}, "gate": 0.9},
    )
    assert run.failure is None
    np.testing.assert_allclose(run.positions, alone.positions, atol=1e-9)
    assert run.options == {"gate": 0.9}
    assert list(run.not_given) == ["motion"]
    (remark,) = summary_of([run]).remarks
    assert remark == (
        "_ItsOwnWay does not get the common motion: it has its own, "
        "ConstantVelocity(sigma_acceleration=2.0, sigma_angular_acceleration=0.4)."
    )


def test_progress_counts_frames():
    seen = []
    run_filter(small_recording(frames=4), "euclidean", progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_an_empty_recording_is_refused():
    with pytest.raises(ValueError, match="recording 'small' has no frames"):
        run_filter(replace(small_recording(), frames=()), "inverse-depth")


def test_landmarks_believed_beyond_infinity_are_counted_while_they_are_seen():
    """Far points under heavy noise begin with d <= 0; inverse depth keeps them, XYZ cannot."""
    recording = small_recording(sigma=6.0)
    behind = {name: run_filter(recording, name).counts["negative_depth"] for name in ("inverse-depth", "euclidean")}
    first = recording.frames[0].observation
    assert behind["inverse-depth"][0] == np.count_nonzero(first.uvd[:, 2] <= 0) > 0
    assert behind["euclidean"][0] == 0


def test_times_are_those_of_the_two_calls_in_milliseconds(monkeypatch):
    """By a clock that only the filter moves."""
    clock = SimpleNamespace(now=100.0, perf_counter=lambda: clock.now)

    class Slow(StereoEKF):
        def predict(self, *arguments):
            clock.now += 0.25
            super().predict(*arguments)

        def update(self, observation):
            clock.now += 0.5
            return super().update(observation)

    monkeypatch.setattr("stereo_slam_env.loop.time", clock)
    run = run_filter(small_recording(frames=4), Slow)
    assert run.failure is None
    np.testing.assert_allclose(run.predict_milliseconds, [0.0, 250.0, 250.0, 250.0])
    np.testing.assert_allclose(run.update_milliseconds, 500.0)
    np.testing.assert_allclose(run.milliseconds, [500.0, 750.0, 750.0, 750.0])


@pytest.mark.skipif(not STATUS.exists(), reason="needs /proc/self/status")
def test_the_largest_memory_is_that_which_the_system_tells():
    told = re.search(r"VmHWM:\s+(\d+) kB", STATUS.read_text())
    assert peak_memory_mb() == pytest.approx(int(told[1]) / 1024.0, rel=0.05)


def test_the_memory_of_a_run_is_what_it_added():
    """A short drive after a run of the same filter; the process itself has hundreds of MB."""
    runs = [run_filter(small_recording(frames=4), "inverse-depth") for _ in range(2)]
    assert 0.0 <= runs[1].memory_mb < 0.5 * peak_memory_mb()
