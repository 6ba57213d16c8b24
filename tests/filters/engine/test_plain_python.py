"""`NUMBA_DISABLE_JIT=1` runs the kernels as plain Python, with the same beliefs."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from .combinations import combinations, figures, run_case

ROOT = Path(__file__).resolve().parents[3]
NAMES = ("shared-anchor/everything/right-invariant", "spherical/joint/so3", "clones/hybrid/first-estimates")
CODE = """
import numpy as np
from filters.kernels.blas import PLAIN
from tests.filters.engine.combinations import combinations, figures, run_case
assert PLAIN
for case in combinations():
    if case.name in {names!r}:
        print(case.name, *figures(*run_case(case), case.clones).tolist())
"""


def test_plain_python_believes_what_machine_code_does() -> None:
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", CODE.format(names=NAMES)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    lines = dict(map(_told, done.stdout.splitlines()))
    assert set(lines) == set(NAMES)
    for case in combinations():
        if case.name in lines:
            expected = figures(*run_case(case), case.clones).tolist()
            assert max(abs(a - b) for a, b in zip(lines[case.name], expected, strict=True)) < 1e-9


def _told(line: str) -> tuple[str, list[float]]:
    name, *numbers = line.split(" ")
    return name, [float(number) for number in numbers]
