"""A drive through a faulty stream, with a filter that keeps its contract and with some that do not (5 s)."""

import dataclasses

import numpy as np
import pytest

from filters import Cause, DivergenceMonitor, InverseDepthStereoEKF, PoseBelief
from stereo_slam_env.benchmark import long_drive
from stereo_slam_env.sensing import Blackouts
from studies.faults import catalogue, drive_through


@pytest.fixture(scope="module")
def drive():
    return long_drive(0, frames=30, landmarks=12)


def driven(recording, kind=InverseDepthStereoEKF):
    return drive_through(recording, kind(recording.camera, recording.noise), DivergenceMonitor())


def with_fault(drive, corruption, first=10):
    part = dataclasses.replace(drive, frames=drive.frames[first:])
    wrong = corruption.applied_to(part, np.random.default_rng(0))
    return dataclasses.replace(drive, frames=(*drive.frames[:first], *wrong.frames))


def test_a_drive_with_nothing_wrong(drive):
    session = driven(drive)
    assert (session.broken, session.refused, session.alarms) == ("", 0, ())
    assert len(session.times) == len(drive)
    assert session.position_errors.max() < 0.3
    assert session.travelled[-1] == pytest.approx(14.0, abs=2.0)
    assert session.nees.max() < 6.0


def test_late_frames_are_refused_and_left_out(drive):
    stream = with_fault(drive, catalogue.Reordered(0.3))
    session = driven(stream)
    late = (np.diff([frame.timestamp for frame in stream.frames]) < 0).sum()
    assert session.refused == late > 2
    assert (np.diff(session.times) > 0).all()
    assert session.broken == ""


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_illegal_numbers_are_refused_and_the_drive_goes_on(drive, value):
    session = driven(with_fault(drive, catalogue.BadNumbers(value, frames=0.5)))
    assert session.refused > 3
    assert session.broken == ""
    assert len(session.times) == len(drive)
    assert session.position_errors.max() < 0.3


def test_numbers_beyond_all_cameras_are_legal_and_harm_nobody(drive):
    session = driven(with_fault(drive, catalogue.BadNumbers(1e300, frames=0.5)))
    assert (session.broken, session.refused) == ("", 0)
    assert session.position_errors.max() < 0.3


def test_the_dark_raises_an_alarm_at_the_time_of_the_drive(drive):
    (alarm,) = driven(with_fault(drive, Blackouts(1.0, 0.05))).alarms
    assert alarm.cause is Cause.BLIND
    assert alarm.time == pytest.approx(2.0, abs=0.11)


class Crashes(InverseDepthStereoEKF):
    def predict(self, dt, odometry=None):
        raise ZeroDivisionError("over the edge")


class RaisesAtLength(InverseDepthStereoEKF):
    def predict(self, dt, odometry=None):
        raise RuntimeError("\nill-posed\n\nThrown when a system is so.")


class Indefinite(InverseDepthStereoEKF):
    @property
    def pose(self):
        pose = super().pose
        return PoseBelief(pose.position, pose.orientation, -np.asarray(pose.covariance))


class ForgetsWhenRefusing(InverseDepthStereoEKF):
    def predict(self, dt, odometry=None):
        if dt <= 0:
            self.reset()
        super().predict(dt, odometry)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (Crashes, "raised ZeroDivisionError: over the edge"),
        (RaisesAtLength, "raised RuntimeError: ill-posed"),
        (Indefinite, "is not positive definite"),
        (ForgetsWhenRefusing, "refused input changed the state"),
    ],
)
def test_a_filter_that_breaks_its_contract_is_found_out(drive, kind, words):
    broken = driven(with_fault(drive, catalogue.Reordered(0.5)), kind).broken
    assert words in broken
    assert "\n" not in broken
