"""What training needs beyond the core."""

from __future__ import annotations

from importlib.util import find_spec

from filters.extras import install_command


def require_extra(module: str) -> None:
    """Raise an `ImportError` that says how to install `module`, where it is missing."""
    if find_spec(module) is None:
        raise ImportError(f"{module} is missing: {install_command('rl')}")
