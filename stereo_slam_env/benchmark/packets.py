"""Packets of results: what a run is and what came out of it, small enough to be handed in, and checked by repetition.

A packet is JSON: the study with its seeds, versions and digest of the code, a SHA-256 of the measurements of every
recording, the figures of every trial, and in sentences what is missing in them. Nothing in it has to be believed:
`verify` runs a part again, which it draws at random, and compares measurements, figures and claims.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from filters.contract.validation import first_line, plain
from stereo_slam_env.benchmark.campaign import Progress, check_study, run_checked
from stereo_slam_env.benchmark.packet_form import (
    CLAIMED,
    KEPT,
    MOST_BYTES,
    checked_packet,
    columns_of,
    missing_in,
    with_trials,
)
from stereo_slam_env.benchmark.running.backends import Backend
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.storage.code_identity import code_digest
from stereo_slam_env.benchmark.storage.result_tables import CellResult, results_of
from stereo_slam_env.benchmark.storage.run_files import SETTINGS
from stereo_slam_env.benchmark.storage.store import prepared_study, read_study
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.trajectory_score import evaluate_trajectory
from stereo_slam_env.evaluation.trial import estimate_of, reference_of
from stereo_slam_env.files.folders import write_json
from stereo_slam_env.files.readers import read_json

_FORMATS = "stereo-slam packet "
FORMAT = f"{_FORMATS}2"
DATA = "{data}"
"""What stands for the folder of real recordings, which is another one elsewhere."""
_OF_THE_MACHINE = ("ms_per_frame", "failure")
"""Those that are not compared by `verify`."""
SAME = 1e-3
"""Relative difference up to which figures agree: other processors round otherwise, and filters magnify it."""


def packet_of(run: Path) -> dict[str, Any]:
    """The packet of a finished run directory; raises as `results_of`."""
    directory = read_study(run)
    study = directory.study.with_scenarios(lambda scenario: _moved(scenario, to=None))
    cells = [_cell(result, result.recordings[:CLAIMED]) for result in map(results_of, directory.cells)]
    cells_with_study = zip(cells, study.cells, strict=True)
    return {
        "format": FORMAT,
        "study": study.as_dict(),
        "versions": read_json(directory.cells[0].out / SETTINGS, inside=directory.root)["versions"],
        "cells": cells,
        "missing": [
            sentence for cell, of_study in cells_with_study for sentence in missing_in(cell, of_study.scenario)
        ],
    }


def _cell(result: CellResult, claimed: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Recordings and trials of one cell, with the claims on some of the recordings."""
    runs = {(run.filter_name, run.recording_name, run.seed): run for run in result.runs}
    plugins = result.directory.plugin_code()
    keys = {(about["name"], about["seed"]) for about in claimed}
    trials = {}
    for label, figures in result.figures.items():
        trials[label] = [
            {"recording": key[0], "seed": key[1], **{name: _short(row.get(name)) for name in KEPT}}
            | _claim(runs.get((label, *key)) if key in keys else None)
            for key, row in figures.of_run.items()
        ]
    return {
        "name": result.cell.name,
        "recordings": [
            {key: about.get(key) for key in ("name", "seed", "frames")}
            # Who looks elsewhere measures something else: then there is a digest of each.
            | {"stream_sha256": about.get("stream_sha256") or about["streams"]}
            | {"reference": about.get("reference", {}).get("kind")}
            for about in result.recordings
        ],
        "trials": trials,
        "code_of_others": {label: digest for label, digest in plugins.items() if digest is not None},
    }


def _claim(run: FilterRun | None) -> dict[str, Any]:
    """Scale gap, coverage and log score of the pose, as `evaluate` has them; empty where nothing is claimed."""
    if run is None or run.failure is not None or not run.reference.counts_as_truth:
        return {}
    estimate, reference = estimate_of(run), reference_of(run)
    if estimate is None or reference is None or estimate.covariances is None:
        return {}
    try:
        score = evaluate_trajectory(estimate, reference, align="none")
    except ValueError:
        return {}
    if (claim := score.claim) is None:
        return {}
    claim_figures = {
        "scale_gap": claim.scale_gap,
        "coverage_90": claim.coverage[0.9],
        "log_score": claim.log_score.mean,
    }
    return {"claim": {**{name: _short(value) for name, value in claim_figures.items()}, "gauge": score.alignment}}


