"""The determinism certificate: one hash a scenario, the same whichever way it is run.

Run in several ways, each part of a scenario must come out bit for bit the same: what every filter was given (`stream`),
everything that each of them returned in every frame (`filter <label>`), the bound, and what the scenario's environment
returns to an agent (`episodes`). What a clock or the system's memory says is no part of it.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from stereo_slam_env.benchmark.campaign import run_benchmark
from stereo_slam_env.benchmark.certificate_episodes import VECTOR_WAYS, digest_of_episodes, has_environment
from stereo_slam_env.benchmark.running.engines import Engine
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.study import Study
from stereo_slam_env.benchmark.storage.store import pairing_digest
from stereo_slam_env.benchmark.storage.study_store import CellResult
from stereo_slam_env.evaluation.results import FilterRun
from stereo_slam_env.files.digest import Digest

ENGINE_WAYS: Mapping[str, Engine] = {
    "one process": Engine("processes", 1),
    "again": Engine("processes", 1),
    "processes": Engine("processes", 2),
    "ray": Engine("ray", 2),
    "dask": Engine("dask", 2),
}
# Vectors first: a process that has talked to a cluster has threads, and is not to be forked.
WAYS = (*VECTOR_WAYS, *ENGINE_WAYS)
DEFAULT_SCENARIOS = ("reference-turn", "turn", "gaze")
_NO_RESULT = ("milliseconds", "predict_milliseconds", "update_milliseconds", "memory_mb")

Parts = Mapping[str, str]
Progress = Callable[[float, int], None]


@dataclass(frozen=True)
class Certificate:
    """What came out of a scenario, way by way.

    Attributes
    ----------
    scenario : str
        Name of it, or of the cell of a grid.
    found : mapping of str to mapping
        By way, the SHA-256 of each part that was made that way.
    not_run : mapping of str to str
        Ways that are not to be had here, and why.
    """

    scenario: str
    found: Mapping[str, Parts]
    not_run: Mapping[str, str]

    @property
    def parts(self) -> Parts:
        """Every part, as the first way that made it has it."""
        first: dict[str, str] = {}
        for parts in self.found.values():
            first = {**parts, **first}
        return dict(sorted(first.items()))

    @property
    def sha256(self) -> str:
        """The hash of the scenario, over all parts."""
        return hashlib.sha256(json.dumps(self.parts).encode()).hexdigest()

    @property
    def differences(self) -> tuple[tuple[str, str], ...]:
        """Way and part that is not what the first way made."""
        parts = self.parts
        return tuple((way, name) for way, made in self.found.items() for name in made if made[name] != parts[name])

    @property
    def holds(self) -> bool:
        """Whether all ways gave the same."""
        return not self.differences

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        return {
            "scenario": self.scenario,
            "sha256": self.sha256,
            "holds": self.holds,
            "parts": dict(self.parts),
            "ways": list(self.found),
            "not_run": dict(self.not_run),
            "differences": [{"way": way, "part": part} for way, part in self.differences],
        }


def certify(
    study: Study,
    ways: Sequence[str] = WAYS,
    *,
    seeds: int = 2,
    frames: int = 20,
    progress: Progress | None = None,
) -> tuple[Certificate, ...]:
    """Run a study in several ways and compare every bit.

    One of the ways starts new Python processes: a script that calls this needs `if __name__ == "__main__":`.

    Parameters
    ----------
    study : Study
        What to run; of a grid, all its cells.
    ways : sequence of str
        Some of `WAYS`. A way whose extra is not installed is left out, and the certificate says so.
    seeds, frames : int
        How much of each scenario: its first seeds and frames.
    progress : callable, optional
        Called with (ways done, ways).

    Returns
    -------
    tuple of Certificate
        One a cell.

    Raises
    ------
    ValueError
        There is no such way, `seeds` or `frames` is too small, or the study cannot be run.
    """
    for way in ways:
        if way not in WAYS:
            raise ValueError(f"way must be one of {', '.join(WAYS)}, got {way!r}")
    if seeds < 1 or frames < 2:
        raise ValueError(f"seeds must be >= 1 and frames >= 2, got {seeds} and {frames}")
    if not ways:
        raise ValueError(f"ways must name at least one of {', '.join(WAYS)}")
    study = study.with_scenarios(lambda scenario: _short(scenario, seeds, frames))
    found: dict[str, dict[str, Parts]] = {cell.name: {} for cell in study.cells}
    not_run: dict[str, str] = {}
    chosen = [way for way in WAYS if way in ways]
    for done, way in enumerate(chosen):
        if progress is not None:
            progress(done, len(chosen))
        try:
            made = _episodes(study, way) if way in VECTOR_WAYS else _runs(study, ENGINE_WAYS[way])
        except ImportError as error:
            not_run[way] = str(error)
            continue
        for name, parts in made.items():
            found[name][way] = parts
    if progress is not None:
        progress(len(chosen), len(chosen))
    return tuple(Certificate(name, by_way, not_run) for name, by_way in found.items())


def digest_of_run(run: FilterRun) -> str:
    """SHA-256 of all that a filter returned and what became of it, without what the clock said."""
    digest = Digest()
    for field in dataclasses.fields(run):
        if field.name not in _NO_RESULT:
            digest.add(field.name, getattr(run, field.name))
    return digest.hex()


def _short(scenario: Scenario, seeds: int, frames: int) -> Scenario:
    few = frames if scenario.frames is None else min(frames, scenario.frames)
    return dataclasses.replace(scenario, seeds=scenario.seeds[:seeds], frames=few)


def _runs(study: Study, engine: Engine) -> dict[str, Parts]:
    """The parts of each cell that a benchmark makes."""
    with TemporaryDirectory(prefix="certificate-") as folder:
        result = run_benchmark(study, Path(folder) / "run", jobs=engine.jobs, engine=engine.name)
        return {cell.cell.name: _parts(cell) for cell in result.cells}


def _parts(result: CellResult) -> Parts:
    _, recordings = result.directory.load()
    streams = [[about["seed"], pairing_digest(about), about.get("streams")] for about in recordings]
    parts = {"stream": hashlib.sha256(json.dumps(streams, sort_keys=True).encode()).hexdigest()}
    if result.bounds:
        bounds = Digest()
        for (name, seed), bound in sorted(result.bounds.items(), key=str):
            bounds.add(f"{name} {seed}", bound.pose)
        parts["bound"] = bounds.hex()
    for label in dict.fromkeys(run.filter_name for run in result.runs):
        digests = [digest_of_run(run) for run in result.runs if run.filter_name == label]
        parts[f"filter {label}"] = hashlib.sha256("".join(digests).encode()).hexdigest()
    return parts


def _episodes(study: Study, way: str) -> dict[str, Parts]:
    """The part of each cell that its environment makes, where it has one."""
    return {
        cell.name: {"episodes": digest_of_episodes(cell.scenario, way)}
        for cell in study.cells
        if has_environment(cell.scenario)
    }
