"""Compilation of kernels by Numba: three decorators, and the few places where its defaults do not do.

- *Kept on disk with the digest of all sources that a kernel reaches.* Numba asks only for the file of the function that
  is called, and keeps old code where another module has changed. The digest is part of the function's qualified name,
  from which Numba makes the name of the file. Numba chooses the folder: `NUMBA_CACHE_DIR`, `__pycache__`, or the cache
  of the user; code of older sources stays there until somebody deletes it (`make clean`).
- *The same bits in every process* (`KernelCompiler`). Numba leaves what it does not inline to the linker as weak
  symbols, which take the first copy that the process has. Copies are optimised with their callers, so that they differ
  in their last bits. A kernel here has copies of its own.
- *No machine code of what only kernels call* (`_Bitcode`): it is optimised where it is used. And a number in the
  source is an argument like another one: Numba compiles a function once for each literal integer. Both are two thirds
  of the time until the first filter runs, and both are left out where a version of Numba has other internals.

What is compiled shows as a count at a terminal, or as one line of the log.
"""

from __future__ import annotations

import hashlib
import logging
import os
import re
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache, partial
from importlib.metadata import version
from importlib.util import resolve_name
from pathlib import Path
from types import FunctionType
from typing import Any, TextIO

from llvmlite.binding import Linkage
from numba import config, njit, types
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

_log = logging.getLogger(__name__)


class _Notice(event.Listener):
    """Notice that something is compiled which was not on disk: a count at the terminal, or a line of the log."""

    def __init__(self) -> None:
        self._depth = self._functions = 0
        self._seconds = self._began = 0.0
        self._stream: TextIO | None = None
        self._logged = False

    def on_start(self, event: Any) -> None:
        """Before a function is compiled, unless it came from the disk."""
        if not _is_ours(event.data["dispatcher"].py_func.__module__):
            return
        if self._depth == 0:
            self._began, self._stream = time.monotonic(), sys.stderr if _shows_progress(sys.stderr) else None
            if self._stream is None and not self._logged:
                self._logged = True
                _log.warning(
                    "compiling machine code, once: half a minute for the first filter, as long for the first world "
                    "(`stereo-slam warm-up` does it beforehand)"
                )
        self._depth += 1
        self._write()

    def on_end(self, event: Any) -> None:
        """After it; the line goes with the last one."""
        if not _is_ours(event.data["dispatcher"].py_func.__module__):
            return
        self._depth -= 1
        self._functions += 1
        self._write()
        if self._depth == 0:
            self._seconds += time.monotonic() - self._began
            if self._stream is not None:
                self._stream.write("\r\x1b[K")
                self._stream.flush()

    def _write(self) -> None:
        if self._stream is not None:
            seconds = self._seconds + time.monotonic() - self._began
            self._stream.write(f"\rcompiling machine code, once: {self._functions} functions, {seconds:.0f} s")
            self._stream.flush()


def _shows_progress(stream: TextIO | None) -> bool:
    """Whether nobody has set up logging, and the terminal shows what this process writes.

    Processes in the background, as those of a benchmark, leave the terminal to the one that was called.
    """
    if stream is None or _log.hasHandlers() or not (_log.isEnabledFor(logging.WARNING) and stream.isatty()):
        return False
    try:
        return not hasattr(os, "tcgetpgrp") or os.tcgetpgrp(stream.fileno()) == os.getpgrp()
    except OSError:  # the terminal of another session
        return False


NEWER_THAN_TESTED = (0, 69)
"""First version of Numba that this code has not been tested with: the upper bound in pyproject.toml."""
if tuple(map(int, version("numba").split(".")[:2])) >= NEWER_THAN_TESTED:
    raise ImportError(
        f"numba {version('numba')} is newer than what the filters were tested with: install a version below "
        + ".".join(map(str, NEWER_THAN_TESTED))
    )

_PACKAGES = {"filters", "stereo_slam_env"}
_IMPORT = re.compile(rb"^(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n]*)|import\s+([^\n]*))", re.MULTILINE)
_NAME = re.compile(rb"[\w.]+")


def include(module: str) -> None:
    """Treat the package of a third party's module as one of ours: it has kernels."""
    _PACKAGES.add(module.partition(".")[0])


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in _PACKAGES


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


@cache
def sources_digest(module: str) -> str:
    """Digest of the sources of an imported module, and of all that it reaches by its imports of these packages.

    Once in a process: what is compiled later is what was imported, whatever has become of the files.
    """
    digests: dict[str, bytes] = {}
    waiting = {module}
    while waiting:
        name = waiting.pop()
        path = getattr(sys.modules.get(name), "__file__", None)
        if name in digests or path is None or not Path(path).is_file():  # no module, or one of no file
            continue
        digests[name], imported = _read(path, getattr(sys.modules[name], "__package__", None) or name)
        waiting |= imported
    return hashlib.sha256(b"".join(name.encode() + digests[name] for name in sorted(digests))).hexdigest()[:16]