def _short(value: Any) -> Any:
    """A number with as many digits as are compared, and some."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _moved(scenario: Scenario, to: Path | None) -> Scenario:
    """The scenario with the folder of its real recording, and of trajectories, replaced by `DATA`; or back."""
    path = scenario.source.options.get("path")
    if isinstance(path, str) and path.partition(":")[0] != "gtsam":
        name = Path(path.replace(DATA, ".")).name
        scenario = scenario.replaced(source=scenario.source.replaced(path=f"{DATA if to is None else to}/{name}"))
    filters = tuple(
        choice.replaced(options={**choice.options, "file": Path(str(choice.options["file"])).name})
        if choice.is_outside
        else choice
        for choice in scenario.filters
    )
    return scenario.replaced(filters=filters)


def write_packet(path: Path, packet: Mapping[str, Any]) -> None:
    """Write a packet, as compact JSON: trials by columns, so that a figure is named once, not in every trial.

    A `ValueError` says that something else has this name.
    """
    require_no_other(path)
    write_json(path, {**packet, "cells": with_trials(packet["cells"], columns_of)}, indent=None)


def require_no_other(path: Path) -> None:
    """Raise a `ValueError` where a path is that of anything but a packet."""
    content = read_json(path) if path.exists() else {"format": FORMAT}
    if not isinstance(content, dict) or not str(content.get("format")).startswith(_FORMATS):
        raise ValueError(f"{path} is there and is no packet: choose another name by --out")


def read_packet(path: Path) -> dict[str, Any]:
    """Read a packet.

    Raises
    ------
    ValueError
        The file is missing, no packet, or damaged: one line that names it.
    """
    try:
        content = read_json(path, most_bytes=MOST_BYTES)
    except FileNotFoundError as error:
        raise ValueError(f"{path} does not exist: give what `stereo-slam submit` wrote") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"{path} is no packet of results ({FORMAT}): write one with `stereo-slam submit RUN`")
    try:
        return checked_packet(content)
    except (KeyError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        reason = f"{type(error).__name__}: {first_line(error)}"
        raise ValueError(f"{path} is a damaged packet ({reason}): submit the run again") from error
    except ValueError as error:
        raise ValueError(f"{path} is a damaged packet: {first_line(error)}") from error


@dataclass(frozen=True)
class Verified:
    """Result of the repetition of a part of a packet."""

    cells: tuple[str, ...]
    """Cells that were run again."""
    trials: int
    """Trials that were run again."""
    of: int
    """Trials in the packet."""
    same_streams: bool
    """Whether the measurements are the same to the last bit."""
    same_code: bool
    """Whether the code is that of the packet, plug-ins aside."""
    other_plugins: tuple[str, ...]
    """Filters of others whose code is not that of the packet."""
    largest: float
    """Largest relative difference of a figure; infinity where one is known on one side only."""
    differences: tuple[str, ...]
    """Those beyond `SAME`, and of measurements, each in words."""
    draw: int
    """Seed of what was drawn."""

    @property
    def agrees(self) -> bool:
        """Whether measurements and every figure agree."""
        return not self.differences

    @property
    def words(self) -> str:
        """The result in sentences."""
        streams = "the same measurements to the last bit" if self.same_streams else "other measurements"
        code = "the same code" if self.same_code else "other code"
        if self.other_plugins:
            code += plain(f" and other code of {', '.join(self.other_plugins)}")
        drawn = "" if self.trials == self.of else f" (--draw {self.draw})"
        text = f"{self.trials} of {self.of} trials were run again{drawn}, by {code}, on {streams}: "
        if self.agrees:
            return text + (
                "they agree exactly." if not self.largest else f"they agree to {self.largest:.1e} of a figure."
            )
        more = len(self.differences) - 3
        examples = "; ".join(self.differences[:3]) + (f"; and {more} more" if more > 0 else "")
        return text + f"they do not agree: {examples}."

    def as_dict(self) -> dict[str, Any]:
        """All of it as plain data for JSON."""
        largest = self.largest if math.isfinite(self.largest) else None
        return {**asdict(self), "largest": largest, "agrees": self.agrees, "words": self.words}


def verify(
    packet: Mapping[str, Any],
    out: Path,
    *,
    seeds: int = 2,
    cells: int = 1,
    everything: bool = False,
    data: Path | None = None,
    jobs: int = 2,
    draw: int | None = None,
    progress: Progress | None = None,
) -> Verified:
    """Run a part of a packet again and compare.

    Parameters
    ----------
    packet : mapping
        Of `read_packet`.
    out : Path
        Run directory of the repetition.
    seeds, cells : int
        How many recordings of how many cells are run again, drawn at random.
    everything : bool
        Run all of it again.
    data : Path, optional
        Folder that holds the real recordings.
    jobs : int
        Trials at a time.
    draw : int, optional
        Seed of what is drawn, to draw the same again; None: nobody can know it before.
    progress : callable, optional
        As of `run_benchmark`.

    Raises
    ------
    ValueError
        The study cannot be run here: a recording or a filter is missing, or its source is code of somebody else.
    """
    study = Study.from_dict(packet["study"])
    draw = secrets.randbits(32) if draw is None else draw
    rng = np.random.default_rng(draw)
    packet_cells = {cell["name"]: cell for cell in packet["cells"]}
    runnable_cells = [cell for cell in study.cells if not all(choice.is_outside for choice in cell.scenario.filters)]
    if not runnable_cells:
        raise ValueError("all of its systems are from outside: there is nothing to run again")
    picked = runnable_cells if everything else _some(rng, runnable_cells, cells)
    chosen_cells = []
    for cell in picked:
        scenario = _here(cell.scenario, data)
        filters = tuple(choice for choice in scenario.filters if not choice.is_outside)
        wanted_seeds = scenario.seeds if everything or not scenario.source.seeded else _some(rng, scenario.seeds, seeds)
        chosen_cells.append(cell.replaced(scenario=_limited(scenario, filters, wanted_seeds)))
    part = Study(study.name, tuple(chosen_cells))
    check_study(part)
    run_checked(prepared_study(out, part), Backend("processes", jobs, None), progress)
    differences, largest, trials, same_streams = [], 0.0, 0, True
    other_plugins: dict[str, None] = {}
    for cell, directory in zip(picked, read_study(out).cells, strict=True):
        before, result = packet_cells[cell.name], results_of(directory)
        again = _cell(result, result.recordings)
        known_recordings = {(one["name"], one["seed"]): one for one in before["recordings"]}
        claimed = [(one["name"], one["seed"]) for one in before["recordings"][: min(CLAIMED, cell.scenario.kept_seeds)]]
        for one in again["recordings"]:
            was = known_recordings.get((one["name"], one["seed"]), {})
            same = _same_streams(was.get("stream_sha256"), one["stream_sha256"])
            same_streams &= same
            if not same or any(was.get(key) != one[key] for key in ("frames", "reference")):
                differences.append(f"{one['name']} has other measurements here")
        for label, rows in again["trials"].items():
            if before["code_of_others"].get(label) != again["code_of_others"].get(label):
                other_plugins[label] = None
            packet_rows = {(row["recording"], row["seed"]): row for row in before["trials"].get(label, ())}
            for row in rows:
                trials += 1
                key = row["recording"], row["seed"]
                where = f"{label} on {row['recording']}" + ("" if row["seed"] is None else f", seed {row['seed']}")
                of_row = packet_rows.get(key, {})
                gaps = [*_gaps(of_row, row)]
                rounded = any(gap for _, gap, _ in gaps)
                gaps += _claim_gaps(of_row, row, expected=key in claimed, rounded=rounded)
                for name, gap, words in gaps:
                    largest = max(largest, gap)
                    if gap > SAME:
                        differences.append(f"{name} of {where}: {words}")
    total = sum(len(rows) for cell in packet["cells"] for rows in cell["trials"].values())
    return Verified(
        cells=tuple(cell.name for cell in picked),
        trials=trials,
        of=total,
        same_streams=same_streams,
        same_code=packet["versions"].get("code") == code_digest(),
        other_plugins=tuple(other_plugins),
        largest=largest,
        differences=tuple(map(plain, differences)),
        draw=draw,
    )


def _limited(scenario: Scenario, filters: tuple[FilterChoice, ...], seeds: tuple[int, ...]) -> Scenario:
    """The part of a scenario that is run again: its time series are kept, and its limits of time are no longer ones."""
    usual = Scenario("usual")
    return scenario.replaced(
        filters=filters,
        seeds=seeds,
        kept_seeds=max(scenario.kept_seeds, len(seeds)),
        frame_time_limit=min(scenario.frame_time_limit, usual.frame_time_limit),
        recording_time_limit=min(scenario.recording_time_limit, usual.recording_time_limit),
    )


def _same_streams(before: Any, again: Any) -> bool:
    """Whether digests of measurements are the same; those of systems from outside are not made again."""
    if isinstance(before, Mapping) and isinstance(again, Mapping):
        return all(before.get(label) == digest for label, digest in again.items())
    return bool(before == again)


def _gaps(before: Mapping[str, Any], again: Mapping[str, Any]) -> Iterator[tuple[str, float, str]]:
    """Relative differences of the figures of a trial, with both values in words."""
    for name in KEPT:
        if name in _OF_THE_MACHINE:
            continue
        a, b = before.get(name), again.get(name)
        if a is None or b is None:
            yield name, 0.0 if a is b else math.inf, f"{a} in the packet, {b} here"
        else:
            yield name, _gap(a, b, 0.0), f"{a:.6g} in the packet, {b:.6g} here"


def _claim_gaps(
    before: Mapping[str, Any], again: Mapping[str, Any], *, expected: bool, rounded: bool
) -> Iterator[tuple[str, float, str]]:
    """Differences of the claim of a trial: a packet has one where one can be made, of its first recordings.

    Where figures are `rounded` otherwise, a share of frames may have one more or less.
    """
    a, b = before.get("claim"), again.get("claim")
    if a is None and not expected:
        return
    if a is None or b is None or a["gauge"] != b["gauge"]:
        if a is not b:
            yield "claim", math.inf, f"{a and a['gauge']} in the packet, {b and b['gauge']} here"
        return
    frame = 1.5 / max(again["frames"] or 1, 1) if rounded else 0.0
    yield "coverage_90", _gap(a["coverage_90"], b["coverage_90"], frame), f"{a['coverage_90']}, {b['coverage_90']} here"
    for name, least in (("scale_gap", 0.0), ("log_score", 1.0)):
        gap = abs(a[name] - b[name]) / max(abs(a[name]), abs(b[name]), least) if a[name] != b[name] else 0.0
        yield name, gap, f"{a[name]:.6g} in the packet, {b[name]:.6g} here"


def _gap(a: float, b: float, allowed: float) -> float:
    """Relative difference, infinity where there is none; one within what is `allowed` is 0."""
    gap = abs(a - b) / max(abs(a), abs(b)) if abs(a - b) > allowed else 0.0
    return gap if math.isfinite(gap) else math.inf


def _here(scenario: Scenario, data: Path | None) -> Scenario:
    """The scenario as it can be run here."""
    if scenario.source.runs_code:
        raise ValueError(f"{scenario.name} is made by a function that its file names: it is not run from a packet")
    if DATA in str(scenario.source.options.get("path", "")):
        if data is None:
            raise ValueError(f"{scenario.name} is of a real recording: say by --data which folder holds it")
        return _moved(scenario, to=data)
    return scenario


def _some(rng: np.random.Generator, items: Sequence[Any], count: int) -> tuple[Any, ...]:
    """So many of the items, drawn at random, in their order."""
    picked = rng.choice(len(items), min(count, len(items)), replace=False)
    return tuple(items[k] for k in sorted(picked.tolist()))
