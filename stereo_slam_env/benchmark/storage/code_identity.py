"""Identity of the code that made a result: a digest of its meaning, not of its formatting.

Every file of both packages counts, and there is no list of those that "make no result": such a list is kept by hand,
and where it is wrong, a stale result passes for a new one. Nor does an import graph say what counts: environments,
policies and filters are named by strings. The price is paid by those who change the packages: of 252 commits that
touched them, 49 touched reports, viewers, commands and the like alone, and after those a run that is resumed starts
again. To write a report again (`stereo-slam report`) needs no such thing.

The code of filters and policies that are not ours is in `plugin_code`.
"""

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
PACKAGES = ("filters", "stereo_slam_env")
"""Those of this project."""
_DISTRIBUTIONS = ("stereo-slam-env", "numpy", "scipy", "numba", "gymnasium", "pybullet", "joblib")
_UNSAID = {"ctx", "kind", "type_comment"}
"""Fields of a syntax tree that follow from the others, or only from how the code is written."""


@cache
def code_digest(root: Path = ROOT) -> str:
    """SHA-256 of both packages in the folder `root`, so that results of different code are never mixed.

    Comments, docstrings and formatting make no difference, nor does the version of Python. Data such as trained
    networks count. It is asked for once a run, by the process that keeps the results.
    """
    paths = {path.relative_to(root).as_posix(): path for package in PACKAGES for path in source_files(root / package)}
    kept = root / "filters" / "__pycache__" / f"code-{sys.implementation.cache_tag}.json"
    return digest_of(_meanings({name: path.read_bytes() for name, path in paths.items()}, kept))


def versions() -> dict[str, str]:
    """Versions of Python, of this code and of the packages that results depend on."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "code": code_digest(),
        **{package: version_of(package) for package in _DISTRIBUTIONS},
    }


def source_files(folder: Path) -> list[Path]:
    """Every file below a folder but hidden ones and what Python and Numba keep there, in order."""
    found = (path for path in folder.rglob("*") if path.is_file())
    return sorted(path for path in found if not any(_is_kept(part) for part in path.relative_to(folder).parts))


def _is_kept(name: str) -> bool:
    return name == "__pycache__" or name.startswith(".")


def digest_of(meanings: Mapping[str, str]) -> str:
    """One digest of many, by name."""
    lines = sorted(f"{name} {digest}" for name, digest in meanings.items())
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def _meanings(sources: Mapping[str, bytes], kept: Path) -> dict[str, str]:
    """Digests of the meaning of files, by name; the cache file `kept` has them by source."""
    try:
        known: dict[str, str] = json.loads(kept.read_bytes())
    except (OSError, ValueError):
        known = {}
    rule = Path(__file__).read_bytes()
    keys = {name: hashlib.sha256(rule + source).hexdigest() for name, source in sources.items()}
    found = {key: known.get(key) or meaning(name, sources[name]) for name, key in keys.items()}
    if found.keys() - known.keys() and not sys.dont_write_bytecode:
        with suppress(OSError):  # not ours to write: then it is computed every time
            write_atomically(kept, lambda stream: stream.write(json.dumps(found).encode()))
    return {name: found[key] for name, key in keys.items()}


def meaning(name: str, content: bytes) -> str:
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
