"""Files that a viewer is asked to write, looked at before any work is done."""

from __future__ import annotations

from pathlib import Path


def checked_file(what: str, path: str | Path, ending: str) -> Path:
    """The path, if a file of that ending can have it; else a `ValueError` that says `what` cannot be written."""
    path = Path(path)
    if path.suffix.lower() != ending:
        raise ValueError(f"{what} {path} must end in {ending}")
    if path.is_dir() or not path.parent.is_dir():
        raise ValueError(f"{what} {path} cannot be written: {path.parent} must be a folder, and {path.name} none")
    return path
