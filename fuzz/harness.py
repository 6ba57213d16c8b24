"""One input: a valid folder with one file changed, read once, with what is demanded of it."""

from __future__ import annotations

import io
import os
import resource
import socket
import struct
import threading
import time
import traceback
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np

from fuzz.targets import Target

MOST_SECONDS = 1.0
HEADER = 3
"""Bytes that say which target, which of its files, and how it is changed; the rest is content."""
BY_PARTS, RAW, GONE, FOLDER, LINK, PIPE, SOCKET, DEVICE, SPARSE = range(9)
"""How: content with check sums put right (PNG, one array of an npz), content as it is, no file, a folder, a link out of
the folder, a pipe that nobody writes to, a socket, a link to a device without end, a file larger than the disk."""
SPECIAL = {PIPE: "pipe", SOCKET: "socket", DEVICE: "device", SPARSE: "sparse file"}
MOST_MEMORY = 500_000_000
"""bytes that one input may ask for."""
_WAITED = 5.0
"""After so long a pipe is closed, s."""
_SPARSE = 1 << 40


@dataclass(frozen=True)
class Finding:
    """An input that did what none may do."""

    target: str
    """What was read."""
    file: str
    """Which of its files was changed."""
    what: str
    """What went wrong, in one line."""
    trace: str
    """Where it was raised."""
    data: bytes
    """The input."""

    @property
    def key(self) -> tuple[str, str]:
        """Equal for inputs that probably show the same fault."""
        return self.what.partition(":")[0], self.trace


class Harness:
    """Folders of all targets on disk, and what happens when one of their files is changed.

    Parameters
    ----------
    targets : sequence of Target
        What is read.
    folder : Path
        An empty folder, best one in memory.
    """

    def __init__(self, targets: tuple[Target, ...], folder: Path) -> None:
        self.targets = targets
        self.outside = folder / "outside"
        self.outside.mkdir()
        self.folders = [folder / str(number) / target.name for number, target in enumerate(targets)]
        for target, place in zip(targets, self.folders, strict=True):
            for name, content in target.files.items():
                (place / name).parent.mkdir(parents=True, exist_ok=True)
                (place / name).write_bytes(content)

    def seeds(self, target: int) -> list[bytes]:
        """Inputs that change nothing, or do so in the simplest way."""
        found = []
        for number, (name, content) in enumerate(self.targets[target].files.items()):
            contents = {RAW: [content], BY_PARTS: _parts(content)}
            contents |= {how: [b""] for how in (GONE, FOLDER, LINK, *SPECIAL)}
            found += [bytes([target, number, how]) + part for how, parts in contents.items() for part in parts]
            assert name
        return found

    def run(self, data: bytes) -> Finding | None:
        """Read what `data` says; None where that was well, or well refused."""
        if len(data) < HEADER:
            return None
        number = data[0] % len(self.targets)
        target, folder = self.targets[number], self.folders[number]
        names = list(target.files)
        name, how = names[data[1] % len(names)], data[2] % 9
        with self.changed(number, name, how, data[HEADER:]) as waited:
            what, trace = self._read(target, folder, must_refuse=how == LINK and not target.follows_links)
        if waited:
            what = "waited for a pipe"
        return None if what is None else Finding(target.name, name, what, trace, data)

    @contextmanager
    def changed(self, target: int, name: str, how: int, content: bytes = b"") -> Iterator[list[bool]]:
        """Have one file of a target changed; the list has an entry afterwards where somebody waited for a pipe."""
        path, before = self.folders[target] / name, self.targets[target].files[name]
        try:
            self._change(path, before, how, content)
            with _closed_in_time(path if how == PIPE else None) as waited:
                yield waited
        finally:
            _remove(path)
            path.write_bytes(before)

    def _change(self, path: Path, before: bytes, how: int, content: bytes) -> None:
        if how in (BY_PARTS, RAW):
            path.write_bytes(content if how == RAW else _whole(before, content))
            return
        path.unlink()
        if how == FOLDER:
            path.mkdir()
        elif how == LINK:
            elsewhere = self.outside / path.name
            elsewhere.write_bytes(before)
            path.symlink_to(elsewhere)
        else:
            make_special(path, how)

    def _read(self, target: Target, folder: Path, *, must_refuse: bool) -> tuple[str | None, str]:
        began = time.process_time()
        try:
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                target.read(folder)
            if must_refuse:
                return "a link out of the folder was followed", ""
        except ValueError as error:
            if len(str(error).splitlines()) > 1:
                return f"message of several lines: {error!r}", _where(error.__traceback__)
        except Exception as error:
            return f"{type(error).__name__}: {error}", _where(error.__traceback__)
        spent = time.process_time() - began
        return (f"slow: {spent:.1f} s", "") if spent > MOST_SECONDS else (None, "")


