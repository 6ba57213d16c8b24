"""Policies by name, those of this package and third-party ones.

A third party adds a policy with an entry point in the group `stereo_slam.policies`; the object is called with the
options of the policy and returns a `Policy`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from filters.known_names import did_you_mean, require_known
from stereo_slam_env.policies.interface import Policy

ENTRY_POINT_GROUP = "stereo_slam.policies"

_OWN: dict[str, str] = {
    "fixed": "stereo_slam_env.policies.open_loop:FixedGaze",
    "random": "stereo_slam_env.policies.open_loop:RandomGaze",
    "sweep": "stereo_slam_env.policies.open_loop:Sweep",
    "most-uncertain": "stereo_slam_env.policies.planning:MostUncertain",
    "greedy": "stereo_slam_env.policies.planning:Greedy",
    "lookahead": "stereo_slam_env.policies.planning:Lookahead",
    "ppo": "stereo_slam_env.policies.network:NetworkPolicy",
}


def make_policy(name: str, **options: Any) -> Policy:
    """Make a policy by name.

    Parameters
    ----------
    name : str
        One of `available_policies()`.
    **options
        The policy's own, JSON-able.

    Raises
    ------
    ValueError
        Unknown name or option, an option's value is refused, or a third-party policy cannot be loaded.
    """
    factory = _found(name)
    parameters = inspect.signature(factory).parameters
    require_known(f"policy {name!r} has no option", options, parameters)
    made: Policy = factory(**options)
    return made


def available_policies() -> dict[str, str]:
    """Names and one line on each."""
    return {name: (inspect.getdoc(_found(name)) or "no description").splitlines()[0] for name in _names()}


def _names() -> list[str]:
    return [*_OWN, *(point.name for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in _OWN)]


def _found(name: str) -> Callable[..., Any]:
    if name in _OWN:
        module, _, attribute = _OWN[name].partition(":")
        found: Callable[..., Any] = getattr(import_module(module), attribute)
        return found
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name == name:
            try:
                found = point.load()
            except Exception as error:  # whatever a stranger's module does at import must not take the run down
                raise ValueError(
                    f"policy {name!r} ({point.value}) cannot be loaded: {type(error).__name__}: {error}"
                ) from error
            return found
    names = _names()
    raise ValueError(f"policy must be one of {', '.join(names)}, got {name!r}{did_you_mean(name, names)}")
