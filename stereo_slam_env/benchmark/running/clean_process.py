"""Server of clean processes: it never starts a thread or draws, so that forking it is safe.

`isolation` starts it with `subprocess`. It imports what trials need, then forks itself once for each request that
comes through a socket. A request carries two descriptors: the connection over which the work comes and the answer
goes, and a pipe on which the server writes the id of the new process and, in the end, how it ended.
"""

from __future__ import annotations

import importlib
import os
import pickle
import selectors
import signal
import socket
import struct
import sys
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import NoReturn

import cloudpickle

PRELOADED = (
    "stereo_slam_env.benchmark.running.tasks",
    "stereo_slam_env.policies.episode",
    "stereo_slam_env.wrappers.belief_panorama",
    "stereo_slam_env.envs.recorder",
    "numba",
)
"""What most trials need; importing it once here is why a process costs milliseconds."""

STATUS = struct.Struct("q")
READY = b"r"

_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True)
class Work:
    """A pickled function, and where its modules and files are found: the caller's path and folder of now."""

    path: tuple[str, ...]
    folder: str
    function: bytes


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
        requests.sendall(READY)
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
    """Write how each process that has ended did so: its code, or minus the number of the signal."""
    while running:
        child, status = os.waitpid(-1, os.WNOHANG)
        if child == 0:
            return
        _write(running[child], os.waitstatus_to_exitcode(status))
        os.close(running.pop(child))


def _write(pipe: int, number: int) -> None:
    try:
        os.write(pipe, STATUS.pack(number))
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
        work: Work = pickle.loads(connection.recv_bytes())
        sys.path[:] = work.path
        os.chdir(work.folder)
        return "result", pickle.loads(work.function)(
            lambda done, total: connection.send_bytes(_packed("alive", (done, total)))
        )
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
