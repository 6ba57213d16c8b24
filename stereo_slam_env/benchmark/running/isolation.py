"""One piece of work in a process of its own: a crash or a hang in it is an answer, and ends nothing else."""

from __future__ import annotations

import atexit
import logging
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection, wait
from typing import NoReturn, TypeVar, cast

import cloudpickle

from stereo_slam_env.benchmark.running.clean_process import READY, STATUS, Work

Result = TypeVar("Result")
Tell = Callable[[int, int], None]

SECONDS_TO_START = 120.0
"""Limit of the server's start, and of a new process's: far more than a busy machine needs."""

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_log = logging.getLogger(__name__)


class WorkDied(RuntimeError):
    """The process ended without an answer: a crash, or the machine's memory ran out."""


class WorkTooSlow(RuntimeError):
    """Nothing was heard from the process for too long, and it was ended."""


def run_isolated(work: Callable[[Tell], Result], *, silence_limit: float, progress: Tell | None = None) -> Result:
    """Run `work` in a process of its own and return what it returns.

    The process is forked from a server that has imported what trials need and has no threads (`clean_process`), never
    from this process, which may have drawn, or have threads of BLAS, a notebook or a cluster: they do not survive a
    fork, and what waits for them would wait for ever. Where the system cannot fork, `work` runs in this process,
    without protection.

    Parameters
    ----------
    work : callable
        Called with a function (done, total) that it calls as it goes on: a sign of life. It is sent by cloudpickle, so
        functions and classes of a script or notebook will do; what it returns or raises must be picklable, too.
    silence_limit : float
        Longest time without a sign of life, s.
    progress : callable, optional
        Is told of the signs of life.

    Raises
    ------
    WorkTooSlow, WorkDied
        No sign of life in time; the process ended without an answer.
    ValueError
        `work` cannot be pickled.
    KeyboardInterrupt
        Somebody asked the process to end.
    Exception
        Whatever `work` raised.
    """
    if not hasattr(os, "fork"):
        return work(progress or (lambda done, total: None))
    try:
        content = cloudpickle.dumps(Work(tuple(sys.path), os.getcwd(), cloudpickle.dumps(work)))
    except Exception as error:  # whatever the objects in it raise
        raise ValueError(f"work must be picklable, to be done in a process of its own: {error}") from error
    with _clean_process() as process:
        with suppress(BrokenPipeError):  # it died at once: `_listen` says how
            process.connection.send_bytes(content)
        return cast(Result, _listen(process, silence_limit, progress))


@dataclass(frozen=True)
class _Process:
    """A process of the server, seen from here."""

    connection: Connection
    status: int
    id: int

    def exit_code(self) -> int:
        """How it ended, as the server tells: its code, or minus the number of the signal."""
        return _status(self.status, "how a process ended")


@contextmanager
def _clean_process() -> Iterator[_Process]:
    here, there = socket.socketpair()
    status, telling = os.pipe()
    with Connection(here.detach()) as connection, open(status, "rb"):
        with there, open(telling, "wb"):
            _server().request(there.fileno(), telling)
        process = _Process(connection, status, _status(status, "the id of a new process"))
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                if not wait([status], 0):  # the server has not told its end
                    os.kill(process.id, signal.SIGKILL)


def _status(pipe: int, what: str) -> int:
    if not wait([pipe], SECONDS_TO_START):
        raise WorkDied(f"{what} was not told for {SECONDS_TO_START:.0f} s")
    content = os.read(pipe, STATUS.size)
    if not content:
        raise WorkDied("the server of processes has ended")
    return int(STATUS.unpack(content)[0])


def _listen(process: _Process, limit: float, progress: Tell | None) -> object:
    while True:
        began = time.monotonic()
        if not process.connection.poll(limit):
            raise WorkTooSlow(f"no sign of life for {time.monotonic() - began:.0f} s")
        try:
            kind, content = pickle.loads(process.connection.recv_bytes())
        except (EOFError, ConnectionResetError):
            _raise_for_death(process.exit_code())
        if kind == "result":
            return content
        if kind == "error":
            raise content
        if progress is not None:
            progress(*content)


def _raise_for_death(code: int) -> NoReturn:
    if code >= 0:
        raise WorkDied(f"its process ended with code {code}")
    by = signal.Signals(-code)
    if by in _ENDING:
        raise KeyboardInterrupt
    raise WorkDied(f"its process was ended by {by.name}")


class _Server:
    """A `clean_process` of this process."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            # The path is passed on as it is, so that the server finds what this process finds.
            code = (
                f"import sys; sys.path[:] = {sys.path!r}; "
                f"from stereo_slam_env.benchmark.running.clean_process import serve; serve({theirs.fileno()})"
            )
            self._popen = subprocess.Popen(
                [sys.executable, "-c", code],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **_ONE_THREAD},
            )
        atexit.register(self.close)
        self._socket.settimeout(SECONDS_TO_START)
        if self._socket.recv(1) != READY:
            raise WorkDied(f"the server of processes ended with code {self._popen.wait(SECONDS_TO_START)}")

    @property
    def alive(self) -> bool:
        """Whether it can be asked for processes."""
        return self._popen.poll() is None

    def request(self, connection: int, status: int) -> None:
        """Ask for a process that is given these descriptors."""
        socket.send_fds(self._socket, [b"p"], [connection, status])

    def close(self) -> None:
        """End the server and all its processes."""
        self._socket.close()
        try:
            self._popen.wait(5.0)
        except subprocess.TimeoutExpired:
            self._popen.kill()


_starting = threading.Lock()


def _server() -> _Server:
    with _starting:
        server = _server_of(os.getpid())
        if not server.alive:
            _log.warning("the server of processes has ended and is started again")
            _server_of.cache_clear()
            server = _server_of(os.getpid())
        return server


@cache
def _server_of(process: int) -> _Server:
    return _Server()
