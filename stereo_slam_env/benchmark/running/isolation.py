"""Work in a process of its own: a crash or a hang is reported and ends nothing else.

Such a process is forked from a server of clean processes (`process_server`). It is never forked from the caller, which
may have drawn, or have threads of BLAS, a notebook or a cluster: they do not survive a fork, and what waits for them
would wait for ever.

What is wrong with the machinery is never taken for the work's fault. Where the server has ended, or somebody has ended
the process from outside (the system, when memory runs out), the work is done once more, while nothing else runs; what
happens then is its own doing.

Why not the forkserver of `multiprocessing` (seen with Python 3.11): each of its processes imports the caller's main
module again, a script without a guard included; `start()` waits without a limit where the server is stopped; and it
refuses to work in the daemonic workers of Dask. By its source, children also hold the server's pipe, so that one that
hangs outlives a caller that was killed, it is one for the whole interpreter, preloaded by whoever came first, and until
Python 3.13 it has not the caller's `sys.path`.
"""

from __future__ import annotations

import atexit
import logging
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection, wait
from typing import NoReturn, TypeVar, cast

import cloudpickle

from filters.contract.validation import error_line, first_line
from stereo_slam_env.benchmark.running.process_server import LOADING, READY, STATUS, end_process

Result = TypeVar("Result")
Tell = Callable[[int, int], None]

SECONDS_TO_START = 300.0
"""Limit of the server's start, and of a new process's: 120 s were too few on two cores with twelve other processes."""

_LOOK_AFTER = 1.0
"""After so long without a sign, s, the server is told to go on, lest somebody has stopped it."""
_FROM_OUTSIDE = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP) if hasattr(os, "fork") else ()
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_log = logging.getLogger(__name__)


class WorkDied(ChildProcessError):
    """The process ended without an answer: a crash, or the machine's memory ran out."""


class WorkTooSlow(TimeoutError):
    """The process gave no sign of life for too long, and was ended."""


class WorkFailed(Exception):
    """The work raised; the message says what, in one line."""


class NoProcess(ChildProcessError):
    """No process can be had: the server does not start."""


class _Lost(Exception):
    """The machinery failed, which says nothing of the work."""


def attempted(work: Callable[[Tell], Result], tell: Tell) -> Result:
    """Do the work there; whatever it raises becomes `WorkFailed`, as no exception of a stranger's may be sent back."""
    try:
        return work(tell)
    except (BrokenPipeError, EOFError):  # nobody listens any more
        raise
    except BaseException as error:
        raise WorkFailed(error_line(error)) from None


def run_isolated(work: Callable[[Tell], Result], *, silence_limit: float, progress: Tell | None = None) -> Result:
    """Run `work` in a process of its own and return what it returns.

    `work` is called with a function (done, total) that it calls as it goes on: a sign of life, which `progress` is told
    of and which must come within `silence_limit`, s. So is a function that Numba has compiled or loaded: that takes
    long on a busy machine. `work` is sent by cloudpickle, so functions and classes of a script or notebook will do;
    what it returns or raises must be picklable, too. What it logs is logged here, and the same words
    only once: hundreds of trials have the same to say. What it has started ends with it. Where the system cannot fork,
    it runs in this process, without protection.

    Raises
    ------
    WorkTooSlow, WorkDied
        No sign of life in time; the process ended without an answer.
    NoProcess
        The server of processes does not start.
    ValueError
        `work` cannot be pickled.
    CancelledError
        The block of `waiting_threads` was left.
    Exception
        Whatever `work` raised.
    """
    if not hasattr(os, "fork"):
        return work(progress or (lambda done, total: None))
    try:
        content = pickle.dumps((sys.path, os.getcwd(), cloudpickle.dumps(work)))
    except Exception as error:  # whatever the objects in it raise
        message = f"work must be picklable, to be done in a process of its own: {first_line(error)}"
        raise ValueError(message) from error
    try:
        with _turns.with_others():
            return cast(Result, _done(content, silence_limit, progress))
    except (_Lost, NoProcess) as lost:
        _log.warning("%s: it is done once more, alone", lost)
    try:
        with _turns.alone():
            return cast(Result, _done(content, silence_limit, progress))
    except _Lost as lost:
        raise WorkDied(f"{lost}, twice") from lost


