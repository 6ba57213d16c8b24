"""One piece of work in a process of its own: a crash or a hang in it is an answer, and ends nothing else."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import time
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import NoReturn, TypeVar, cast

Result = TypeVar("Result")
Tell = Callable[[int, int], None]

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_log = logging.getLogger(__name__)


class WorkDied(RuntimeError):
    """The process ended without an answer: a crash, or the machine's memory ran out."""


class WorkTooSlow(RuntimeError):
    """Nothing was heard from the process for too long, and it was ended."""


def run_isolated(
    work: Callable[[Tell], Result], *, silence_limit: float | None = None, progress: Tell | None = None
) -> Result:
    """Run `work` in a forked process and return what it returns.

    The process starts with everything this one has, so nothing is copied or imported again. Where the system cannot
    fork, `work` runs in this process, without protection.

    Parameters
    ----------
    work : callable
        Called with a function (done, total) that it calls as it goes on: a sign of life. What it returns or raises
        must be picklable.
    silence_limit : float, optional
        Longest time without a sign of life, s; None: no limit.
    progress : callable, optional
        Is told of the signs of life.

    Raises
    ------
    WorkTooSlow, WorkDied
        No sign of life in time; the process ended without an answer.
    KeyboardInterrupt
        Somebody asked the process to end.
    Exception
        Whatever `work` raised.
    """
    if not hasattr(os, "fork"):
        return work(progress or (lambda done, total: None))
    here, there = Pipe()
    # What a signal raises while Python's own hooks run after the fork would be lost: it has to wait.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    child = os.fork()
    if child == 0:
        here.close()
        for ending in _ENDING:
            signal.signal(ending, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        _answer(there, work)
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        there.close()
        return cast(Result, _listen(here, child, silence_limit, progress))
    finally:
        here.close()
        _end(child)


def _answer(connection: Connection, work: Callable[[Tell], Result]) -> None:
    """In the new process: do the work, send the answer, and leave without any of the caller's clean-up."""
    code = 1
    try:
        try:
            answer: tuple[str, object] = ("result", work(lambda done, total: connection.send(("alive", (done, total)))))
        except Exception as error:
            answer = ("error", error)
        try:
            connection.send(answer)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            connection.send(("error", RuntimeError(f"the answer cannot be sent: {error}")))
        code = 0
    finally:
        os._exit(code)


def _listen(connection: Connection, child: int, limit: float | None, progress: Tell | None) -> object:
    while True:
        began = time.monotonic()
        if not connection.poll(limit):
            os.kill(child, signal.SIGKILL)
            raise WorkTooSlow(f"no sign of life for {time.monotonic() - began:.0f} s")
        try:
            kind, content = connection.recv()
        except (EOFError, ConnectionResetError):
            _raise_for_death(child)
        if kind == "result":
            return content
        if kind == "error":
            raise content
        if progress is not None:
            progress(*content)


def _raise_for_death(child: int) -> NoReturn:
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        raise WorkDied(f"its process ended with code {os.WEXITSTATUS(status)}")
    by = signal.Signals(os.WTERMSIG(status))
    if by in _ENDING:
        raise KeyboardInterrupt
    raise WorkDied(f"its process was ended by {by.name}")


def _end(child: int) -> None:
    """Leave nothing behind."""
    try:
        ended, _ = os.waitpid(child, os.WNOHANG)
        if ended == 0:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    except ChildProcessError:  # already gone
        _log.debug("process %d had ended", child)
