"""Disk cache of machine code, stamped with the digest of every source that a kernel can reach.

Numba asks only for the file of the function that is called, and keeps old code where another module has changed. Here
the sources are those of the module and of all that it imports of its own top-level packages, directly or not. Numba
still chooses the folder: `NUMBA_CACHE_DIR`, `__pycache__` beside the module, or the cache of the user. Whoever replaces
Numba's own places (`NUMBA_CACHE_LOCATOR_CLASSES`) replaces these, too.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Callable
from functools import cache
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from numba.core import caching, event

from filters.kernels import progress
from filters.kernels.linking import BitcodeCompiler, KernelCompiler

_PACKAGES = {"filters", "stereo_slam_env"}
_IMPORT = re.compile(rb"^(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n]*)|import\s+([^\n]*))", re.MULTILINE)
_NAME = re.compile(rb"[\w.]+")


def include(module: str) -> None:
    """Treat the package of a third party's module as one of ours: it has kernels."""
    _PACKAGES.add(module.partition(".")[0])


@cache
def _read(path: str, package: str) -> tuple[bytes, frozenset[str]]:
    """Digest of a source file, and the names that its imports may mean: modules, and what is taken from them."""
    source = Path(path).read_bytes()
    names = set()
    for imported_from, taken, modules in _IMPORT.findall(source):
        base = imported_from.decode()
        if base.startswith("."):
            base = resolve_name(base, package)
        words = [word.decode() for word in _NAME.findall(taken or modules)]
        names |= {base, *(f"{base}.{word}" for word in words)} if base else set(words)
    return hashlib.sha256(source).digest(), frozenset(name for name in names if _is_ours(name))


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in _PACKAGES


@cache
def sources_digest(module: str) -> str:
    """Digest of the sources of an imported module, and of all that it reaches by its imports of these packages.

    Once in a process: what is compiled later is what was imported, whatever has become of the files.
    """
    found: dict[str, bytes] = {}
    waiting = {module}
    while waiting:
        name = waiting.pop()
        path = getattr(sys.modules.get(name), "__file__", None)
        if path is None or name in found:  # a function or a class that was imported, no module
            continue
        found[name], imported = _read(path, getattr(sys.modules[name], "__package__", None) or name)
        waiting |= imported
    return hashlib.sha256(b"".join(name.encode() + found[name] for name in sorted(found))).hexdigest()[:16]


class _OfAllSources:
    """Mixin for Numba's places of machine code: those of our functions, under names that hold the digest."""

    get_cache_path: Callable[[], str]
    _digest = ""
    _stem = ""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        """The place for a function of ours, if it can be written to; else None."""
        module: str = py_func.__module__
        place = super().from_function(py_func, py_file) if _is_ours(module) else None  # type: ignore[misc]
        if place is not None:
            place._digest = sources_digest(module)
            place._stem = f"{Path(py_file).stem}.{re.sub('[<>]', '', py_func.__qualname__)}-"
        return place

    def get_source_stamp(self) -> str:
        """The digest."""
        return self._digest

    def get_disambiguator(self) -> str:
        """The digest: while a process writes code of new sources, another one cannot read old code by its name."""
        return self._digest

    def ensure_cache_path(self) -> None:
        """Make the folder; before code is kept, remove that of other sources."""
        super().ensure_cache_path()  # type: ignore[misc]
        if not self._digest:  # the place is only being looked for
            return
        version = f".py{sys.version_info[0]}{sys.version_info[1]}"
        for kept in Path(self.get_cache_path()).glob(f"{self._stem}*{version}*.nb[ic]"):
            if not kept.name.startswith(self._stem + self._digest):
                kept.unlink(missing_ok=True)


class _Chosen(_OfAllSources, caching.UserProvidedCacheLocator):
    """In `NUMBA_CACHE_DIR`."""


class _BesideModule(_OfAllSources, caching.InTreeCacheLocator):
    """In `__pycache__`."""


class _OfUser(_OfAllSources, caching.UserWideCacheLocator):
    """In the cache of the user."""


class _Notice(event.Listener):
    """Listener for kernels that are compiled because they were not on disk."""

    def on_start(self, event: Any) -> None:
        """Before a function is compiled, unless it came from the disk."""
        if _is_ours(event.data["dispatcher"].py_func.__module__):
            progress.begin()

    def on_end(self, event: Any) -> None:
        """After it."""


event.register("numba:compile", _Notice())
caching.CacheImpl._locator_classes[:0] = [_Chosen, _BesideModule, _OfUser]
KEPT: dict[str, Any] = {"cache": True, "pipeline_class": KernelCompiler}
"""Options of Numba for functions whose machine code is kept on disk: the same bits in the process that compiles."""
LINKED: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": BitcodeCompiler}
"""Options for functions that only compiled ones call: no way in from Python."""
