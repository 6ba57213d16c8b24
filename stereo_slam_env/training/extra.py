"""What training needs beyond the core."""

from __future__ import annotations

from importlib.util import find_spec

_EXTRAS = {"torch": "rl", "stable_baselines3": "rl", "minari": "rl"}


def require_extra(module: str) -> None:
    """Raise an `ImportError` that says which extra brings `module`, where it is missing."""
    if find_spec(module) is None:
        raise ImportError(f"{module} is missing: pip install 'stereo-slam-env[{_EXTRAS[module]}]'")
