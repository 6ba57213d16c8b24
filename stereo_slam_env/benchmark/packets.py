"""Packets of results: what a run is and what came out of it, small enough to be handed in, and checked by repetition.

A packet is JSON: the study with its seeds, versions and digest of the code, a SHA-256 of the measurements of every
recording, the figures of every trial, and in sentences what is missing in them. Nothing in it has to be believed:
`verify` runs a part again, chosen by the packet's own digest, and compares measurements and figures.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from filters.contract.known_names import require_known
from stereo_slam_env.benchmark.campaign import Progress, check_study, run_checked
from stereo_slam_env.benchmark.running.backends import Backend
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.storage.code_identity import code_digest
from stereo_slam_env.benchmark.storage.settings import SETTINGS
from stereo_slam_env.benchmark.storage.store import prepared_study, read_study
from stereo_slam_env.benchmark.storage.tables import CellResult, results_of
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.evaluation.run_trajectories import estimate_of, reference_of
from stereo_slam_env.evaluation.trajectory_score import evaluate_trajectory
from stereo_slam_env.files.json_files import write_json
from stereo_slam_env.files.readers import read_json

_FORMATS = "stereo-slam packet "
FORMAT = f"{_FORMATS}2"
DATA = "{data}"
"""What stands for the folder of real recordings, which is another one elsewhere."""
KEPT = (
    *("frames", "path_m", "position_rmse_m", "rotation_rmse_deg", "ate_rigid_m", "end_drift_percent"),
    *("pose_anees", "position_anees", "rotation_anees", "window_nees_1s", "window_nees_10s", "nis"),
    *("frames_not_scored", "diverged", "failure", "ms_per_frame"),
)
"""Figures of a trial that a packet has."""
_OF_THE_MACHINE = ("ms_per_frame", "failure")
"""Those that are not compared by `verify`."""
SAME = 1e-3
"""Relative difference up to which figures agree: other processors round otherwise, and filters magnify it."""
_CLAIMS = 10
"""Recordings whose claims are scored."""


def packet_of(run: Path) -> dict[str, Any]:
    """The packet of a finished run directory; raises as `results_of`."""
    directory = read_study(run)
    results = [results_of(cell) for cell in directory.cells]
    study = directory.study.with_scenarios(lambda scenario: _moved(scenario, to=None))
    return {
        "format": FORMAT,
        "study": study.as_dict(),
        "versions": read_json(directory.cells[0].out / SETTINGS, inside=directory.root)["versions"],
        "cells": [_cell(result) for result in results],
        "missing": [sentence for result in results for sentence in _missing(result)],
    }


def _cell(result: CellResult) -> dict[str, Any]:
    """Recordings and trials of one cell."""
    runs = {(run.filter_name, run.recording_name, run.seed): run for run in result.runs}
    plugins = result.directory.plugin_code()
    first = {(about["name"], about["seed"]) for about in result.recordings[:_CLAIMS]}
    trials = {}
    for label, figures in result.figures.items():
        trials[label] = [
            {"recording": key[0], "seed": key[1], **{name: _short(row.get(name)) for name in KEPT}}
            | _claim(runs.get((label, *key)) if key in first else None)
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
    if "pose" not in score.claims:
        return {}
    claim = score.claims["pose"]
    found = {"scale_gap": claim.scale_gap, "coverage_90": claim.coverage[0.9], "log_score": claim.log_score.mean}
    return {"claim": {**{name: _short(value) for name, value in found.items()}, "gauge": score.alignment}}


def _short(value: Any) -> Any:
    """A number with as many digits as are compared, and some."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def _missing(result: CellResult) -> Iterator[str]:
    """What a reader would look for in vain, in sentences."""
    name = result.cell.name
    kinds = {about.get("reference", {}).get("kind") for about in result.recordings}
    if kinds & {"none", "odometry"}:
        yield f"{name}: recordings without an independent truth have no NEES"
    if "unknown" in kinds:
        yield f"{name}: where the truth comes from is not known"
    for choice in result.directory.scenario.competitors:
        rows = list(result.figures[choice.label].of_run.values())
        failed = [row["failure"] for row in rows if row["failure"]]
        if failed:
            yield f"{name}: {choice.label} failed in {len(failed)} of {len(rows)} runs ({failed[0]})"
        unscored = sum(row["frames_not_scored"] or 0 for row in rows)
        if unscored:
            yield f"{name}: {unscored} frames of {choice.label} have no NEES"
    outside = [choice.label for choice in result.directory.scenario.competitors if choice.is_outside]
    if outside:
        yield f"{name}: from outside, and not run again: {', '.join(outside)}"


