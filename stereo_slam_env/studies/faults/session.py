"""Drive a filter through a stream that may be faulty, with a monitor beside it, and hold it to its contract."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from filters.conformance import assert_healthy, shown_arrays
from filters.interface import BodyVelocity, StereoFilter, StereoObservation, UpdateReport
from filters.monitor import Alarm, DivergenceMonitor
from filters.validation import FloatArray
from stereo_slam_env.evaluation.consistency import nees
from stereo_slam_env.recording.recording import Frame, Recording


@dataclass(frozen=True, eq=False)
class Session:
    """What came of a drive.

    Attributes
    ----------
    times : (K,)
        Of the frames that were not refused for their time, s.
    position_errors, travelled, nees : (K,)
        Error of the position, m; length of the true drive so far, m; NEES of the pose over 6.
    alarms : tuple of Alarm
        In order; their times are those of the drive.
    refused : int
        Calls that were refused as illegal input, with the state left as it was.
    broken : str
        What the contract does not allow and happened all the same, one line; empty: nothing. The drive ends there.
    """

    times: FloatArray
    position_errors: FloatArray
    travelled: FloatArray
    nees: FloatArray
    alarms: tuple[Alarm, ...]
    refused: int
    broken: str


def drive_through(recording: Recording, stereo_filter: StereoFilter, monitor: DivergenceMonitor) -> Session:
    """Feed a stream to a filter as a robot would: what is refused is left out, and the drive goes on.

    After every call the pose is finite and its covariance positive definite; only `ValueError` may be raised, and then
    the state is as it was.

    Parameters
    ----------
    recording : Recording
        With truth. Its frames may be out of order, and their observations illegal.
    stereo_filter : StereoFilter
        Is reset to the start of the recording.
    monitor : DivergenceMonitor
        Is reset.
    """
    held = _Held(stereo_filter)
    start, broken = recording.start, ""
    monitor.reset()
    rows: list[tuple[float, float, float, float]] = []
    alarms: list[Alarm] = []
    clock, travelled, where = recording.frames[0].timestamp, 0.0, start.position
    try:
        stereo_filter.reset(
            start.position, start.orientation, start.linear_velocity, start.angular_velocity, start.covariance
        )
        held.check()
        for number, frame in enumerate(recording.frames):
            dt = frame.timestamp - clock
            if number and not held.predict(dt, frame.odometry):
                continue
            clock = frame.timestamp
            alarm = monitor.look(dt, held.update(frame.observation), stereo_filter.pose)
            alarms += [] if alarm is None else [alarm]
            assert frame.truth is not None, "the recording has no truth"
            travelled += float(np.linalg.norm(frame.truth.position - where))
            where = frame.truth.position
            rows.append((clock, travelled, *_errors(stereo_filter, frame)))
    except (AssertionError, ArithmeticError) as error:
        broken = f"at {clock:.3f} s: {error}"
    times, path, errors, claims = np.array(rows).reshape(-1, 4).T
    return Session(times, errors, path, claims, tuple(alarms), held.refused, broken)


class _Held:
    """A filter that is looked at after every call."""

    def __init__(self, stereo_filter: StereoFilter) -> None:
        self._filter = stereo_filter
        self.refused = 0

    def check(self) -> None:
        assert_healthy(self._filter)
        self._shown = shown_arrays(self._filter)

    def predict(self, dt: float, odometry: BodyVelocity | None) -> bool:
        """Whether that is accepted."""
        return self._accepted(lambda: self._filter.predict(dt, odometry))

    def update(self, seen: StereoObservation) -> UpdateReport:
        """Use the arrays of a camera, which need not be legal; an empty report where they are refused."""
        reports = [UpdateReport()]
        self._accepted(
            lambda: reports.append(
                self._filter.update(StereoObservation(seen.ids, seen.uvd, seen.v_right, seen.R)),
            )
        )
        return reports[-1]

    def _accepted(self, call: Callable[[], object]) -> bool:
        """Raises AssertionError where the filter does what its contract does not allow."""
        try:
            call()
        except ValueError:
            self.refused += 1
            pairs = zip(self._shown, shown_arrays(self._filter), strict=True)
            assert all(np.array_equal(a, b, equal_nan=True) for a, b in pairs), "refused input changed the state"
            return False
        except Exception as error:  # the contract is ValueError and nothing else
            raise AssertionError(f"raised {type(error).__name__}: {error}") from error
        self.check()
        return True


def _errors(stereo_filter: StereoFilter, frame: Frame) -> tuple[float, float]:
    assert frame.truth is not None
    error, covariance = stereo_filter.pose_error(frame.truth.position, frame.truth.orientation)
    distance = float(np.linalg.norm(stereo_filter.pose.position - frame.truth.position))
    return distance, float(nees(error[None], covariance[None])[0]) / 6.0