def make_special(path: Path, how: int) -> None:
    """Something of `SPECIAL` with that path."""
    if how == PIPE:
        os.mkfifo(path)
    elif how == SOCKET:
        with socket.socket(socket.AF_UNIX) as listener:
            here = os.open(path.parent, os.O_RDONLY)
            try:  # the paths of sockets are short
                listener.bind(f"/proc/self/fd/{here}/{path.name}")
            finally:
                os.close(here)
    elif how == DEVICE:
        path.symlink_to("/dev/zero")
    else:
        with path.open("wb") as stream:
            stream.truncate(_SPARSE)


@contextmanager
def _closed_in_time(pipe: Path | None) -> Iterator[list[bool]]:
    """Let a reader of the pipe go on after a while; the list has an entry where that was needed."""
    waited: list[bool] = []
    if pipe is None:
        yield waited
        return

    def close() -> None:
        with suppress(OSError):  # nobody reads it
            os.close(os.open(pipe, os.O_WRONLY | os.O_NONBLOCK))
            waited.append(True)

    timer = threading.Timer(_WAITED, close)
    timer.start()
    try:
        yield waited
    finally:
        timer.cancel()


@contextmanager
def limited_memory(most_bytes: int = MOST_MEMORY) -> Iterator[None]:
    """Let the process ask for so much more, and be refused the rest: a `MemoryError` is a finding."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + most_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _where(trace: TracebackType | None) -> str:
    return " < ".join(
        f"{Path(frame.filename).name}:{frame.lineno}" for frame in reversed(traceback.extract_tb(trace)[-4:])
    )


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


def _parts(content: bytes) -> list[bytes]:
    """Contents for `BY_PARTS` that give the file itself."""
    if not content.startswith(b"PK"):
        return [content]
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return [bytes([k]) + archive.read(name) for k, name in enumerate(archive.namelist()[:200])]


def _whole(before: bytes, content: bytes) -> bytes:
    """The file with these parts; check sums would hide what comes after them."""
    if before.startswith(b"PK"):
        return _with_member(before, content)
    return _with_sums(content) if before.startswith(b"\x89PNG") else content


def _with_member(before: bytes, content: bytes) -> bytes:
    """The archive with one member replaced: that of the number in the first byte."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(before)) as old, zipfile.ZipFile(stream, "w") as new:
        names = old.namelist()
        chosen = names[(content[0] if content else 0) % len(names)]
        for name in names:
            new.writestr(name, content[1:] if name == chosen else old.read(name))
    return stream.getvalue()


def _with_sums(content: bytes) -> bytes:
    """The PNG with right check sums, as far as its parts can be told."""
    parts, at = [content[:8]], 8
    while at + 12 <= len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        end = at + 8 + length
        if end + 4 > len(content):
            break
        parts.append(content[at:end] + struct.pack(">I", zlib.crc32(content[at + 4 : end])))
        at = end + 4
    return b"".join([*parts, content[at:]])
