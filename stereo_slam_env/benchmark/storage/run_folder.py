"""What tells the directory of a run from other folders, before one is written or read."""

from __future__ import annotations

from pathlib import Path

from stereo_slam_env.files.claimed_folder import is_occupied

STUDY = "study.json"
MARKERS = ("settings.json", STUDY)


def refuse_foreign(out: Path) -> None:
    """Raise a `ValueError` where `out` holds something that is no run."""
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    if out.is_dir() and not any((out / name).exists() for name in MARKERS) and is_occupied(out):
        raise ValueError(f"output {out} is not empty and holds no run: choose another directory")


def why_no_run(out: Path) -> str:
    """Why there is no run to read, and what could be meant."""
    if not out.is_dir():
        what = "is a file" if out.exists() else "does not exist"
        return f"{out} {what}: give the directory of a run"
    inside = sorted({path.parent for name in MARKERS for path in out.glob(f"*/{name}")})
    if inside:
        return f"{out} holds no run itself, but {len(inside)}: give one of them, such as {inside[-1]}"
    return f"{out} holds no run: it has no settings.json, give the directory of a run"
