"""Files that appear complete or not at all, folders that one process at a time writes results into, and what is ours.

Nothing is removed or replaced that this program has not made: unfinished files carry a mark that no other file has by
chance, and of a folder that may hold anything else, the files that were written into it are listed beside them.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import msgspec
from filelock import FileLock, Timeout

from stereo_slam_env.files.opening import is_plain_name, require_inside
from stereo_slam_env.files.readers import read_json

CLAIM = ".lock"
LIST = ".stereo-slam.json"
"""List of the files in a folder that this program wrote."""
_PART = ".part"
_UNFINISHED = re.compile(rf"\.(.+\.\d+)\.([0-9a-f]{{16}}){re.escape(_PART)}(-journal|-wal|-shm)?", re.DOTALL)
_LONGEST_STEM = 80
"""Characters of a file's name that its temporary name has: file systems take 255 bytes."""


def write_atomically(path: Path, write: Callable[[IO[bytes]], Any]) -> None:
    """Write a file so that a reader, or an interruption, never meets half of it.

    A link is replaced, and what it points to stays.

    Parameters
    ----------
    path : Path
        The file; its folder is made.
    write : callable
        Called with the open stream.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = unfinished_name(path)
    try:
        with unfinished.open("xb") as stream:
            write(stream)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8, as `write_atomically`."""
    write_atomically(path, lambda stream: stream.write(text.encode()))


def json_text(data: Mapping[str, Any], *, indent: int | None = 2) -> str:
    """JSON of plain data, NaN and infinity as null, ended by a line break; `indent` None: no other, no spaces."""
    compact = msgspec.json.encode(data, enc_hook=_plain)
    return (compact if indent is None else msgspec.json.format(compact, indent=indent)).decode() + "\n"


def write_json(path: Path, data: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """Write JSON, whole or not at all; `indent` as of `json_text`."""
    write_atomically(path, lambda stream: stream.write(json_text(data, indent=indent).encode()))


def _plain(value: Any) -> Any:
    return dict(value) if isinstance(value, Mapping) else float(value)


def require_writable(path: Path) -> None:
    """Raise an `OSError` where no file can be written at or below a path, which need not exist: before long work.

    Nothing is made and nothing stays behind.
    """
    existing_parent = next((one for one in (path, *path.absolute().parents) if one.exists()), path)
    try:
        with tempfile.TemporaryFile(dir=existing_parent):
            return
    except OSError as error:
        raise OSError(f"output {path} cannot be written ({error.strerror}): choose another directory") from error


def unfinished_name(path: Path) -> Path:
    """Temporary name of a file that this process is writing; nothing has it."""
    name = f"{path.name[:_LONGEST_STEM]}.{os.getpid()}"
    unfinished = path.with_name(f".{name}.{_mark(name)}{_PART}")
    unfinished.unlink(missing_ok=True)  # of an earlier process with this number
    return unfinished


def _mark(name: str) -> str:
    return hashlib.sha256(f"stereo-slam is writing {name}".encode()).hexdigest()[:16]


def _is_unfinished(name: str) -> bool:
    """Whether a file name is one of `unfinished_name`; SQLite keeps a journal beside its file."""
    match = _UNFINISHED.fullmatch(name)
    return match is not None and match[2] == _mark(match[1])


def remove_unfinished(folder: Path) -> None:
    """Remove what killed processes were writing; nobody may be writing there now.

    Folders below that have a claim of their own are somebody else's.
    """
    for here, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not Path(here, name, CLAIM).exists()]
        for name in filter(_is_unfinished, files):
            Path(here, name).unlink(missing_ok=True)


@contextmanager
def claimed_folder(folder: Path) -> Iterator[None]:
    """Be the only process that writes into a folder, which is made; what a killed one left half written goes.

    The claim is a lock that the system drops when the process ends, however it ends; its file stays.

    Parameters
    ----------
    folder : Path
        The folder.

    Raises
    ------
    ValueError
        Another process has the folder, or its lock is no file of ours.
    OSError
        The folder cannot be written.
    """
    if _is_foreign_claim(folder / CLAIM):
        raise ValueError(f"output {folder} has a {CLAIM} that is not ours: choose another directory")
    lock = FileLock(folder / CLAIM)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout as error:
        raise ValueError(
            f"output {folder} is in use by another process: wait until it ends, or choose another directory"
        ) from error
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise
        raise OSError(f"output {folder} cannot be written ({error.strerror}): choose another directory") from error
    try:
        remove_unfinished(folder)
        yield
    finally:
        lock.release()


def _is_foreign_claim(path: Path) -> bool:
    """Whether there is something that would be emptied as a lock: ours is an empty file."""
    return path.is_symlink() or (path.exists() and (not path.is_file() or path.stat().st_size > 0))


def is_occupied(folder: Path) -> bool:
    """Whether there is anything in an existing folder but a claim."""
    return any(entry.name != CLAIM or _is_foreign_claim(entry) for entry in folder.iterdir())


# ---- a folder that may hold anything else ----------------------------------------------------------------------------


def own_files(folder: Path, names: Iterable[str], *, is_run: bool = False) -> None:
    """List files as written by this program, before they are written.

    Parameters
    ----------
    folder : Path
        The folder, which is made.
    names : iterable of str
        Paths below it, with slashes.
    is_run : bool
        Whether the folder is a run of ours: then all names that it ever lists are ours, whoever wrote them.

    Raises
    ------
    ValueError
        One is there and was not written by this program, or leads out of the folder.
    """
    listed, replaces_any = _listed(folder)
    new = [name for name in dict.fromkeys(names) if name not in listed]
    for name in new:
        path = require_inside(folder / name, folder) if (folder / name).parent.exists() else folder / name
        if path.exists() and not (replaces_any or is_run):
            raise ValueError(f"{path} is there and is not ours: choose another output, or remove it")
    if new or is_run > replaces_any:
        about = {"made by": "stereo-slam-env", "run": replaces_any or is_run, "files": [*listed, *new]}
        write_text(folder / LIST, json.dumps(about, indent=1) + "\n")


def remove_own_files(folder: Path, below: Iterable[str]) -> None:
    """Remove the files in these folders below a folder that are listed by `own_files`, and nothing else."""
    listed, replaces_any = _listed(folder)
    stale = [name for name in listed if name.partition("/")[0] in below and is_plain_name(name.partition("/")[2])]
    for path in (folder / name for name in stale):
        if path.parent.is_dir() and not path.parent.is_symlink() and (path.is_file() or path.is_symlink()):
            path.unlink()
    if stale:
        remaining = [name for name in listed if name not in stale]
        about = {"made by": "stereo-slam-env", "run": replaces_any, "files": remaining}
        write_text(folder / LIST, json.dumps(about, indent=1) + "\n")


def _listed(folder: Path) -> tuple[list[str], bool]:
    """The files of the list in a folder, and whether it is a run."""
    try:
        about = read_json(folder / LIST, inside=folder)
        return [str(name) for name in about["files"]], bool(about["run"])
    except (FileNotFoundError, NotADirectoryError):
        return [], False
    except (TypeError, KeyError, ValueError) as error:
        raise ValueError(f"{folder / LIST} is no list of files of this program: choose another directory") from error
