"""Policies by name, those of this package and third-party ones.

A third party adds a policy with an entry point in the group `stereo_slam.policies`; the object is called with the
options of the policy and returns a `Policy`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from filters.contract.validation import did_you_mean, first_line, require_known, type_name
from stereo_slam_env.policies.interface import Policy

ENTRY_POINT_GROUP = "stereo_slam.policies"

_OWN = {
    "fixed": "open_loop:FixedGaze",
    "random": "open_loop:RandomGaze",
    "sweep": "open_loop:Sweep",
    "most-uncertain": "planning:MostUncertain",
    "greedy": "planning:Greedy",
    "lookahead": "planning:Lookahead",
    "ppo": "network:NetworkPolicy",
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


def plugin_of(name: str) -> EntryPoint | None:
    """The entry point of a third-party policy; None for one of ours."""
    return None if name in _OWN else _entry_points().get(name)


def available_policies() -> dict[str, str]:
    """Names and one line on each."""
    return {name: (inspect.getdoc(_found(name)) or "no description").splitlines()[0] for name in _entry_points()}


def _own_entry_points() -> dict[str, EntryPoint]:
    return {name: EntryPoint(name, f"{__package__}.{what}", ENTRY_POINT_GROUP) for name, what in _OWN.items()}


def _entry_points() -> dict[str, EntryPoint]:
    """Ours, and those of third parties that have another name."""
    own = _own_entry_points()
    return {**own, **{point.name: point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in own}}


def _found(name: str) -> Callable[..., Any]:
    known = _own_entry_points()
    if name not in known:
        known = _entry_points()  # asks every installed package: a tenth of a second
    if name not in known:
        raise ValueError(f"policy must be one of {', '.join(known)}, got {name!r}{did_you_mean(name, known)}")
    point = known[name]
    try:
        found: Callable[..., Any] = point.load()
    except Exception as error:  # whatever a stranger's module does at import must not take the run down
        raise ValueError(
            f"policy {name!r} ({point.value}) cannot be loaded: {type_name(error)}: {first_line(error)}"
        ) from error
    return found
