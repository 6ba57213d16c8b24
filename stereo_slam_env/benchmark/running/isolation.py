"""Work in a process of its own: a crash or a hang is reported and ends nothing else.

Such a process is forked from a server that has imported what trials need, never starts a thread and never draws, so
that forking it is safe. It is never forked from the caller, which may have drawn, or have threads of BLAS, a notebook
or a cluster: they do not survive a fork, and what waits for them would wait for ever.

The server is started with `subprocess`. It forks itself once for each request that comes through a socket. A request
carries two descriptors: the connection over which the work comes and the answer goes, and a pipe on which the server
writes the id of the new process and, in the end, its exit code.
"""

from __future__ import annotations

import atexit
import importlib
import logging
import os
import pickle
import selectors
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from multiprocessing.connection import Connection, wait
from typing import NoReturn, TypeVar, cast

import cloudpickle

Result = TypeVar("Result")
Tell = Callable[[int, int], None]

SECONDS_TO_START = 120.0
"""Limit of the server's start, and of a new process's: far more than a busy machine needs."""
KERNELS = "filters.engine.row"
PRELOADED = (
    KERNELS,
    "stereo_slam_env.benchmark.running.tasks",
    "stereo_slam_env.policies.episode",
    "stereo_slam_env.wrappers.belief_panorama",
    "stereo_slam_env.envs.recorder",
)
"""Modules that most trials need; importing them once in the server is why a process costs milliseconds."""

_STATUS = struct.Struct("q")
_READY = b"r"
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_log = logging.getLogger(__name__)


class WorkDied(RuntimeError):
    """The process ended without an answer: a crash, or the machine's memory ran out."""


class WorkTooSlow(RuntimeError):
    """Nothing was heard from the process for too long, and it was ended."""


def run_isolated(work: Callable[[Tell], Result], *, silence_limit: float, progress: Tell | None = None) -> Result:
    """Run `work` in a process of its own and return what it returns.

    `work` is called with a function (done, total) that it calls as it goes on: a sign of life, which `progress` is told
    of and which must come within `silence_limit`, s. It is sent by cloudpickle, so functions and classes of a script or
    notebook will do; what it returns or raises must be picklable, too. Where the system cannot fork, it runs in this
    process, without protection.

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
        content = pickle.dumps((sys.path, os.getcwd(), cloudpickle.dumps(work)))
    except Exception as error:  # whatever the objects in it raise
        raise ValueError(f"work must be picklable, to be done in a process of its own: {error}") from error
    with _clean_process() as (connection, status):
        with suppress(BrokenPipeError):  # it died at once: `_listen` says how
            connection.send_bytes(content)
        return cast(Result, _listen(connection, status, silence_limit, progress))


@contextmanager
def _clean_process() -> Iterator[tuple[Connection, int]]:
    """A new process: the connection to it, and the pipe on which the server will tell its exit code."""
    here, there = socket.socketpair()
    status, telling = os.pipe()
    with Connection(here.detach()) as connection, open(status, "rb"):
        with there, open(telling, "wb"):
            _server().request(there.fileno(), telling)
        process = _status(status, "the id of a new process")
        try:
            yield connection, status
        finally:
            with suppress(ProcessLookupError):
                if not wait([status], 0):  # the server has not told its end
                    os.kill(process, signal.SIGKILL)


def _status(pipe: int, what: str) -> int:
    if not wait([pipe], SECONDS_TO_START):
        raise WorkDied(f"{what} was not told for {SECONDS_TO_START:.0f} s")
    content = os.read(pipe, _STATUS.size)
    if not content:
        raise WorkDied("the server of processes has ended")
    return int(_STATUS.unpack(content)[0])


def _listen(connection: Connection, status: int, limit: float, progress: Tell | None) -> object:
    while True:
        began = time.monotonic()
        if not connection.poll(limit):
            raise WorkTooSlow(f"no sign of life for {time.monotonic() - began:.0f} s")
        try:
            kind, content = pickle.loads(connection.recv_bytes())
        except (EOFError, ConnectionResetError):
            _raise_for_death(_status(status, "how a process ended"))
        if kind == "result":
            return content
        if kind == "error":
            raise content
        if progress is not None:
            progress(*content)


def _raise_for_death(code: int) -> NoReturn:
    """Raise for an exit code, or minus the number of the signal."""
    if code >= 0:
        raise WorkDied(f"its process ended with code {code}")
    by = signal.Signals(-code)
    if by in _ENDING:
        raise KeyboardInterrupt
    raise WorkDied(f"its process was ended by {by.name}")


class _Server:
    """Server of this process."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            # The path is passed on as it is, so that the server finds what this process finds.
            code = (
                f"import sys; sys.path[:] = {sys.path!r}; "
                f"from stereo_slam_env.benchmark.running.isolation import serve; serve({theirs.fileno()})"
            )
            self.process = subprocess.Popen(
                [sys.executable, "-c", code],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                env={**os.environ, **_ONE_THREAD},
            )
        atexit.register(self.close)
        self._socket.settimeout(SECONDS_TO_START)
        if self._socket.recv(1) != _READY:
            raise WorkDied(f"the server of processes ended with code {self.process.wait(SECONDS_TO_START)}")

    def request(self, connection: int, status: int) -> None:
        """Ask for a process that is given these descriptors."""
        socket.send_fds(self._socket, [b"p"], [connection, status])

    def close(self) -> None:
        """End the server and all its processes."""
        self._socket.close()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()


