"""Text files of recordings: regular files of a size that a recording can have."""

from __future__ import annotations

import stat
from pathlib import Path

MOST_BYTES = 100_000_000
"""Larger files are refused before they are read."""


def read_text(path: Path, *, errors: str = "strict", most_bytes: int = MOST_BYTES) -> str:
    """Read a text file.

    Parameters
    ----------
    path : Path
        The file, UTF-8.
    errors : {"strict", "replace"}
        What to do about bytes that are no text.
    most_bytes : int
        Larger files are refused.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    ValueError
        No regular file (a pipe or a device could be read for ever), too large, not readable, or no text: one line.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise ValueError(f"{path} is no regular file: copy it again")
        if found.st_size > most_bytes:
            raise ValueError(f"{path} has {found.st_size} bytes: more than {most_bytes} are refused")
        return path.read_text(encoding="utf-8", errors=errors)
    except FileNotFoundError:
        raise
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text (byte {error.start}): copy it again") from error
    except OSError as error:
        raise ValueError(f"{path} cannot be read ({error.strerror or type(error).__name__}): check the file") from error
