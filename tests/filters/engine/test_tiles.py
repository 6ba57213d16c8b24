"""Products by vector instructions keep to the padding of their arrays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from filters.kernels.blas import PLAIN

ROOT = Path(__file__).resolve().parents[3]
pytestmark = [
    pytest.mark.skipif(PLAIN, reason="plain Python has no vectors"),
    pytest.mark.skipif(sys.platform != "linux", reason="the guard is Linux's"),
]


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "tests.filters.engine.guarded_tiles", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)


def test_no_product_reads_or_writes_behind_whole_vectors() -> None:
    """And all are NumPy's, of 1 to 40 columns and around 64, of 1 to 36 rows."""
    ended = run()
    assert ended.returncode == 0, ended.stderr[-2000:]
    assert "no number beyond the padding" in ended.stdout


def test_the_guard_would_see_it() -> None:
    assert run("short").returncode < 0
