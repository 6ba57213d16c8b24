"""The fault matrix: every fault x filter x seed, what became of it, and whether it was noticed."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from filters.common_options import make_with_common_options
from filters.monitor import Cause, DivergenceMonitor
from filters.validation import BoolArray
from stereo_slam_env.benchmark.recordings.source import Progress
from stereo_slam_env.benchmark.running.engines import Engine
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice
from stereo_slam_env.studies.faults.catalogue import FAULTS, NOMINAL, find_fault
from stereo_slam_env.studies.faults.session import Session, drive_through

OUTCOMES = ("ok", "degraded", "diverged")
IN_TIME = 2.0
"""So late an alarm is still in time, s; or with the next frame, where that is later."""
GATE = 0.99


@dataclass(frozen=True)
class Limits:
    """Beyond them: an error above a `share` of the distance travelled and some `metres`, or NEES/6 above `nees`."""

    share: float
    metres: float
    nees: float

    def passed(self, session: Session) -> BoolArray:
        """In which frames; what is not finite is beyond every limit."""
        allowed = np.maximum(self.share * session.travelled, self.metres)
        return ~((session.position_errors <= allowed) & (session.nees <= self.nees))


DEGRADED = Limits(0.03, 0.3, 10.0)
DIVERGED = Limits(0.10, 1.0, 100.0)


@dataclass(frozen=True)
class Run:
    """One fault, filter and seed.

    Attributes
    ----------
    fault, filter, seed : str, str, int
        Which.
    outcome : str
        One of `OUTCOMES`.
    diverged_at : float or None
        First frame that has diverged since the fault began, s.
    detected_after : float or None
        From then to the first alarm since the fault began, s; negative: the alarm came first. None: no alarm, or
        nothing to detect.
    in_time : bool or None
        Whether that was in time (`IN_TIME`); None: nothing to detect.
    causes : tuple of str
        Of all alarms, in order (names of `Cause`).
    worst_percent : float
        Largest position error over the distance travelled, %.
    refused : int
        Calls refused as illegal, with the state left as it was.
    broken : str
        Which invariant was not kept; empty: none.
    """

    fault: str
    filter: str
    seed: int
    outcome: str
    diverged_at: float | None
    detected_after: float | None
    in_time: bool | None
    causes: tuple[str, ...]
    worst_percent: float
    refused: int
    broken: str


@dataclass(frozen=True)
class Cell:
    """The runs of one fault and filter."""

    runs: tuple[Run, ...]

    def count(self, outcome: str) -> int:
        """Runs that ended so."""
        return sum(run.outcome == outcome for run in self.runs)

    @property
    def detected(self) -> int:
        """Diverged runs that were noticed in time."""
        return sum(run.in_time is True for run in self.runs)

    @property
    def alarmed(self) -> int:
        """Runs with an alarm."""
        return sum(bool(run.causes) for run in self.runs)

    @property
    def words(self) -> str:
        """What became of them, in a few words."""
        told = [f"{self.count(outcome)} {outcome}" for outcome in OUTCOMES if self.count(outcome)]
        if len(told) == 1:
            told = [told[0].split()[1]]
        delays = [run.detected_after for run in self.runs if run.detected_after is not None]
        if diverged := self.count("diverged"):
            late = f", after {delay:.1f} s" if delays and (delay := statistics.median(delays)) >= 0.05 else ""
            told.append(f"told {self.detected}/{diverged}{late}")
        elif self.alarmed:
            told.append(f"alarms {self.alarmed}/{len(self.runs)}")
        broken = [run.broken for run in self.runs if run.broken]
        return "; ".join([*told, *(["BROKEN: " + broken[0]] if broken else [])])

    @property
    def cause(self) -> str:
        """The most frequent first cause of an alarm."""
        first = Counter(run.causes[0] for run in self.runs if run.causes)
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

    def cell(self, fault: str, label: str | None = None) -> Cell:
        """The runs of a fault with one filter; None: with all."""
        return Cell(tuple(run for run in self.runs if run.fault == fault and label in (None, run.filter)))

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
        told = self.summary()
        lines = [
            f"contract kept in {told['runs'] - told['broken']} of {told['runs']} runs",
            f"divergence told in time in {told['detected_in_time']} of {told['diverged']} runs"
            + (
                f" ({told['diverged_hidden']} more where innovations cannot show it)" if told["diverged_hidden"] else ""
            ),
            f"false alarms in {told['false_alarms']} of {told['nominal']} drives with nothing wrong",
        ]
        return lines

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
            [name, *(self.cell(name, label).words for label in self.filters), self.cell(name).cause]
            for name in self.faults
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
    engine: Engine | None = None,
    progress: Progress | None = None,
) -> FaultMatrix:
    """Run every fault with every filter.

    Parameters
    ----------
    filters : sequence of FilterChoice
        With a gate of 0.99, where they know one.
    faults : sequence of str
        Keys of `FAULTS`.
    seeds : int
        Drives of each, from seed 0 on.
    engine : Engine, optional
        Where; None: one after the other, in this process.
    progress : callable, optional
        Called with (drives done, drives) after each.

    Raises
    ------
    ValueError
        There is no such fault or filter, or an option is refused.
    """
    wanted = {name: find_fault(name) for name in faults}
    first = next(iter(FAULTS.values())).drive(0)
    for choice in filters:  # before any work is done
        make_with_common_options(choice.name, first.camera, first.noise, choice.options, {})
    tasks = [(name, seed) for name in wanted for seed in range(seeds)]
    runs: list[Run] = []
    with (engine or Engine(jobs=1)).started() as map_tasks:
        for done, some in enumerate(map_tasks(partial(_run, tuple(filters)), tasks), 1):
            runs += some
            if progress is not None:
                progress(done, len(tasks))
    order = {name: place for place, name in enumerate(wanted)}
    labels = {choice.label: place for place, choice in enumerate(filters)}
    return FaultMatrix(tuple(sorted(runs, key=lambda run: (order[run.fault], labels[run.filter], run.seed))))


def judge(session: Session, fault: str, label: str, seed: int) -> Run:
    """What became of a drive."""
    begins = FAULTS[fault].begins
    since = session.times >= begins
    diverged = DIVERGED.passed(session) & since
    outcome = OUTCOMES[2 if diverged.any() or session.broken else int((DEGRADED.passed(session) & since).any())]
    at = detected = in_time = None
    if diverged.any():
        place = int(diverged.argmax())
        at = float(session.times[place])
        told = next((alarm.time for alarm in session.alarms if alarm.time >= begins - 1e-9), None)
        detected = None if told is None else told - at
        later = session.times[place + 1] - at if place + 1 < len(session.times) else 0.0
        in_time = detected is not None and bool(detected <= max(IN_TIME, later) + 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = session.position_errors[since] / np.maximum(session.travelled[since], 1.0)
    causes = tuple(alarm.cause.name for alarm in session.alarms)
    worst = 100.0 * float(shares.max(initial=0.0))
    return Run(fault, label, seed, outcome, at, detected, in_time, causes, worst, session.refused, session.broken)


def _run(filters: Sequence[FilterChoice], task: tuple[str, int]) -> list[Run]:
    return list(_runs(filters, *task))


def _runs(filters: Sequence[FilterChoice], fault: str, seed: int) -> Iterator[Run]:
    recording = FAULTS[fault].drive(seed)
    for choice in filters:
        made = make_with_common_options(
            choice.name, recording.camera, recording.noise, choice.options, {"gate": GATE}
        ).filter
        with threadpool_limits(limits=1), np.errstate(all="ignore"):
            session = drive_through(recording, made, DivergenceMonitor())
        yield judge(session, fault, choice.label, seed)
