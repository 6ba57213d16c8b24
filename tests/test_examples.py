"""Every example runs from a fresh process and says something (50 s)."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SMALL = {
    "active_gaze.py": ["--seeds", "1", "--route", "right-turn"],
    "cleanrl_ppo.py": ["--steps", "60", "--rollout", "30", "--environments", "2", "--route", "right-turn"],
    "train_ppo.py": ["--decisions", "32", "--route", "right-turn"],
}
"""Arguments with which those that take long are quick."""
NEEDS = {"cleanrl_ppo.py": "torch", "train_ppo.py": "stable_baselines3"}
MOST_LINES = {"active_gaze.py": 60, "cleanrl_ppo.py": 149, "train_ppo.py": 40}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_the_example_runs(path, tmp_path):
    if path.name in NEEDS:
        pytest.importorskip(NEEDS[path.name], reason="needs the extra rl")
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
