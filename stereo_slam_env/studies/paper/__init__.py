"""The paper's experiments again, and what they show of its claims: `stereo-slam paper`."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from stereo_slam_env import run_benchmark
from stereo_slam_env.benchmark import Backend, versions
from stereo_slam_env.files import (
    claimed_folder,
    is_occupied,
    own_files,
    read_arrays,
    read_json,
    write_atomically,
    write_json,
    write_text,
)
from stereo_slam_env.studies.paper import convergence, karlsruhe, landmark_uncertainty, long_drive, speed
from stereo_slam_env.studies.paper.claims import Arrays, Claim, ClaimFinding, ClaimVerdict, Interval, Range

__all__ = [
    "FULL",
    "QUICK",
    "Claim",
    "ClaimFinding",
    "ClaimVerdict",
    "Interval",
    "PaperResult",
    "PaperSettings",
    "Range",
    "run_experiments",
    "run_paper",
]

VERSION = 1
SETTINGS, RESULT, ROWS = "paper_settings.json", "paper.json", "claims.csv"
EXPERIMENTS, DRIVES = Path("trials") / "experiments", Path("trials") / "drives"
"""Folders: of one npz file an experiment, and of the benchmark's runs for section 4.4, by number of frames."""
Progress = Callable[[float, int], None]


@dataclass(frozen=True)
class PaperSettings:
    """Size of the study; a `ValueError` where a number is not positive."""

    samples: int = 10_000  # of each Monte-Carlo cloud of section 4.1
    turn_seeds: int = 200  # recordings of 4.3, for each noise
    drive_seeds: int = 20  # recordings of 4.4, for each noise
    drive_frames: int = 800  # and their length
    sizes: tuple[int, ...] = (25, 50, 100, 200)  # numbers of landmarks that the speed is measured at
    repeats: int = 30  # rounds of that measurement

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            numbers = value if isinstance(value, tuple) else (value,)
            if not numbers or any(type(number) is not int or number < 1 for number in numbers):
                raise ValueError(f"{field.name} must be whole numbers >= 1, got {value!r}")

    @property
    def remark(self) -> str:
        """Warning of a run that measures less than the full one, which its page and its table begin with; or none."""
        less = [
            f"{field.name} {getattr(self, field.name)} of {field.default}"
            for field in fields(self)
            if _size(getattr(self, field.name)) < _size(field.default)
        ]
        if not less:
            return ""
        return (
            f"A quick run ({', '.join(less).replace('_', ' ')}): most intervals are too wide to decide, and what is "
            "not shown here is not refuted. Do not cite its verdicts."
        )


def _size(number: Any) -> int:
    return sum(number) if isinstance(number, tuple) else int(number)


FULL = PaperSettings()
QUICK = PaperSettings(turn_seeds=20, drive_seeds=6, drive_frames=150, sizes=(25, 50, 100), repeats=8)
"""To see that everything works, within a minute; most intervals are then too wide to show anything."""


@dataclass(frozen=True, eq=False)
class PaperResult:
    """Result of the study and its place."""

    out: Path
    claims: tuple[Claim, ...]
    report: Path


def run_paper(
    out: str | Path,
    settings: PaperSettings = FULL,
    *,
    jobs: int = 1,
    karlsruhe_path: Path | None = None,
    progress: Progress | None = None,
) -> PaperResult:
    """Run the paper's experiments again and judge its claims.

    Finished experiments are kept in `out`: the same call goes on where an interrupted one stopped.

    Parameters
    ----------
    out : str or Path
        Directory for `paper.json` (claims with their numbers, settings, versions), `claims.csv`, `figures` (PNG and
        SVG), `report.html`, and the experiments.
    settings : PaperSettings
        How much is measured.
    jobs : int
        Processes, one BLAS thread each. Time is measured in one process after everything else.
    karlsruhe_path : Path, optional
        Folder of the Karlsruhe sequences.
    progress : callable, optional
        Called with (experiments done, experiments), where a drive of section 4.4 with one filter is one of them.

    Raises
    ------
    ValueError
        `out` holds something else or is in use by another process, jobs < 1, or there are no such sequences.
    """
    out, tell = Path(out), progress or (lambda done, total: None)
    together = Backend(jobs=jobs)
    sequences = {} if karlsruhe_path is None else karlsruhe.sequences(karlsruhe_path)
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    if out.is_dir() and is_occupied(out) and not holds_paper(out):
        raise ValueError(f"output {out} is not empty and holds no run of the paper: choose another directory")
    with claimed_folder(out):
        about = {"version": VERSION, "settings": asdict(settings), "versions": versions()}
        if settings.remark:
            about["remark"] = settings.remark
        own_files(out, (RESULT, ROWS, "report.html"), is_run=True)
        write_json(out / SETTINGS, about)

        drives = long_drive.study(settings.drive_seeds, settings.drive_frames)
        untimed = {**convergence.experiments(settings.turn_seeds), **karlsruhe.experiments(sequences)}
        timed = speed.experiments(settings.sizes, settings.repeats)
        trials = sum(len(cell.scenario.filters) * len(cell.scenario.seeds) for cell in drives.cells)
        total = trials + len(untimed) + len(timed)

        def after(before: int) -> Progress:
            return lambda done, of: tell(before + done, total)

        def of_drives(done: float, of: int) -> None:
            tell(trials * done / of, total)

        benchmark = run_benchmark(drives, out / f"{DRIVES}-{settings.drive_frames}", jobs=jobs, progress=of_drives)
        runs = long_drive.runs_of(benchmark)
        results = run_experiments(untimed, out / EXPERIMENTS, together, after(trials))
        results |= run_experiments(timed, out / EXPERIMENTS, Backend(jobs=1), after(trials + len(untimed)))
        claims = (
            *landmark_uncertainty.judge(settings.samples),
            *convergence.judge(results),
            *long_drive.judge(runs),
            *speed.judge(results),
            *karlsruhe.judge(results),
        )
        write_json(out / RESULT, {**about, "claims": [_as_dict(claim) for claim in claims]})
        _write_rows(out / ROWS, claims)
        from stereo_slam_env.studies.paper.report import write_report  # draws, which only this needs

        return PaperResult(out, claims, write_report(out, claims, results, runs, settings, bool(sequences)))


