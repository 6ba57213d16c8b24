"""Everything in one go: measure, judge, write."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stereo_slam_env.benchmark.storage.store import versions, without_nan, write_json
from stereo_slam_env.files.atomic import write_atomically
from stereo_slam_env.files.claimed_folder import claimed_folder, is_occupied
from stereo_slam_env.studies.paper import convergence, karlsruhe, landmark_uncertainty, long_drive, speed
from stereo_slam_env.studies.paper.claims import Claim, Finding
from stereo_slam_env.studies.paper.parts import Progress, run_parts
from stereo_slam_env.studies.paper.settings import FULL, PaperSettings

VERSION = 1
SETTINGS, RESULT, ROWS = "paper_settings.json", "paper.json", "claims.csv"
PARTS = Path("trials") / "parts"


@dataclass(frozen=True, eq=False)
class PaperResult:
    """What was found and where it is."""

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

    Finished parts are kept in `out`: the same call goes on where an interrupted one stopped.

    Parameters
    ----------
    out : str or Path
        Directory for `paper.json` (claims with their numbers, settings, versions), `claims.csv`, `figures` (PNG and
        SVG), `report.html`, and the parts of the work.
    settings : PaperSettings
        How much is measured.
    jobs : int
        Processes, one BLAS thread each. Time is measured in one process after everything else.
    karlsruhe_path : Path, optional
        Folder of the Karlsruhe sequences.
    progress : callable, optional
        Called with (parts done, parts).

    Raises
    ------
    ValueError
        `out` holds something else or is in use by another process, jobs < 1, or there are no such sequences.
    """
    out = Path(out)
    if jobs < 1:
        raise ValueError(f"jobs must be >= 1, got {jobs!r}")
    sequences = {} if karlsruhe_path is None else karlsruhe.sequences(karlsruhe_path)
    _refuse_foreign(out)
    with claimed_folder(out):
        about = {"version": VERSION, "settings": asdict(settings), "versions": versions()}
        write_json(out / SETTINGS, about)
        parts = [
            *convergence.parts(settings),
            *long_drive.parts(settings),
            *karlsruhe.parts(sequences),
            *speed.parts(settings),
        ]
        results = run_parts(parts, out / PARTS, jobs=jobs, progress=progress)
        claims = (
            *landmark_uncertainty.claims(settings.samples),
            *convergence.claims(results),
            *long_drive.claims(results),
            *speed.claims(results),
            *karlsruhe.claims(results),
        )
        write_json(out / RESULT, {**about, "claims": without_nan([_as_dict(claim) for claim in claims])})
        _write_rows(out / ROWS, claims)
        from stereo_slam_env.studies.paper.report import write_report  # Matplotlib, only where it is needed

        return PaperResult(out, claims, write_report(out, claims, results, settings, bool(sequences)))


def _refuse_foreign(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    if out.is_dir() and is_occupied(out) and not (out / SETTINGS).exists():
        raise ValueError(f"output {out} is not empty and holds no run of the paper: choose another directory")


def _as_dict(claim: Claim) -> dict[str, Any]:
    return {
        **asdict(claim.sentence),
        "verdict": claim.verdict.value,
        "says": claim.says,
        "findings": [_finding(finding) for finding in claim.findings],
    }


def _finding(finding: Finding) -> dict[str, Any]:
    measured, asked = finding.measured, finding.asked
    return {
        "condition": dict(finding.condition),
        "measured": measured.value,
        "interval": [measured.low, measured.high],
        "asked": [asked.low, asked.high],
        "verdict": finding.verdict.value,
    }


def _write_rows(path: Path, claims: Sequence[Claim]) -> None:
    """One row a finding."""
    text = io.StringIO()
    heads = ("key", "section", "claim", "statement", "condition", "measured", "low", "high", "asked", "verdict", "says")
    rows = csv.DictWriter(text, (*heads, "evidence"), lineterminator="\n")
    rows.writeheader()
    for claim in claims:
        sentence: Mapping[str, str] = asdict(claim.sentence)
        for finding in claim.findings:
            measured = finding.measured
            rows.writerow(
                {
                    **sentence,
                    "condition": ", ".join(f"{factor}: {level}" for factor, level in finding.condition.items()),
                    "measured": measured.value,
                    "low": measured.low,
                    "high": measured.high,
                    "asked": str(finding.asked),
                    "verdict": finding.verdict.value,
                    "says": claim.says,
                }
            )
    write_atomically(path, lambda stream: stream.write(text.getvalue().encode()))
