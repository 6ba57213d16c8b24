"""Many recordings through one filter at once: the runs of `run_filter` (3 s)."""

from dataclasses import replace

import numpy as np
import pytest

from filters import StereoNoise
from stereo_slam_env.benchmark.running.runner import run_filter
from stereo_slam_env.benchmark.running.trials import run_filter_together

from ..small_recordings import small_recording

SEEDS = (3, 4, 5)
RECORDINGS = [small_recording(seed) for seed in SEEDS]
MAPS = ("landmark_nees", "landmark_rmse")


def assert_same_run(ours, theirs, but=()):
    for name, wanted in vars(theirs).items():
        got = getattr(ours, name)
        if isinstance(wanted, np.ndarray) and not name.endswith("milliseconds") and name not in but:
            np.testing.assert_allclose(got, wanted, rtol=1e-8, atol=1e-9, err_msg=name)
    for name, wanted in theirs.counts.items():
        np.testing.assert_array_equal(ours.counts[name], wanted, err_msg=name)
    if "landmark_nees" not in but:
        for name, wanted in vars(theirs.landmark_statistics).items():
            np.testing.assert_allclose(getattr(ours.landmark_statistics, name), wanted, rtol=1e-7, err_msg=name)
    assert (ours.filter_name, ours.recording_name, ours.options, ours.seed, ours.failure) == (
        theirs.filter_name,
        theirs.recording_name,
        theirs.options,
        theirs.seed,
        theirs.failure,
    )


@pytest.mark.parametrize("use_odometry", [True, False])
@pytest.mark.parametrize("filter_name", ["inverse-depth", "dual-bearing", "euclidean", "shared-anchor"])
def test_the_runs_are_those_of_one_recording_after_the_other(filter_name, use_odometry):
    settings = {"label": "mine", "common_options": {"gate": 0.999}, "use_odometry": use_odometry}
    options = {"min_disparity": 5.0, "motion": {"sigma_acceleration": 2.0, "sigma_angular_acceleration": 0.5}}
    runs = run_filter_together(RECORDINGS, filter_name, options, seeds=SEEDS, together=2, **settings)
    for run, recording, seed in zip(runs, RECORDINGS, SEEDS, strict=True):
        alone = run_filter(recording, filter_name, options, seed=seed, **settings)
        assert_same_run(run, alone)
        for ours, theirs in zip(run.traces, alone.traces, strict=True):
            for name, wanted in vars(theirs).items():
                if isinstance(wanted, np.ndarray):
                    np.testing.assert_allclose(getattr(ours, name), wanted, rtol=1e-7, err_msg=name)


def test_without_scores_of_the_maps_the_rest_is_the_same():
    runs = run_filter_together(RECORDINGS, "inverse-depth", score_maps=False)
    for run, recording in zip(runs, RECORDINGS, strict=True):
        assert_same_run(run, run_filter(recording, "inverse-depth"), but=MAPS)
        assert np.isnan(run.landmark_nees).all()


def test_recordings_without_truth():
    recordings = [small_recording(seed, truth=False) for seed in SEEDS]
    for run in run_filter_together(recordings, "inverse-depth"):
        assert np.isnan(run.pose_nees).all()
        assert np.isfinite(run.positions).all()


def test_a_trial_that_ends_in_nan_is_a_failed_run_and_the_others_go_on():
    too_far = replace(RECORDINGS[1].start, position=np.full(3, 1.7e308), linear_velocity=np.full(3, 1.7e308))
    lost = replace(RECORDINGS[1], start=too_far)
    with np.errstate(all="ignore"):
        runs = run_filter_together([RECORDINGS[0], lost, RECORDINGS[2]], "inverse-depth")
        assert run_filter(lost, "inverse-depth").failure is not None
    assert [run.failure is None for run in runs] == [True, False, True]
    assert_same_run(runs[2], run_filter(RECORDINGS[2], "inverse-depth"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"recordings": []}, "recordings must be at least one"),
        ({"recordings": [RECORDINGS[0], small_recording(1, frames=3)]}, "one timestamps, recording 1 has another"),
        ({"recordings": [RECORDINGS[0], replace(RECORDINGS[1], noise=StereoNoise(np.eye(3)))]}, "must have one noise"),
        ({"seeds": (1,)}, "seeds must be one for each of 3 recordings, got 1"),
        ({"together": 0}, "together must be an integer >= 1"),
        ({"filter_name": "dead-reckoning"}, "no StereoEKF and runs only one by one: use run_filter"),
        ({"options": {"iterations": 3}}, "iterations must be 1 for trials in lock-step"),
    ],
)
def test_what_cannot_run_together_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        run_filter_together(**{"recordings": RECORDINGS, "filter_name": "inverse-depth", **change})
