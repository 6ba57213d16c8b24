"""Install commands of the extras of the distribution."""

from __future__ import annotations

import sys

DISTRIBUTION = "stereo-slam-env"


def install_command(extra: str) -> str:
    """Command that adds an extra to the installation that runs, and leaves that as it is.

    pip takes the named distribution as it is installed (a copy, or an editable checkout) and fetches only what its
    extra lacks, so the command works in every folder and without the distribution on an index.
    """
    return f'{sys.executable} -m pip install "{DISTRIBUTION}[{extra}]"'