def run_experiments(
    experiments: Mapping[str, partial[Arrays]], folder: Path, backend: Backend, progress: Progress
) -> dict[str, Arrays]:
    """Results by name of a file; what `folder` has of the same arguments and code is not computed again."""
    folder.mkdir(parents=True, exist_ok=True)
    own_code = b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
    code = [versions()["code"], hashlib.sha256(own_code).hexdigest()]
    keys = {name: json.dumps([*code, work.args, work.keywords]) for name, work in experiments.items()}
    found = {name: _kept(folder / f"{name}.npz", key) for name, key in keys.items()}
    results = {name: arrays for name, arrays in found.items() if arrays is not None}
    progress(len(results), len(experiments))
    missing = [(folder / f"{name}.npz", keys[name], work) for name, work in experiments.items() if name not in results]
    with backend.started() as run_all:
        for name, arrays in run_all(_computed, missing) if missing else ():
            results[name] = arrays
            progress(len(results), len(experiments))
    return results


def _computed(task: tuple[Path, str, partial[Arrays]]) -> tuple[str, Arrays]:
    path, key, work = task
    arrays = work()
    named: dict[str, Any] = {"made from": np.array(key), **arrays}
    write_atomically(path, lambda stream: np.savez_compressed(stream, **named))
    return path.stem, arrays


def _kept(path: Path, key: str) -> Arrays | None:
    """The arrays of the file, if it is of this key."""
    try:
        arrays = read_arrays(path)
        return arrays if str(arrays.pop("made from")) == key else None
    except (OSError, ValueError, KeyError):
        return None


def _as_dict(claim: Claim) -> dict[str, Any]:
    sentence = asdict(claim.sentence)
    del sentence["asked"]  # of each finding
    findings = [_finding(finding) for finding in claim.findings]
    return {**sentence, "verdict": claim.verdict.value, "says": claim.says, "findings": findings}


def holds_paper(out: Path) -> bool:
    """Whether a directory holds settings of this experiment, and not only a file of their name."""
    about = read_json(out / SETTINGS, inside=out) if (out / SETTINGS).exists() else None
    return isinstance(about, dict) and {"settings", "versions"} <= about.keys()


def _finding(finding: ClaimFinding) -> dict[str, Any]:
    ends = (*vars(finding.measured).values(), *vars(finding.asked).values())
    value, *limits = (number if math.isfinite(number) else None for number in ends)
    return {
        "condition": dict(finding.condition),
        "measured": value,
        "interval": limits[:2],
        "asked": limits[2:],
        "verdict": finding.verdict.value,
    }


def _write_rows(path: Path, claims: Sequence[Claim]) -> None:
    """One row a finding."""
    heads = ("key", "section", "claim", "statement", "condition", "measured", "low", "high", "asked", "verdict", "says")
    file = io.StringIO(newline="")
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow((*heads, "evidence"))
    for claim in claims:
        said = claim.sentence
        for found in claim.findings:
            condition = ", ".join(f"{factor}: {level}" for factor, level in found.condition.items())
            about = said.key, said.section, said.claim, said.statement, condition
            verdict = found.asked, found.verdict.value, claim.says, said.evidence
            rows.writerow((*about, *vars(found.measured).values(), *verdict))
    write_text(path, file.getvalue())
