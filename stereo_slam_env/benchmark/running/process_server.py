"""Server of processes: a clean process that forks itself once for each request, see `isolation`.

It has imported what trials need, has one thread and never draws, so that forking it is safe. It is started with
`subprocess`, in a session of its own, where no Ctrl-C of a terminal reaches it: its caller decides what ends. It ends
when the caller does, however that ends, because the socket between them is closed then.

A request carries two descriptors: the connection over which the work comes and the answer goes, and a pipe on which the
server writes the id of the new process and, in the end, its exit code. Each process leads a session of its own, and
what it has started ends with it; what it has detached ends with the server, to which Linux then gives it.
"""

from __future__ import annotations

import ctypes
import importlib
import logging
import os
import pickle
import selectors
import signal
import socket
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import cloudpickle

from filters.contract.validation import error_line

Send = Callable[[str, object], None]
"""Sends a kind of message, and its content."""

PRELOADED = (
    "filters.engine.row",
    "stereo_slam_env.benchmark.running.tasks",
    "stereo_slam_env.policies.policy_rows",
    "stereo_slam_env.envs.belief_panorama",
    "stereo_slam_env.envs.recorder",
)
"""Modules that most trials need; importing them once in the server is why a process costs milliseconds. One may have
`rehearsals()`, functions that run what its machine code is for."""
STATUS = struct.Struct("q")
"""Of the numbers on the pipe."""
LARGEST_FILE = 16 * 2**30
"""Bytes of a file that work may write."""
LOADING, READY = b"l", b"r"
"""Signs of life while the server starts, and that it has."""

_SET_DEATH_SIGNAL, _ADOPT_ORPHANS = 1, 36  # PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER


def serve(descriptor: int, *preloaded: str) -> None:
    """Fork a process for each request on the socket `descriptor`, until the other side is closed.

    `preloaded` are modules that are imported before, besides those that most trials need.
    """
    modules = []
    for name in (*PRELOADED, *preloaded):
        with suppress(ImportError):  # an extra that is not installed
            modules.append(importlib.import_module(name))
    _ask_linux(_ADOPT_ORPHANS, 1)
    _limit_resources()
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
            _load_machine_code(modules, lambda: requests.sendall(LOADING))
            requests.sendall(READY)
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
                server = os.getpid()
                child = os.fork()
                if child == 0:
                    signal.set_wakeup_fd(-1)
                    waiting.close()
                    requests.close()
                    for inherited in (wake_up, woken_by, status, *running.values()):
                        os.close(inherited)
                    _work(Connection(connection), server)
                running[child] = status
                os.close(connection)
                _write(status, child)
    _end_all(running)


def _load_machine_code(modules: Sequence[ModuleType], tell: Callable[[], None]) -> None:
    """Run the rehearsals of modules, so that each process need not load for itself what they call.

    `tell` is called after each, which may have been compiled first. A fault is reported where a trial meets it.
    """
    from numba import config

    for module in () if config.DISABLE_JIT else modules:
        for rehearse in getattr(module, "rehearsals", tuple)():
            with suppress(Exception):
                rehearse()
            tell()


def end_process(process: int) -> None:
    """End a process that leads a session, or is about to, and what it has started."""
    with suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)
    _end_group(process)


def _end_group(leader: int) -> None:
    with suppress(ProcessLookupError, PermissionError):  # macOS denies what has ended
        os.killpg(leader, signal.SIGKILL)


def _tell_ends(running: dict[int, int]) -> None:
    """Report the exit code of each process that has ended, or minus the number of the signal."""
    while True:
        try:
            child, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:  # there are none
            return
        if child == 0:
            return
        if child in running:  # else somebody's orphan
            _end_group(child)
            _write(running[child], os.waitstatus_to_exitcode(status))
            os.close(running.pop(child))


def _end_all(running: dict[int, int]) -> None:
    for child in running:
        end_process(child)
    children = Path(f"/proc/self/task/{os.getpid()}/children")
    with suppress(OSError):  # no Linux
        while orphans := children.read_text().split():
            for orphan in map(int, orphans):
                end_process(orphan)
            os.waitpid(-1, 0)


def _write(pipe: int, number: int) -> None:
    try:
        os.write(pipe, STATUS.pack(number))
    except BrokenPipeError:  # nobody listens any more
        return


def _limit_resources() -> None:
    """Let each process from here on take no more memory than the machine has, and write no file without end."""
    import resource

    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for kind, most in ((resource.RLIMIT_DATA, memory), (resource.RLIMIT_FSIZE, LARGEST_FILE)):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _ask_linux(what: int, value: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(what, value, 0, 0, 0)


# ---- the new process ------------------------------------------------------------------------------------------------


def _work(connection: Connection, server: int) -> NoReturn:
    """Take the work, do it, send the answer, and leave without any clean-up."""
    os.setsid()
    _ask_linux(_SET_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != server:  # it ended meanwhile
        os._exit(1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    code, sending = 1, threading.Lock()  # the work may have threads, and they may log

    def send(kind: str, content: object) -> None:
        packed = _packed(kind, content)
        with sending:
            connection.send_bytes(packed)

    logging.getLogger().addHandler(_Logged(send))
    _tell_what_is_compiled(send)
    try:
        kind, content = _answer(connection, send)
        sys.stdout.flush()
        sys.stderr.flush()
        send(kind, content)
        code = 0
    except (BrokenPipeError, EOFError):  # nobody waits for the answer any more
        code = 0
    finally:
        os._exit(code)


class _Logged(logging.Handler):
    """Sends what is logged to the caller, whose logging it concerns."""

    def __init__(self, send: Send) -> None:
        super().__init__()
        self._send = send

    def emit(self, record: logging.LogRecord) -> None:
        """Send the words of a record."""
        try:
            self._send("logged", (record.name, record.levelno, self.format(record)))
        except Exception:  # wrong arguments of a record are no fault of the work
            self.handleError(record)


def _tell_what_is_compiled(send: Send) -> None:
    """Send a message whenever a function of Numba has its machine code, compiled or from the disk."""
    from numba.core import event  # the server has it; its caller, which imports this module, may do without

    class Compiled(event.Listener):  # type: ignore[misc]
        def on_start(self, event: object) -> None:
            """Wait for the end."""

        def on_end(self, event: object) -> None:
            send("compiled", None)

    event.register("numba:compiler_lock", Compiled())


def _answer(connection: Connection, send: Send) -> tuple[str, object]:
    try:
        sys.path[:], folder, work = pickle.loads(connection.recv_bytes())
        os.chdir(folder)
        return "result", pickle.loads(work)(lambda done, total: send("alive", (done, total)))
    except Exception as error:
        return "error", error


def _packed(kind: str, content: object) -> bytes:
    try:
        packed: bytes = cloudpickle.dumps((kind, content))
        if kind == "error":
            pickle.loads(packed)  # an error of a class with arguments of its own can be written, but not read
    except BaseException as error:
        what = content if isinstance(content, BaseException) else error
        packed = pickle.dumps(("error", RuntimeError(f"the answer cannot be sent: {error_line(what)}")))
    return packed