def stamped(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function under a name with the digest of its sources, which is what Numba keeps its machine code by."""
    untyped: Any = function
    parts = (untyped.__code__, untyped.__globals__, untyped.__name__, untyped.__defaults__, untyped.__closure__)
    copy = FunctionType(*parts)
    copy.__module__, copy.__doc__ = function.__module__, function.__doc__
    copy.__qualname__ = f"{function.__qualname__}.{sources_digest(function.__module__)}"
    return copy


class _OwnCopies(JITCodeLibrary):
    """Library that calls its own copies of other functions, never those of other libraries of the process."""

    def _finalize_final_module(self) -> None:
        for function in self._final_module.functions:
            if function.linkage == Linkage.linkonce_odr:
                function.linkage = Linkage.internal
        super()._finalize_final_module()


class KernelCompiler(Compiler):
    """Numba's compiler, for code that has the same bits where it is compiled and where it is loaded."""

    def compile_extra(self, func: Any) -> Any:
        """Compile a function."""
        self.state.library = _OwnCopies(self.state.targetctx.codegen(), func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)


class _Bitcode(JITCodeLibrary):
    """Library that is linked into others, and neither optimised by itself nor handed to the code generator."""

    def _optimize_final_module(self) -> None:
        """Leave it to the kernel that calls this."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class _BitcodeCompiler(Compiler):
    """Numba's compiler without its last step, for functions that only kernels call."""

    def __init__(self, typing_context: Any, target_context: Any, library: Any, *arguments: Any) -> None:
        super().__init__(typing_context, target_context, library, *arguments)
        self.state.flags.no_compile = True
        if library is None:
            self.state.library = _Bitcode(self.state.targetctx.codegen(), "bitcode")
            self.state.library.enable_object_caching()

    def _compile_core(self) -> Any:
        result = super()._compile_core()
        handle: Any = [].append  # callers find the function by its entry point, of which each needs one of its own
        result.target_context.insert_user_function(handle, result.fndesc, [result.library])
        return result._replace(entry_point=handle)


_INTERNALS = (
    *((JITCodeLibrary, name) for name in ("_optimize_final_module", "_finalize_dynamic_globals")),
    (Compiler, "_compile_core"),
)
_SHORT = all(hasattr(owner, name) for owner, name in _INTERNALS)


def _has_cache() -> bool:
    """Whether machine code can be kept; where the package and the home cannot be written, in the temporary folder.

    That folder must be this user's alone: what is in it will be run.
    """
    try:
        FunctionCache(include)  # of any function of the package
    except RuntimeError:
        user = getattr(os, "getuid", lambda: -1)()
        folder, usable = None, False
        try:
            folder = Path(tempfile.gettempdir()) / f"stereo-slam-{user}"
            folder.mkdir(mode=0o700, exist_ok=True)
            status = folder.lstat()
            private = stat.S_ISDIR(status.st_mode) and status.st_uid == user and not status.st_mode & 0o077
            usable = private and os.access(folder, os.W_OK)
        except OSError:  # there is no temporary folder either
            pass
        if usable:
            config.CACHE_DIR = str(folder)
        where = f"kept in {folder}" if usable else "made anew by each process"
        _log.warning("machine code is %s: neither the package nor a home can be written (set NUMBA_CACHE_DIR)", where)
        return usable
    return True


KEPT: dict[str, Any] = {"cache": _has_cache(), "pipeline_class": KernelCompiler}
"""Options of Numba for a `stamped` function whose machine code is kept on disk."""
_INNER: dict[str, Any] = {
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    **({"pipeline_class": _BitcodeCompiler} if _SHORT else {}),
}
_IEEE: dict[str, Any] = {"error_model": "numpy", "nogil": True}


def entry(function: Any = None, **options: Any) -> Any:
    """Compile a function that Python calls, when it is first called, and keep its machine code on disk.

    Arithmetic is IEEE's, Python's lock is released; `options` are Numba's.
    """
    if function is None:
        return partial(entry, **options)
    return njit(**KEPT, **_IEEE, **options)(stamped(function))


def kernel(function: Any = None, **options: Any) -> Any:
    """Compile a function that only compiled ones call, when one of them is compiled; there is no way in from Python."""
    if function is None:
        return partial(kernel, **options)
    dispatcher = njit(**_INNER, **_IEEE, **options)(function)
    if not config.DISABLE_JIT and hasattr(dispatcher, "get_call_template"):
        dispatcher.get_call_template = partial(_without_literals, dispatcher.get_call_template)
    return dispatcher


def _without_literals(get_call_template: Any, arguments: Any, named: Any) -> Any:
    return get_call_template(tuple(map(types.unliteral, arguments)), {k: types.unliteral(x) for k, x in named.items()})


event.register("numba:compile", _Notice())