def _moved(scenario: Scenario, to: Path | None) -> Scenario:
    """The scenario with the folder of its real recording, and of trajectories, replaced by `DATA`; or back."""
    path = scenario.source.options.get("path")
    if isinstance(path, str) and path.partition(":")[0] != "gtsam":
        name = Path(path.replace(DATA, ".")).name
        scenario = replace(scenario, source=scenario.source.replaced(path=f"{DATA if to is None else to}/{name}"))
    filters = tuple(
        replace(choice, options={**choice.options, "file": Path(str(choice.options["file"])).name})
        if choice.is_outside
        else choice
        for choice in scenario.filters
    )
    return replace(scenario, filters=filters)


def write_packet(path: Path, packet: Mapping[str, Any]) -> None:
    """Write a packet, as compact JSON: trials by columns, so that a figure is named once, not in every trial.

    A `ValueError` says that something else has this name.
    """
    require_no_other(path)
    write_json(path, {**packet, "cells": _with_trials(packet["cells"], _columns)}, indent=None)


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
        content = read_json(path)
    except FileNotFoundError as error:
        raise ValueError(f"{path} does not exist: give what `stereo-slam submit` wrote") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"{path} is no packet of results ({FORMAT}): write one with `stereo-slam submit RUN`")
    try:
        require_known(f"{path} has no key", content, ("format", "study", "versions", "cells", "missing"))
        content = {**content, "cells": _with_trials(content["cells"], _rows)}
        names = [cell.name for cell in Study.from_dict(content["study"]).cells]
        if names != [cell["name"] for cell in content["cells"]]:
            raise ValueError("its cells are not those of its study")
        for cell in content["cells"]:
            if not cell["recordings"] or not all(
                isinstance(one["stream_sha256"], str | dict) for one in cell["recordings"]
            ):
                raise ValueError(f"cell {cell['name']} has no recordings")
            _ = cell["code_of_others"].items()
            for rows in cell["trials"].values():
                for row in rows:
                    _ = row["recording"], row["seed"], [float(row[name] or 0.0) for name in KEPT if name != "failure"]
    except (KeyError, TypeError, AttributeError) as error:
        said = f"{type(error).__name__}: {error}"
        raise ValueError(f"{path} is a damaged packet ({said}): submit the run again") from error
    except ValueError as error:
        raise ValueError(f"{path} is a damaged packet: {error}") from error
    return content


def _with_trials(cells: Sequence[Mapping[str, Any]], form: Callable[[Any], Any]) -> list[dict[str, Any]]:
    """The cells with the trials of every filter in another form."""
    return [{**cell, "trials": {label: form(trials) for label, trials in cell["trials"].items()}} for cell in cells]


def _columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Trials by columns; one in which nothing is known is left out."""
    names = dict.fromkeys(name for row in rows for name, value in row.items() if value is not None)
    return {name: [row.get(name) for row in rows] for name in names}


def _rows(columns: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Trials as `_cell` makes them, of columns; raises ValueError where those differ in length."""
    known = (dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True))
    rows = [{"recording": None, "seed": None, **dict.fromkeys(KEPT), **row} for row in known]
    return [{name: value for name, value in row.items() if name != "claim" or value is not None} for row in rows]


