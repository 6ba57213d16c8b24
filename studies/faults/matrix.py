"""The fault matrix: what became of each filter under each fault, and whether that was detected."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from filters import (
    Alarm,
    BodyVelocity,
    Cause,
    DivergenceMonitor,
    Start,
    StereoFilter,
    StereoObservation,
    UpdateReport,
    assert_healthy,
    make_filter,
    shown_arrays,
)
from stereo_slam_env import FilterChoice, FilterLoop, Recording
from stereo_slam_env.benchmark import Backend
from studies.faults.catalogue import FAULTS, NOMINAL, find_fault

FloatArray = NDArray[np.float64]
OUTCOMES = ("ok", "degraded", "diverged")
IN_TIME = 2.0
"""An alarm is in time up to so long after divergence, s; or with the next frame, where that is later."""


@dataclass(frozen=True, eq=False)
class Session:
    """Result of a drive."""

    times: FloatArray  # (K,): of the frames that were not refused for their time, s
    position_errors: FloatArray  # (K,): m
    travelled: FloatArray  # (K,): length of the true drive so far, m
    nees: FloatArray  # (K,): NEES of the pose over 6
    alarms: tuple[Alarm, ...]  # in order; their times are those of the drive
    refused: int  # calls that were refused as illegal input, with the state left as it was
    # What the contract does not allow and happened all the same, one line; empty: nothing. The drive ends there.
    broken: str


def drive_through(recording: Recording, slam: StereoFilter, monitor: DivergenceMonitor) -> Session:
    """Feed a stream with truth to a filter as a robot would: what is refused is left out, and the drive goes on.

    Its frames may be out of order, and their observations illegal. Filter and monitor are reset.
    """
    watched = _WatchedFilter(slam)
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
            except _RefusedFrame:
                continue
            alarm = monitor.look(moment.time - clock, moment.report, moment.pose)
            alarms += [] if alarm is None else [alarm]
            if moment.truth is None:
                raise ValueError(f"recording {recording.name!r} has no truth at {moment.time:.3f} s")
            travelled += float(np.linalg.norm(moment.truth.position - where))
            clock, where = moment.time, moment.truth.position
            rows.append((clock, travelled, moment.position_error, moment.nees / 6.0))
    except (AssertionError, ArithmeticError) as error:
        broken = f"at {clock:.3f} s: {' '.join(str(error).split())}"
    times, path, errors, nees = np.array(rows).reshape(-1, 4).T
    return Session(times, errors, path, nees, tuple(alarms), watched.refused, broken)


class _RefusedFrame(Exception):
    """A frame whose time is illegal."""


class _WatchedFilter:
    """A filter that is held to its contract, as the loop drives it.

    After every call its belief is healthy; only `ValueError` may be raised, and then the state is as it was.
    """

    def __init__(self, slam: StereoFilter) -> None:
        self._slam = slam
        self.refused = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._slam, name)

    def reset(self, start: Start) -> None:
        self._slam.reset(start)
        self._check()

    def predict(self, dt: float, odometry: BodyVelocity | None) -> None:
        if not self._accepted(lambda: self._slam.predict(dt, odometry)):
            raise _RefusedFrame

    def update(self, seen: StereoObservation) -> UpdateReport:
        """Use the arrays of a camera, which need not be legal; an empty report where they are refused."""
        reports = [UpdateReport()]
        measured = (seen.ids, seen.uvd, seen.v_right, seen.R)
        self._accepted(lambda: reports.append(self._slam.update(StereoObservation(*measured))))
        return reports[-1]

    def _check(self) -> None:
        assert_healthy(self._slam)
        self._shown = shown_arrays(self._slam)

    def _accepted(self, call: Callable[[], object]) -> bool:
        """Whether the call is accepted; raises AssertionError where the filter breaks its contract."""
        try:
            call()
        except ValueError:
            self.refused += 1
            pairs = zip(self._shown, shown_arrays(self._slam), strict=True)
            if not all(np.array_equal(a, b, equal_nan=True) for a, b in pairs):
                raise AssertionError("refused input changed the state") from None
            return False
        except Exception as error:  # the contract is ValueError and nothing else
            raise AssertionError(
                f"raised {type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"
            ) from error
        self._check()
        return True


@dataclass(frozen=True)
class Limits:
    """An error above a `share` of the distance travelled and some `metres` is beyond them, or NEES/6 above `nees`."""

    share: float
    metres: float
    nees: float

    def passed(self, session: Session) -> NDArray[np.bool_]:
        """In which frames; what is not finite is beyond every limit."""
        allowed = np.maximum(self.share * session.travelled, self.metres)
        return ~((session.position_errors <= allowed) & (session.nees <= self.nees))


DEGRADED = Limits(0.03, 0.3, 10.0)
DIVERGED = Limits(0.10, 1.0, 100.0)


@dataclass(frozen=True)
class Run:
    """One fault, filter and seed."""

    fault: str
    filter: str
    seed: int
    outcome: str  # one of `OUTCOMES`
    diverged_at: float | None  # first frame that has diverged since the fault began, s
    # From then to the first alarm since the fault began, s; negative: the alarm came first. None: no alarm, or
    # nothing to detect.
    detected_after: float | None
    in_time: bool | None  # whether that was in time (`IN_TIME`); None: nothing to detect
    causes: tuple[str, ...]  # of all alarms, in order (names of `Cause`)
    worst_percent: float  # largest position error over the distance travelled, %
    refused: int  # as of the `Session`
    broken: str


def judge(session: Session, fault: str, label: str, seed: int) -> Run:
    """Outcome of a drive."""
    begins = FAULTS[fault].begins
    since = session.times >= begins
    diverged = DIVERGED.passed(session) & since
    outcome = OUTCOMES[2 if diverged.any() or session.broken else int((DEGRADED.passed(session) & since).any())]
    at = detected = in_time = None
    if diverged.any():
        place = int(diverged.argmax())
        at = float(session.times[place])
        alarm = next((alarm.time for alarm in session.alarms if alarm.time >= begins - 1e-9), None)
        detected = None if alarm is None else alarm - at
        later = session.times[place + 1] - at if place + 1 < len(session.times) else 0.0
        in_time = detected is not None and bool(detected <= max(IN_TIME, later) + 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = session.position_errors[since] / np.maximum(session.travelled[since], 1.0)
    causes = tuple(alarm.cause.name for alarm in session.alarms)
    worst = 100.0 * float(shares.max(initial=0.0))
    return Run(fault, label, seed, outcome, at, detected, in_time, causes, worst, session.refused, session.broken)


def in_words(runs: Sequence[Run]) -> str:
    """Outcomes, detections, and what was broken, in a few words."""
    counts = {outcome: sum(run.outcome == outcome for run in runs) for outcome in OUTCOMES}
    present = [outcome for outcome in OUTCOMES if counts[outcome]]
    said = [f"{counts[outcome]} {outcome}" for outcome in present] if len(present) > 1 else present
    delays = [run.detected_after for run in runs if run.detected_after is not None]
    alarmed = sum(bool(run.causes) for run in runs)
    if diverged := counts["diverged"]:
        late = f", after {delay:.1f} s" if delays and (delay := statistics.median(delays)) >= 0.05 else ""
        said.append(f"told {sum(run.in_time is True for run in runs)}/{diverged}{late}")
    elif alarmed:
        said.append(f"alarms {alarmed}/{len(runs)}")
    broken = [f"BROKEN: {run.broken}" for run in runs if run.broken]
    return "; ".join([*said, *broken[:1]])


def first_cause(runs: Sequence[Run]) -> str:
    """The most frequent first cause of an alarm."""
    first = Counter(run.causes[0] for run in runs if run.causes)
    return Cause[first.most_common(1)[0][0]].value if first else ""


@dataclass(frozen=True)
class FaultMatrix:
    """All runs."""

    runs: tuple[Run, ...]

    @property
    def faults(self) -> tuple[str, ...]:
        """In the order of the catalogue."""
        present = {run.fault for run in self.runs}
        return tuple(name for name in FAULTS if name in present)

    @property
    def filters(self) -> tuple[str, ...]:
        """In the order asked for."""
        return tuple(dict.fromkeys(run.filter for run in self.runs))

    def runs_of(self, fault: str, label: str | None = None) -> list[Run]:
        """The runs of a fault with one filter; None: with all."""
        return [run for run in self.runs if run.fault == fault and label in (None, run.filter)]

    @property
    def broken(self) -> tuple[Run, ...]:
        """Runs in which an invariant was not kept."""
        return tuple(run for run in self.runs if run.broken)

    def summary(self) -> dict[str, int]:
        """The counts that are required of a monitor; hidden faults (see `Fault.hidden`) are counted apart."""
        diverged = [run for run in self.runs if run.outcome == "diverged" and run.fault != NOMINAL]
        shown = [run for run in diverged if not FAULTS[run.fault].hidden]
        nominal = [run for run in self.runs if run.fault == NOMINAL]
        return {
            "runs": len(self.runs),
            "broken": len(self.broken),
            "diverged": len(shown),
            "detected_in_time": sum(run.in_time is True for run in shown),
            "diverged_hidden": len(diverged) - len(shown),
            "nominal": len(nominal),
            "false_alarms": sum(bool(run.causes) for run in nominal),
        }

    def sentences(self) -> list[str]:
        """The summary in words."""
        count = self.summary()
        hidden = count["diverged_hidden"]
        apart = f" ({hidden} more where innovations cannot show it)" if hidden else ""
        return [
            f"contract kept in {count['runs'] - count['broken']} of {count['runs']} runs",
            f"divergence told in time in {count['detected_in_time']} of {count['diverged']} runs{apart}",
            f"false alarms in {count['false_alarms']} of {count['nominal']} drives with nothing wrong",
        ]

    def as_dict(self) -> dict[str, Any]:
        """JSON-able: limits, summary, every run."""
        return {
            "limits": {"degraded": asdict(DEGRADED), "diverged": asdict(DIVERGED), "in_time_s": IN_TIME},
            "summary": self.summary(),
            "faults": {name: FAULTS[name].line for name in self.faults},
            "runs": [asdict(run) for run in self.runs],
        }

    def rows(self) -> list[list[str]]:
        """The table: fault, a column for each filter, most frequent cause."""
        return [
            [fault, *(in_words(self.runs_of(fault, label)) for label in self.filters), first_cause(self.runs_of(fault))]
            for fault in self.faults
        ]

    def as_markdown(self) -> str:
        """Summary and table."""
        heading = ["fault", *self.filters, "first alarm"]
        table = [heading, ["---"] * len(heading), *self.rows()]
        lines = ["| " + " | ".join(row) + " |" for row in table]
        return "\n".join([*(f"- {line}" for line in self.sentences()), "", *lines, ""])


def run_matrix(
    filters: Sequence[FilterChoice],
    faults: Sequence[str] = tuple(FAULTS),
    seeds: int = 3,
    backend: Backend | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> FaultMatrix:
    """Run every fault of those names with every filter, on the drives of the seeds from 0 on.

    The filters have the gate that they have by default, 0.99. `backend` says where (None: one after the other, in this
    process), `progress` is called with (drives done, drives). A `ValueError` where there is no such fault or filter, or
    an option is refused.
    """
    if seeds < 1:
        raise ValueError(f"seeds must be at least 1, got {seeds}")
    wanted = {name: find_fault(name) for name in faults}
    for choice in filters:  # before any work is done
        _made(choice, FAULTS[NOMINAL].driven(0, 2))
    tasks = [(name, seed) for name in wanted for seed in range(seeds)]
    runs: list[Run] = []
    with (backend or Backend(jobs=1)).started() as map_tasks:
        for done, some in enumerate(map_tasks(partial(_run, tuple(filters)), tasks), 1):
            runs += some
            if progress is not None:
                progress(done, len(tasks))
    order = {name: place for place, name in enumerate(wanted)}
    labels = {choice.label: place for place, choice in enumerate(filters)}
    return FaultMatrix(tuple(sorted(runs, key=lambda run: (order[run.fault], labels[run.filter], run.seed))))


def _run(filters: Sequence[FilterChoice], task: tuple[str, int]) -> list[Run]:
    fault, seed = task
    recording = FAULTS[fault].drive(seed)
    with np.errstate(all="ignore"):
        sessions = [drive_through(recording, _made(choice, recording), DivergenceMonitor()) for choice in filters]
    return [judge(session, fault, choice.label, seed) for session, choice in zip(sessions, filters, strict=True)]


def _made(choice: FilterChoice, recording: Recording) -> StereoFilter:
    return make_filter(choice.name, camera=recording.camera, noise=recording.noise, **choice.options)
