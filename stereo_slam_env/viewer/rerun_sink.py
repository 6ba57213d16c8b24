"""Where a Rerun recording goes: into a file, to a viewer that runs elsewhere, or to one that is opened here."""

from __future__ import annotations

import importlib
import os
import shutil
import socket
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import urlsplit

from filters.extras import install_command
from stereo_slam_env.files.paths import checked_file

_EXAMPLE = "rerun+http://127.0.0.1:9876/proxy"
_SCHEMES = ("rerun", "rerun+http", "rerun+https")
_ANSWER = 5.0
"""s in which a viewer must answer. Rerun itself would wait for it in silence, and for ever."""
_LAST_WORDS = 60.0
"""s that what is left may take to be sent or written."""


def require_rerun() -> ModuleType:
    """The package `rerun`; an `ImportError` in one line where it is missing."""
    try:
        importlib.import_module("rerun.blueprint")
        return importlib.import_module("rerun")
    except ImportError as error:
        raise ImportError(f"the Rerun viewer is missing: {install_command('viewer')}") from error


def open_sink(stream: Any, layout: Any, save: str | Path | None = None, connect: str | None = None) -> None:
    """Send a recording to a file, to the viewer at an address or, without both, to a viewer opened here.

    Parameters
    ----------
    stream : rerun.RecordingStream
        The recording; nothing has been logged yet.
    layout : rerun.blueprint.Blueprint
        How a viewer shows it at first.
    save : str or Path, optional
        An .rrd file.
    connect : str, optional
        Address of a viewer, such as rerun+http://127.0.0.1:9876/proxy.

    Raises
    ------
    ValueError
        `save` and `connect` together, a file that cannot be written, an address that is none, or no display.
    ConnectionError
        No viewer answers at the address, or none could be opened.
    """
    if save is not None and connect is not None:
        raise ValueError("save and connect exclude each other: give one of them")
    if save is not None:
        path = checked_file("file", save, ".rrd")
        stream.save(path, default_blueprint=layout)
    elif connect is not None:
        _require_answer(connect)
        with _one_line():
            stream.connect_grpc(connect, default_blueprint=layout)
    else:
        _require_display()
        with _one_line():
            require_rerun().spawn(executable_path=_viewer(), recording=stream, default_blueprint=layout)


def close_sink(stream: Any) -> None:
    """Send or write what is left; may be called twice.

    Raises
    ------
    ConnectionError
        The viewer went away, or the file cannot take it: what was shown is not whole.
    """
    try:
        with _one_line():
            stream.flush(timeout_sec=_LAST_WORDS)
    finally:
        stream.disconnect()


@contextmanager
def _one_line() -> Iterator[None]:
    """What Rerun complains of: the first of its lines, which are many."""
    try:
        yield
    except RuntimeError as error:
        raise ConnectionError(f"Rerun's viewer: {str(error).strip().splitlines()[0]}") from error


def _require_answer(address: str) -> None:
    wrong = f"connect must be the address of a viewer, such as {_EXAMPLE}, got {address!r}"
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(wrong) from error
    if parts.scheme not in _SCHEMES or host is None or port is None or parts.path != "/proxy":
        raise ValueError(wrong)
    try:
        socket.create_connection((host, port), timeout=_ANSWER).close()
    except OSError as error:
        raise ConnectionError(
            f"no viewer answers at {address} ({error.strerror or error}): start one there, "
            "with `rerun`, or with `rerun --serve-web` for a browser"
        ) from error


def _require_display() -> None:
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ValueError("no display for Rerun's viewer here: save a file, or connect to a viewer that runs elsewhere")


def _viewer() -> str | None:
    """The viewer that came with this Python: its folder need not be on the PATH. None leaves the search to Rerun."""
    return shutil.which("rerun", path=sysconfig.get_path("scripts"))
