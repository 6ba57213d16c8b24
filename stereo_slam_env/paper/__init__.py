"""The paper's experiments again, and what they show of its claims: `stereo-slam paper`."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

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
from stereo_slam_env.paper import convergence, drives, landmark_uncertainty, long_drive, speed
from stereo_slam_env.paper.paper_claims import (
    NOISES,
    PLACES,
    RENDERED,
    SENTENCES,
    Arrays,
    Claim,
    ClaimFinding,
    ClaimVerdict,
    Interval,
    Range,
)

__all__ = [
    "FIGURES",
    "FULL",
    "NOISES",
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

VERSION = 2
SETTINGS, RESULT, ROWS = "paper_settings.json", "paper.json", "claims.csv"
EXPERIMENTS = Path("trials") / "experiments"
"""Folder of one npz file an experiment."""
FIGURES: Mapping[str, str] = {
    "1": "4.1",
    "2": "4.1",
    "3": "3",
    "4": "4.3",
    "5": "4.3",
    "6": "4.4",
    "nees": "4.4",
    "speed": "5",
}
"""What each figure needs: the clouds of 4.1, a rendered turn, the turns of 4.3, the drives of 4.4, the times of 5."""
Progress = Callable[[float, int], None]


@dataclass(frozen=True)
class PaperSettings:
    """Size of the study; a `ValueError` where a number is not positive."""

    samples: int = 10_000  # of each Monte-Carlo cloud of section 4.1
    turn_seeds: int = 200  # recordings of 4.3, for each noise
    drive_seeds: int = 20  # recordings of 4.4, for each noise
    drive_frames: int = 800  # and their length
    rendered_turns: int = 20  # turns in rendered images
    rendered_drives: int = 6  # drives in rendered images, of as many frames
    sizes: tuple[int, ...] = (25, 50, 100, 200, 500, 1000, 2000)  # landmarks that the speed is measured at
    repeats: int = 30  # rounds of that measurement, fewer on large maps

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
QUICK = PaperSettings(
    turn_seeds=20, drive_seeds=6, drive_frames=150, rendered_turns=6, rendered_drives=1, sizes=(25, 100, 500), repeats=8
)
"""To see that everything works, within three minutes; most intervals are then too wide to show anything."""


@dataclass(frozen=True, eq=False)
class PaperResult:
    """Result of the study and its place."""

    out: Path
    claims: tuple[Claim, ...]
    report: Path
    notes: tuple[str, ...] = ()
    """What was not judged, and what it would need."""


def run_paper(
    out: str | Path,
    settings: PaperSettings = FULL,
    *,
    jobs: int = 1,
    real: Sequence[Path] = (),
    karlsruhe: Path | None = None,
    figure: str | None = None,
    progress: Progress | None = None,
) -> PaperResult:
    """Run the paper's experiments again and judge its claims, in simulation, in rendered images and on real drives.

    Finished experiments are kept in `out`: the same call goes on where an interrupted one stopped. The page is written
    after each section, in the order of the paper.

    Parameters
    ----------
    out : str or Path
        Directory for `paper.json` (claims with their numbers, settings, versions), `claims.csv`, `claims.md`,
        `figures` (PNG and SVG), `report.html`, and the experiments.
    settings : PaperSettings
        How much is measured.
    jobs : int
        Processes, one BLAS thread each. Time is measured in one process after everything else.
    real : sequence of Path
        Real recordings, each whatever `stereo_slam_env.load` takes. KITTI 00 is judged wherever gtsam is installed.
    karlsruhe : Path, optional
        Folder of the paper's own recordings.
    figure : str, optional
        One of `FIGURES`: run only what it needs.
    progress : callable, optional
        Called with (experiments done, experiments).

    Raises
    ------
    ValueError
        `out` holds something else or is in use by another process, jobs < 1, no such figure, or a recording that is
        not there.
    """
    out, tell = Path(out), progress or (lambda done, total: None)
    Backend(jobs=jobs)  # refuses an impossible number
    if figure is not None and figure not in FIGURES:
        raise ValueError(f"figure must be one of {', '.join(FIGURES)}, got {figure!r}")
    recordings = drives.real_drives(real, karlsruhe)
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    if out.is_dir() and is_occupied(out) and not holds_paper(out):
        raise ValueError(f"output {out} is not empty and holds no run of the paper: choose another directory")
    with claimed_folder(out):
        from stereo_slam_env.paper.report import Page  # draws, which only this needs

        about = {"version": VERSION, "settings": asdict(settings), "versions": versions()}
        if settings.remark:
            about["remark"] = settings.remark
        own_files(out, (RESULT, ROWS, "claims.md", "report.html"), is_run=True)
        write_json(out / SETTINGS, about)
        without = drives.refusal_to_render()
        page = Page(out, settings, tuple(recordings), without, figure)
        sections = _sections(settings, recordings, renders=not without)
        if figure is not None:
            sections = {FIGURES[figure]: sections[FIGURES[figure]]}
        results: dict[str, Arrays] = {}
        claims: tuple[Claim, ...] = ()
        total = sum(len(section.work) for section in sections.values())
        for section in sections.values():
            before = len(results)
            results |= run_experiments(
                section.work,
                out / EXPERIMENTS,
                Backend(jobs=1 if section.alone else jobs),
                partial(_told, tell, before, total),
            )
            claims = (*claims, *section.judge(results))
            page.write(_in_order(claims), results, (len(results), total))
        claims = _in_order(claims)
        write_json(out / RESULT, {**about, "claims": [_as_dict(claim) for claim in claims]})
        _write_rows(out / ROWS, claims)
        return PaperResult(out, claims, page.path, tuple(page.notes))


def _told(tell: Progress, before: int, total: int, done: float, of: int) -> None:
    tell(before + done, total)


@dataclass(frozen=True, eq=False)
class _Section:
    work: Mapping[str, partial[Arrays]]  # experiments by name
    judge: Callable[[Mapping[str, Arrays]], tuple[Claim, ...]]
    alone: bool = False  # it measures time and needs the machine for itself


def _sections(settings: PaperSettings, real: Mapping[str, drives.RealDrive], *, renders: bool) -> dict[str, _Section]:
    """Sections of the paper with the experiments that each needs."""
    turn_seeds, drive_seeds = dict.fromkeys(NOISES, settings.turn_seeds), dict.fromkeys(NOISES, settings.drive_seeds)
    if renders:
        turn_seeds |= {RENDERED: settings.rendered_turns}
        drive_seeds |= {RENDERED: settings.rendered_drives}
    return {
        "4.1": _Section({}, lambda results: landmark_uncertainty.judge(settings.samples)),
        "3": _Section(convergence.feature_experiments() if renders else {}, lambda results: ()),
        "4.3": _Section(convergence.experiments(turn_seeds, real), convergence.judge),
        "4.4": _Section(long_drive.experiments(drive_seeds, settings.drive_frames, real), long_drive.judge),
        "5": _Section(speed.experiments(settings.sizes, settings.repeats), speed.judge, alone=True),
    }


def _in_order(claims: Sequence[Claim]) -> tuple[Claim, ...]:
    """Claims in the order of the paper."""
    place = {key: number for number, key in enumerate(SENTENCES)}
    return tuple(sorted(claims, key=lambda claim: place[claim.sentence.key]))


def run_experiments(
    experiments: Mapping[str, partial[Arrays]], folder: Path, backend: Backend, progress: Progress
) -> dict[str, Arrays]:
    """Results by name of a file; what `folder` has of the same arguments and code is not computed again."""
    folder.mkdir(parents=True, exist_ok=True)
    code = versions()["code"]
    keys = {name: json.dumps([code, work.args, work.keywords]) for name, work in experiments.items()}
    samples_by_name = {name: _kept(folder / f"{name}.npz", key) for name, key in keys.items()}
    results = {name: arrays for name, arrays in samples_by_name.items() if arrays is not None}
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
    places = {place: claim.at(place).says for place in PLACES}
    findings = [_finding(finding) for finding in claim.findings]
    return {**sentence, "verdict": claim.verdict.value, "places": places, "findings": findings}


def holds_paper(out: Path) -> bool:
    """Whether a directory holds settings of this experiment, and not only a file of their name."""
    about = read_json(out / SETTINGS, inside=out) if (out / SETTINGS).exists() else None
    return isinstance(about, dict) and {"settings", "versions"} <= about.keys()


def _finding(finding: ClaimFinding) -> dict[str, Any]:
    ends = (*vars(finding.measured).values(), *vars(finding.asked).values())
    value, *limits = (number if math.isfinite(number) else None for number in ends)
    return {
        "place": finding.place,
        "condition": dict(finding.condition),
        "measured": value,
        "interval": limits[:2],
        "asked": limits[2:],
        "verdict": finding.verdict.value,
    }


def _write_rows(path: Path, claims: Sequence[Claim]) -> None:
    """One row a finding."""
    heads = ("key", "section", "claim", "statement", "place", "condition", "measured", "low", "high")
    file = io.StringIO(newline="")
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow((*heads, "asked", "verdict", "evidence"))
    for claim in claims:
        sentence = claim.sentence
        for finding in claim.findings:
            condition = ", ".join(f"{factor}: {level}" for factor, level in finding.condition.items())
            about = sentence.key, sentence.section, sentence.claim, sentence.statement, finding.place, condition
            verdict = finding.asked, finding.verdict.value, sentence.evidence
            rows.writerow((*about, *vars(finding.measured).values(), *verdict))
    write_text(path, file.getvalue())
