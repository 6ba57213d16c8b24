"""Drive a filter through a stream that may be faulty, with a monitor beside it, and hold it to its contract."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from filters.conformance import assert_healthy, shown_arrays
from filters.interface import BodyVelocity, StereoFilter, StereoObservation, UpdateReport
from filters.monitor import Alarm, DivergenceMonitor
from filters.start import Start
from filters.validation import FloatArray
from stereo_slam_env.loop import FilterLoop
from stereo_slam_env.recording.recording import Recording


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

    Parameters
    ----------
    recording : Recording
        With truth. Its frames may be out of order, and their observations illegal.
    stereo_filter : StereoFilter
        Is reset to the start of the recording.
    monitor : DivergenceMonitor
        Is reset.
    """
    watched = _WatchedFilter(stereo_filter)
    loop = FilterLoop(cast(StereoFilter, watched), recording.reference)
    monitor.reset()
    rows: list[tuple[float, float, float, float]] = []
    alarms: list[Alarm] = []
    clock, travelled, where, broken = recording.frames[0].timestamp, 0.0, recording.start.position, ""
    try:
        loop.reset(recording.start)
        for frame in recording.frames:
            try:
                moment = loop.step(frame)
            except _Refused:
                continue
            alarm = monitor.look(moment.time - clock, moment.report, moment.pose)
            alarms += [] if alarm is None else [alarm]
            assert moment.truth is not None, "the recording has no truth"
            travelled += float(np.linalg.norm(moment.truth.position - where))
            clock, where = moment.time, moment.truth.position
            rows.append((clock, travelled, moment.position_error, moment.nees / 6.0))
    except (AssertionError, ArithmeticError) as error:
        broken = f"at {clock:.3f} s: {error}"
    times, path, errors, claims = np.array(rows).reshape(-1, 4).T
    return Session(times, errors, path, claims, tuple(alarms), watched.refused, broken)


class _Refused(Exception):
    """A frame whose time is illegal."""


class _WatchedFilter:
    """A filter that is held to its contract after every call, as the loop drives it.

    After every call its belief is healthy; only `ValueError` may be raised, and then the state is as it was.
    """

    def __init__(self, stereo_filter: StereoFilter) -> None:
        self._filter = stereo_filter
        self.refused = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._filter, name)

    def reset(self, start: Start) -> None:
        self._filter.reset(start)
        self._check()

    def predict(self, dt: float, odometry: BodyVelocity | None) -> None:
        if not self._accepted(lambda: self._filter.predict(dt, odometry)):
            raise _Refused

    def update(self, seen: StereoObservation) -> UpdateReport:
        """Use the arrays of a camera, which need not be legal; an empty report where they are refused."""
        reports = [UpdateReport()]
        self._accepted(
            lambda: reports.append(
                self._filter.update(StereoObservation(seen.ids, seen.uvd, seen.v_right, seen.R)),
            )
        )
        return reports[-1]

    def _check(self) -> None:
        assert_healthy(self._filter)
        self._shown = shown_arrays(self._filter)

    def _accepted(self, call: Callable[[], object]) -> bool:
        """Whether the call is accepted; raises AssertionError where the filter breaks its contract."""
        try:
            call()
        except ValueError:
            self.refused += 1
            pairs = zip(self._shown, shown_arrays(self._filter), strict=True)
            assert all(np.array_equal(a, b, equal_nan=True) for a, b in pairs), "refused input changed the state"
            return False
        except Exception as error:  # the contract is ValueError and nothing else
            raise AssertionError(f"raised {type(error).__name__}: {error}") from error
        self._check()
        return True
