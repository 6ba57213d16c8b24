"""Whether a monitor would have warned, told from a finished run (1 s)."""

import dataclasses

import numpy as np
import pytest

from filters import Cause, DivergenceMonitor, make_filter
from stereo_slam_env.evaluation.figures import trial_figures
from stereo_slam_env.evaluation.filter_run import run_filter
from stereo_slam_env.evaluation.trial import Trial

from ...synthetic_runs import summary_of
from ..benchmark.small_recordings import small_recording


@pytest.fixture(scope="module")
def run():
    return run_filter(small_recording(frames=40), "inverse-depth", seed=0)


def first_alarm(run):
    return Trial(run, divergence_percent=10.0).alarm


def inflated(run, since, factor):
    nis = run.nis.copy()
    nis[since:] *= factor
    return dataclasses.replace(run, nis=nis)


def test_a_consistent_run_has_no_alarm(run):
    assert first_alarm(run) is None
    figures = trial_figures(Trial(run, divergence_percent=10.0))
    assert figures["alarm_s"] is None
    assert figures["alarm"] is None


def test_innovations_larger_than_claimed_raise_one(run):
    wrong = inflated(run, since=20, factor=4.0)
    alarm = first_alarm(wrong)
    assert alarm.cause is Cause.INNOVATIONS
    since = run.timestamps[20] - run.timestamps[0]
    assert since <= alarm.time <= since + 1.0
    figures = trial_figures(Trial(wrong, divergence_percent=10.0))
    assert figures["alarm_s"] == alarm.time
    assert figures["alarm"] == alarm.words
    assert figures["diverged"] == 0


def test_runs_with_an_alarm_are_counted(run):
    assert summary_of([run, inflated(run, since=5, factor=4.0), run]).alarmed == 1


def test_what_came_after_a_failure_is_not_looked_at(run):
    positions, nis = run.positions.copy(), run.nis.copy()
    positions[10:], nis[10:] = np.nan, np.nan
    failed = dataclasses.replace(run, positions=positions, nis=nis, failure="frame 10: ValueError: lost")
    assert first_alarm(failed) is None
    assert first_alarm(inflated(failed, since=3, factor=9.0)) is not None


def test_it_is_what_a_monitor_beside_the_filter_says(run):
    """With too small a noise, as somebody has it who listens while driving."""
    recording = small_recording(frames=40)
    noise = type(recording.noise)(recording.noise.R / 9.0)
    slam, monitor = make_filter("inverse-depth", camera=recording.camera, noise=noise, gate=0.99), DivergenceMonitor()
    slam.reset(recording.start)
    before = recording.frames[0].timestamp
    for k, frame in enumerate(recording.frames):
        dt, before = frame.timestamp - before, frame.timestamp
        if k:
            slam.predict(dt, frame.odometry)
        monitor.look(dt, slam.update(frame.observation), slam.pose)
    told = first_alarm(run_filter(recording, "inverse-depth", {"gate": 0.99}, noise=noise))
    assert told == monitor.alarm
    assert told is not None
