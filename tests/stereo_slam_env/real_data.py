"""Where the real recordings are that some tests use; they are no part of the repository."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def real_data(name: str) -> Path:
    """Folder of that name, or skip the test."""
    folder = Path(os.environ.get("STEREO_SLAM_DATA", ROOT.parent / "shared" / "data")) / name
    if not folder.is_dir():
        pytest.skip(f"real data {folder} is not there: set STEREO_SLAM_DATA to the folder that holds {name}")
    return folder