def start_server(*preloaded: str) -> None:
    """Start the server of processes, which takes seconds, unless it is there; raises `NoProcess`.

    `preloaded` are modules that its processes will have imported: those of a long run save more than the server needs.
    """
    if hasattr(os, "fork"):
        _server(*preloaded)


@contextmanager
def waiting_threads(count: int) -> Iterator[Callable[[Callable[[], Result]], Future[Result]]]:
    """Yield a function that calls what it is given in one of `count` threads; isolated work ends with the block."""
    leaving, leave = os.pipe()

    def call(function: Callable[[], Result]) -> Result:
        _of_thread.left = leaving
        return function()

    with open(leaving, "rb"), ThreadPoolExecutor(count) as pool:
        try:
            yield lambda function: pool.submit(call, function)
        finally:
            os.close(leave)


_of_thread = threading.local()


@dataclass
class _Process:
    """A process at work."""

    server: _Server
    connection: Connection
    status: int  # the pipe on which the server tells its id and its end
    id: int = 0
    ended: bool = False

    def heard(self, limit: float, *sources: object) -> list[object]:
        """Sources that can be read within `limit`, s."""
        leaving = getattr(_of_thread, "left", None)
        until = time.monotonic() + limit
        while (rest := until - time.monotonic()) > 0:
            ready = wait([*sources, *([] if leaving is None else [leaving])], min(_LOOK_AFTER, rest))  # type: ignore[list-item]
            if leaving in ready:
                raise CancelledError
            if ready:
                return cast("list[object]", ready)
            with suppress(ProcessLookupError):
                self.server.process.send_signal(signal.SIGCONT)
        return []

    def told(self) -> int:
        """The next number from the server."""
        if not self.heard(SECONDS_TO_START, self.status):
            raise self.server.lost(f"the server of processes did not answer for {SECONDS_TO_START:.0f} s")
        content = os.read(self.status, STATUS.size)
        if not content:
            raise self.server.lost("the server of processes has ended")
        return int(STATUS.unpack(content)[0])

    def has_ended(self) -> bool:
        """Whether the server has told its end."""
        return self.ended or bool(wait([self.status], 0) and os.read(self.status, STATUS.size))


def _done(content: bytes, limit: float, progress: Tell | None) -> object:
    with _clean_process(limit) as process:
        with suppress(BrokenPipeError):  # it died at once: `_listen` says how
            process.connection.send_bytes(content)
        return _listen(process, limit, progress)


@contextmanager
def _clean_process(limit: float) -> Iterator[_Process]:
    here, there = socket.socketpair()
    _limit_waiting(here, limit)
    status, telling = os.pipe()
    with Connection(here.detach()) as connection, open(status, "rb"):
        with there, open(telling, "wb"):
            server = _server()
            try:
                server.request(there.fileno(), telling)
            except OSError as error:
                raise server.lost("the server of processes has ended") from error
        process = _Process(server, connection, status)
        process.id = process.told()
        try:
            yield process
        finally:
            if not process.has_ended():
                end_process(process.id)


def _limit_waiting(connection: socket.socket, limit: float) -> None:
    """Let no read of half a message, nor a write that nobody reads, wait longer."""
    interval = struct.pack("ll", int(limit), int(limit % 1.0 * 1e6))
    for of in (socket.SO_RCVTIMEO, socket.SO_SNDTIMEO):
        connection.setsockopt(socket.SOL_SOCKET, of, interval)


