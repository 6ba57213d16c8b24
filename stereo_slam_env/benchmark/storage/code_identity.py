"""Identity of the code that made a result: a digest of its meaning, not of its formatting."""

from __future__ import annotations

import ast
import hashlib
import json
import platform
import sys
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path

from stereo_slam_env.files.folders import write_atomically
from stereo_slam_env.files.package_versions import version_of

ROOT = Path(__file__).resolve().parents[3]
NO_RESULT = (
    "filters/engine/__main__.py",
    "filters/checks/",
    "stereo_slam_env/api.py",
    "stereo_slam_env/benchmark/campaign.py",
    "stereo_slam_env/benchmark/head_to_head.py",
    "stereo_slam_env/report/",
    "stereo_slam_env/benchmark/statistics/",
    "stereo_slam_env/cli",
    "stereo_slam_env/studies/",
    "stereo_slam_env/pytest_plugin.py",
    "stereo_slam_env/tasks/",
    "stereo_slam_env/training/",
    "stereo_slam_env/vector/",
    "stereo_slam_env/viewer/",
)
"""Beginnings of the paths of modules that neither make a recording nor run a filter; all others count."""
_PACKAGES = ("stereo-slam-env", "numpy", "scipy", "numba", "gymnasium", "pybullet", "joblib")
_UNSAID = {"ctx", "kind", "type_comment"}
"""Fields of a syntax tree that follow from the others, or only from how the code is written."""


@cache
def code_digest(without: tuple[str, ...] = NO_RESULT, root: Path = ROOT) -> str:
    """SHA-256 of both packages in the folder `root`, so that results of different code are never mixed.

    Comments, docstrings and formatting make no difference, nor does the version of Python, nor modules whose paths
    begin as one of `without`. Trained networks count.
    """
    files = [path for package in ("filters", "stereo_slam_env") for path in (root / package).rglob("*.*")]
    paths = {path.relative_to(root).as_posix(): path for path in files if path.suffix in (".py", ".npz")}
    kept = root / "filters" / "__pycache__" / f"code-{sys.implementation.cache_tag}.json"
    meanings = _meanings({name: path.read_bytes() for name, path in paths.items()}, kept)
    lines = sorted(f"{name} {digest}" for name, digest in meanings.items() if not name.startswith(without))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def versions() -> dict[str, str]:
    """Versions of Python, of this code and of the packages that results depend on."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "code": code_digest(),
        **{package: version_of(package) for package in _PACKAGES},
    }


def _meanings(sources: Mapping[str, bytes], kept: Path) -> dict[str, str]:
    """Digests of the meaning of files, by name; the cache file `kept` has them by source."""
    try:
        known: dict[str, str] = json.loads(kept.read_bytes())
    except (OSError, ValueError):
        known = {}
    rule = Path(__file__).read_bytes()
    keys = {name: hashlib.sha256(rule + source).hexdigest() for name, source in sources.items()}
    found = {key: known.get(key) or _meaning(name, sources[name]) for name, key in keys.items()}
    if found.keys() - known.keys() and not sys.dont_write_bytecode:
        with suppress(OSError):  # not ours to write: then it is computed every time
            write_atomically(kept, lambda stream: stream.write(json.dumps(found).encode()))
    return {name: found[key] for name, key in keys.items()}


def _meaning(name: str, content: bytes) -> str:
    """Digest of a module's syntax tree without docstrings, or of the bytes of another file."""
    if not name.endswith(".py"):
        return hashlib.sha256(content).hexdigest()
    said: list[str] = []

    def say(node: object) -> None:
        if isinstance(node, ast.AST):
            said.append(type(node).__name__)
            for name, value in ast.iter_fields(node):
                # What is empty is not said: newer versions of Python have fields that older ones have not.
                if name not in _UNSAID and value is not None and value != []:
                    said.append(f"{name}:")
                    say(value)
            said.append(".")
        elif isinstance(node, list):
            for item in node:
                if not (isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant)):
                    say(item)
        else:
            said.append(repr(node))

    say(ast.parse(content))
    return hashlib.sha256("\n".join(said).encode()).hexdigest()
