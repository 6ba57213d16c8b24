"""What a newcomer does: commands, and environments that hold nothing of this checkout but what is installed in them."""

from __future__ import annotations

import os
import subprocess
import sys
import venv
from collections.abc import Iterable
from pathlib import Path


def run(*command: object, cwd: Path) -> str:
    """Run a command that must succeed, with nothing on Python's path but what is installed; what it printed."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(list(map(str, command)), cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def make_environment(home: Path, lent: Iterable[object]) -> None:
    """An environment without packages, to which those of some folders are lent."""
    venv.create(home, with_pip=False)
    (site,) = home.glob("lib/python*/site-packages")
    # Paths named in a .pth file are searched last, and their own .pth files (an editable install) are not read.
    (site / "lent.pth").write_text("".join(f"{folder}\n" for folder in lent), encoding="utf-8")


def install(home: Path, source: Path, *options: str) -> None:
    """Install one package into such an environment, without its dependencies."""
    pip = (sys.executable, "-m", "pip", "--python", home / "bin" / "python", "install", "--quiet", "--no-deps")
    run(*pip, *options, source, cwd=home)