@dataclass(frozen=True)
class Verified:
    """What the repetition of a part of a packet showed."""

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
    """Those beyond `SAME`, each in words."""

    @property
    def agrees(self) -> bool:
        """Whether every figure agrees."""
        return not self.differences

    @property
    def words(self) -> str:
        """The result in sentences."""
        streams = "the same measurements to the last bit" if self.same_streams else "other measurements"
        code = "the same code" if self.same_code else "other code"
        if self.other_plugins:
            code += f" and other code of {', '.join(self.other_plugins)}"
        text = f"{self.trials} of {self.of} trials were run again, by {code}, on {streams}: "
        if self.agrees:
            return text + (
                "they agree exactly." if not self.largest else f"they agree to {self.largest:.1e} of a figure."
            )
        more = len(self.differences) - 3
        shown = "; ".join(self.differences[:3]) + (f"; and {more} more" if more > 0 else "")
        return text + f"they do not agree: {shown}."

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
        How many recordings of how many cells are run again, chosen by the digest of the packet.
    everything : bool
        Run all of it again.
    data : Path, optional
        Folder that holds the real recordings.
    jobs : int
        Trials at a time.
    progress : callable, optional
        As of `run_benchmark`.

    Raises
    ------
    ValueError
        The study cannot be run here: a recording or a filter is missing, or its source is code of somebody else.
    """
    study = Study.from_dict(packet["study"])
    picked = _picked(packet, study, len(study.cells) if everything else cells)
    chosen = []
    for cell in picked:
        scenario = _here(cell.scenario, data)
        own = tuple(choice for choice in scenario.filters if not choice.is_outside)
        wanted = scenario.seeds if everything or not scenario.source.seeded else _some(packet, scenario.seeds, seeds)
        chosen.append(replace(cell, scenario=replace(scenario, filters=own, seeds=wanted)))
    part = Study(study.name, tuple(chosen))
    check_study(part)
    run_checked(prepared_study(out, part), Backend("processes", jobs, None), progress)
    found = packet_of(out)
    differences, largest, trials, same_streams = [], 0.0, 0, True
    other_plugins: dict[str, None] = {}
    told = {cell["name"]: cell for cell in packet["cells"]}
    for again in found["cells"]:
        before = told[again["name"] if again["name"] in told else picked[0].name]
        streams = {(one["name"], one["seed"]): one["stream_sha256"] for one in before["recordings"]}
        same_streams &= all(streams.get((o["name"], o["seed"])) == o["stream_sha256"] for o in again["recordings"])
        for label, rows in again["trials"].items():
            if before["code_of_others"].get(label) != again["code_of_others"].get(label):
                other_plugins[label] = None
            known = {(row["recording"], row["seed"]): row for row in before["trials"].get(label, ())}
            for row in rows:
                trials += 1
                where = f"{label} on {row['recording']}" + ("" if row["seed"] is None else f", seed {row['seed']}")
                for name, gap, words in _gaps(known.get((row["recording"], row["seed"]), {}), row):
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
        differences=tuple(differences),
    )


def _gaps(before: Mapping[str, Any], again: Mapping[str, Any]) -> Iterator[tuple[str, float, str]]:
    """Relative differences of the figures of a trial, with both values in words."""
    for name in KEPT:
        if name in _OF_THE_MACHINE:
            continue
        a, b = before.get(name), again.get(name)
        if a is None or b is None:
            yield name, 0.0 if a is b else math.inf, f"{a} in the packet, {b} here"
        else:
            gap = abs(a - b) / max(abs(a), abs(b)) if a != b else 0.0
            yield name, gap if math.isfinite(gap) else math.inf, f"{a:.6g} in the packet, {b:.6g} here"


def _here(scenario: Scenario, data: Path | None) -> Scenario:
    """The scenario as it can be run here."""
    if scenario.source.runs_code:
        raise ValueError(f"{scenario.name} is made by a function that its file names: it is not run from a packet")
    if DATA in str(scenario.source.options.get("path", "")):
        if data is None:
            raise ValueError(f"{scenario.name} is of a real recording: say by --data which folder holds it")
        return _moved(scenario, to=data)
    return scenario


def _digest(packet: Mapping[str, Any]) -> int:
    return int(hashlib.sha256(json.dumps(packet["cells"], sort_keys=True).encode()).hexdigest(), 16)


def _picked(packet: Mapping[str, Any], study: Study, count: int) -> list[Any]:
    """So many cells, chosen by the digest of the results: nobody can choose beforehand which are checked."""
    return list(_some(packet, study.cells, count))


def _some(packet: Mapping[str, Any], items: Sequence[Any], count: int) -> tuple[Any, ...]:
    start, step = _digest(packet) % len(items), max(1, len(items) // max(count, 1))
    return tuple(items[(start + k * step) % len(items)] for k in range(min(count, len(items))))