def _listen(process: _Process, limit: float, progress: Tell | None) -> object:
    began = time.monotonic()
    while True:
        # Its end is told apart from the connection, which a child of the process may hold.
        ready = process.heard(began + limit - time.monotonic(), process.connection, process.status)
        if not ready:
            raise WorkTooSlow(f"no sign of life for {time.monotonic() - began:.0f} s")
        if process.connection not in ready:
            _raise_for_death(process)
        try:
            kind, content = pickle.loads(process.connection.recv_bytes())
        except (EOFError, ConnectionResetError):
            _raise_for_death(process)
        except BlockingIOError as error:
            raise WorkTooSlow(f"half a sign of life for {time.monotonic() - began:.0f} s") from error
        if kind == "result":
            return content
        if kind == "error":
            raise content
        if kind == "logged":  # no sign of life: an endless loop may log
            _log_once(*content)
            continue
        if kind == "alive" and progress is not None:
            progress(*content)
        began = time.monotonic()


@cache
def _log_once(name: str, level: int, words: str) -> None:
    logging.getLogger(name).log(level, "%s", words)


def _raise_for_death(process: _Process) -> NoReturn:
    """Raise for its exit code, or minus the number of the signal."""
    code = process.told()
    process.ended = True
    if code >= 0:
        raise WorkDied(f"its process ended with code {code}")
    try:
        by = signal.Signals(-code).name
    except ValueError:  # one without a name
        by = f"signal {-code}"
    if -code in _FROM_OUTSIDE:
        memory = " (has memory run out?)" if -code == signal.SIGKILL else ""
        raise _Lost(f"its process was ended by {by}{memory}")
    raise WorkDied(f"its process was ended by {by}")


class _Turns:
    """Work goes on at the same time, but for some that goes on alone."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._running, self._is_alone = 0, False

    @contextmanager
    def with_others(self) -> Iterator[None]:
        with self._changed:
            self._changed.wait_for(lambda: not self._is_alone)
            self._running += 1
        try:
            yield
        finally:
            with self._changed:
                self._running -= 1
                self._changed.notify_all()

    @contextmanager
    def alone(self) -> Iterator[None]:
        with self._changed:
            self._changed.wait_for(lambda: not self._is_alone)
            self._is_alone = True
        try:
            with self._changed:
                self._changed.wait_for(lambda: self._running == 0)
            yield
        finally:
            with self._changed:
                self._is_alone = False
                self._changed.notify_all()


_turns = _Turns()


class _Server:
    """Server of this process."""

    def __init__(self, *preloaded: str) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            # The path is passed on as it is, so that the server finds what this process finds.
            code = (
                f"import sys; sys.path[:] = {sys.path!r}; "
                f"from stereo_slam_env.benchmark.running.process_server import serve; "
                f"serve({', '.join(map(repr, (theirs.fileno(), *preloaded)))})"
            )
            self.process = subprocess.Popen(
                [sys.executable, "-c", code],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **_ONE_THREAD},
                start_new_session=True,
            )
        atexit.register(self.close)
        self._socket.settimeout(SECONDS_TO_START)
        try:
            while (answer := self._socket.recv(1)) == LOADING:
                continue
        except OSError as error:
            self.process.kill()
            message = f"the server of processes did not start within {SECONDS_TO_START:.0f} s"
            raise NoProcess(message) from error
        if answer != READY:
            ended = self.process.wait(SECONDS_TO_START)
            raise NoProcess(f"the server of processes ended with code {ended} when it was started")

    def request(self, connection: int, status: int) -> None:
        """Ask for a process that is given these descriptors."""
        socket.send_fds(self._socket, [b"p"], [connection, status])

    def lost(self, why: str) -> _Lost:
        """The error of work that lost its server, which has ended when this returns, so that another is started."""
        self.process.kill()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(5.0)
        return _Lost(why)

    def close(self) -> None:
        """End the server and all its processes."""
        self._socket.close()
        with suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGCONT)
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()


_starting = threading.Lock()


def _server(*preloaded: str) -> _Server:
    with _starting:
        servers = _servers_of(os.getpid())
        if servers and servers[0].process.poll() is not None:
            _log.warning("the server of processes has ended and is started again")
            atexit.unregister(servers.pop().close)
        if not servers:
            servers.append(_Server(*preloaded))
        return servers[0]


@cache
def _servers_of(process: int) -> list[_Server]:
    """The server of a process, once it is started; that of the process it was forked from is none of its own."""
    return []
