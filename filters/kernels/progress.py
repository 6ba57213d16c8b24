"""Progress of a compilation, for whoever waits for it.

A log record says that it begins. At a terminal a bar says it instead, unless somebody has set up logging. Neither shows
where the level of the logger `filters` is above WARNING.
"""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import TextIO

_log = logging.getLogger(__name__)
_WIDTH = 28


def begin() -> None:
    """Say that something is compiled that was not on disk: as a bar, or once in a process."""
    bar = _bar.get()
    if bar is None:
        _say_that_it_takes_time()
    else:
        bar.show()


@contextmanager
def counted(parts: int) -> Iterator[Callable[[], None]]:
    """Count what is compiled here: call what this yields after each of the parts, those from the disk included."""
    stream = sys.stderr
    if not _wanted(stream):
        yield lambda: None
        return
    bar = _Bar(stream, parts)
    token = _bar.set(bar)
    try:
        yield bar.advance
    finally:
        _bar.reset(token)
        bar.close()


@cache
def _say_that_it_takes_time() -> None:
    _log.warning("compiling machine code that is not on disk yet: up to half a minute, once after a change of the code")


def _wanted(stream: TextIO | None) -> bool:
    """Whether nobody has set up logging, and the terminal shows what this process writes.

    Processes in the background, as those of a benchmark, leave the terminal to the one that was called.
    """
    if stream is None or _log.hasHandlers() or not (_log.isEnabledFor(logging.WARNING) and stream.isatty()):
        return False
    try:
        return not hasattr(os, "tcgetpgrp") or os.tcgetpgrp(stream.fileno()) == os.getpgrp()
    except OSError:  # the terminal of another session
        return False


class _Bar:
    """One line that is written again and again; nothing before something is compiled."""

    def __init__(self, stream: TextIO, parts: int) -> None:
        self._stream, self._parts, self._done = stream, parts, 0
        self._began: float | None = None

    def show(self) -> None:
        if self._began is None:
            self._began = time.monotonic()
            self._write()

    def advance(self) -> None:
        self._done += 1
        if self._began is not None:
            self._write()

    def close(self) -> None:
        if self._began is not None:
            self._write(f", {time.monotonic() - self._began:.0f} s\n")

    def _write(self, end: str = "") -> None:
        full = _WIDTH * self._done // self._parts
        bar = "#" * full + "." * (_WIDTH - full)
        self._stream.write(f"\rcompiling the filter, this once: [{bar}] {self._done} of {self._parts} parts{end}")
        self._stream.flush()


_bar: ContextVar[_Bar | None] = ContextVar("_bar", default=None)
