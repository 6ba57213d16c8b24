"""Every example runs from a fresh process and says something (80 s)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SMALL = {
    "active_gaze.py": ["--seeds", "1", "--route", "right-turn"],
    "cleanrl_ppo.py": ["--steps", "60", "--rollout", "30", "--environments", "2", "--route", "right-turn"],
    "compare_filters.py": ["--seeds", "2", "--frames", "8"],
    "replay_kitti.py": ["--frames", "8"],
    "train_pixels.py": ["--steps", "16", "--renderer", "tiny"],
    "train_ppo.py": ["--decisions", "32", "--drives", "2", "--route", "right-turn"],
    "watch_live.py": ["--frames", "8", "--save", "drive.rrd"],
}
"""Arguments with which those that take long are quick."""
NEEDS = {
    "cleanrl_ppo.py": ("torch", "rl"),
    "train_pixels.py": ("stable_baselines3", "rl"),
    "train_ppo.py": ("stable_baselines3", "rl"),
    "watch_live.py": ("rerun", "viewer"),
}
"""The package without which it does not run, and the extra that brings it."""
MOST_LINES = {"active_gaze.py": 60, "cleanrl_ppo.py": 149, "train_pixels.py": 44, "train_ppo.py": 46}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_the_example_runs(path, tmp_path):
    if path.name in NEEDS:
        package, extra = NEEDS[path.name]
        pytest.importorskip(package, reason=f"needs the extra {extra}")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, str(path), *SMALL.get(path.name, [])]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("name", "most"), MOST_LINES.items())
def test_the_example_is_short(name, most):
    assert len((ROOT / "examples" / name).read_text(encoding="utf-8").splitlines()) <= most


def test_there_are_examples():
    assert len(EXAMPLES) >= 3
