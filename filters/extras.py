"""Install commands of the extras of the distribution."""

from __future__ import annotations

import sys
from importlib.util import find_spec

DISTRIBUTION = "stereo-slam-env"
NEWER_PYTHON = {"gtsam": (3, 11)}
"""First version of Python that an extra can be had for, where that is not the first of the project."""


def install_command(extra: str) -> str:
    """Command that adds an extra to the installation that runs, and leaves that as it is.

    pip takes the named distribution as it is installed (a copy, or an editable checkout) and fetches only what its
    extra lacks, so the command works in every folder and without the distribution on an index. Where the running Python
    is too old for the extra, the text says so.
    """
    if sys.version_info < NEWER_PYTHON.get(extra, (3, 0)):
        wanted = ".".join(map(str, NEWER_PYTHON[extra]))
        return f"the extra {extra} needs Python {wanted} or newer"
    return f'{sys.executable} -m pip install "{DISTRIBUTION}[{extra}]"'


def require_module(module: str, extra: str) -> None:
    """Raise an `ImportError` that says how to install `module` with an extra, where it is missing."""
    if find_spec(module) is None:
        raise ImportError(f"{module} is missing: {install_command(extra)}")
