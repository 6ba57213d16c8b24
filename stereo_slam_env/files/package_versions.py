"""Versions of the installed packages that a result depends on."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_DISTRIBUTIONS = {"pybullet": ("pybullet", "pybullet-arm64")}
"""Those of which one brings the package, where it is not the one of the same name alone."""
_SHOWN = (
    *("numpy", "scipy", "numba", "llvmlite", "gymnasium", "pybullet", "opencv-python-headless", "filterpy", "msgspec"),
    *("joblib", "vl-convert-python", "gtsam", "moderngl", "rerun-sdk", "stable-baselines3", "torch", "matplotlib"),
)
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "NUMBA_DISABLE_JIT", "NUMBA_CACHE_DIR")


def version_of(package: str) -> str:
    """Version of a package, or "not installed"."""
    for distribution in _DISTRIBUTIONS.get(package, (package,)):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return "not installed"


__version__ = version_of("stereo-slam-env")


def commit() -> str | None:
    """Commit of the checkout that this package runs from, with "+" where it was edited; None where it is installed."""
    folder, words = Path(__file__).parent, []
    for command in (
        ("ls-files", "--error-unmatch", Path(__file__).name),
        ("describe", "--always", "--dirty=+", "--abbrev=40"),
    ):
        try:
            done = subprocess.run(["git", "-C", str(folder), *command], capture_output=True, text=True, timeout=10)
        except (OSError, subprocess.TimeoutExpired):
            return None
        if done.returncode:
            return None
        words.append(done.stdout.strip())
    return words[-1]


def show_versions() -> None:
    """Print what a report of a bug should hold: versions, machine, and settings that change how fast it computes."""
    lines = {
        "stereo-slam-env": __version__,
        "python": f"{platform.python_version()} ({sys.executable})",
        "platform": f"{platform.platform()}, {os.cpu_count()} processors",
        **{package: version_of(package) for package in _SHOWN},
        **{name: os.environ[name] for name in _THREADS if name in os.environ},
    }
    width = max(map(len, lines))
    sys.stdout.write("".join(f"{name:<{width}}  {text}\n" for name, text in lines.items()))