_starting = threading.Lock()


def _server() -> _Server:
    with _starting:
        server = _server_of(os.getpid())
        if server.process.poll() is not None:
            _log.warning("the server of processes has ended and is started again")
            _server_of.cache_clear()
            server = _server_of(os.getpid())
        return server


@cache
def _server_of(process: int) -> _Server:
    importlib.import_module(KERNELS)  # compiled where they have not been: no process of a trial should wait for it
    return _Server()


# ---- the server ------------------------------------------------------------------------------------------------------


def serve(descriptor: int) -> None:
    """Fork a process for each request on the socket `descriptor`, until the other side is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the caller decides what ends
    for module in PRELOADED:
        try:
            importlib.import_module(module)
        except ImportError:  # an extra that is not installed
            continue
    wake_up, woken_by = os.pipe()
    for end in (wake_up, woken_by):
        os.set_blocking(end, False)
    signal.set_wakeup_fd(woken_by, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    running: dict[int, int] = {}
    with socket.socket(fileno=descriptor) as requests, selectors.DefaultSelector() as waiting:
        waiting.register(requests, selectors.EVENT_READ)
        waiting.register(wake_up, selectors.EVENT_READ)
        try:
            requests.sendall(_READY)
        except BrokenPipeError:  # the caller was killed meanwhile
            return
        while True:
            ready = {key.fileobj for key, _ in waiting.select()}
            if wake_up in ready:
                os.read(wake_up, 4096)
                _tell_ends(running)
            if requests in ready:
                message, descriptors, _, _ = socket.recv_fds(requests, 1, 2)
                if not message:
                    break
                connection, status = descriptors
                child = os.fork()
                if child == 0:
                    signal.set_wakeup_fd(-1)
                    waiting.close()
                    requests.close()
                    for inherited in (wake_up, woken_by, status, *running.values()):
                        os.close(inherited)
                    _work(Connection(connection))
                running[child] = status
                os.close(connection)
                _write(status, child)
    for child in running:
        os.kill(child, signal.SIGKILL)


def _tell_ends(running: dict[int, int]) -> None:
    """Report the exit code of each process that has ended, or minus the number of the signal."""
    while running:
        child, status = os.waitpid(-1, os.WNOHANG)
        if child == 0:
            return
        _write(running[child], os.waitstatus_to_exitcode(status))
        os.close(running.pop(child))


def _write(pipe: int, number: int) -> None:
    try:
        os.write(pipe, _STATUS.pack(number))
    except BrokenPipeError:  # nobody listens any more
        return


def _work(connection: Connection) -> NoReturn:
    """In the new process: take the work, do it, send the answer, and leave without any clean-up."""
    for ending in (*_ENDING, signal.SIGCHLD):
        signal.signal(ending, signal.SIG_DFL)
    code = 1
    try:
        connection.send_bytes(_packed(*_answer(connection)))
        sys.stdout.flush()
        sys.stderr.flush()
        code = 0
    except (BrokenPipeError, EOFError):  # nobody waits for the answer any more
        code = 0
    finally:
        os._exit(code)


def _answer(connection: Connection) -> tuple[str, object]:
    try:
        sys.path[:], folder, work = pickle.loads(connection.recv_bytes())
        os.chdir(folder)
        return "result", pickle.loads(work)(lambda done, total: connection.send_bytes(_packed("alive", (done, total))))
    except Exception as error:
        return "error", error


def _packed(kind: str, content: object) -> bytes:
    try:
        packed: bytes = cloudpickle.dumps((kind, content))
        if kind == "error":
            pickle.loads(packed)  # an error of a class with arguments of its own can be written, but not read
    except Exception as error:
        what = content if kind == "error" else error
        packed = pickle.dumps(("error", RuntimeError(f"the answer cannot be sent: {type(what).__name__}: {what}")))
    return packed
