"""Common options of the filters of a comparison, such as gate and motion model, for those that leave them open.

A filter's own choice stands. What decides is the first constructor with a parameter of that name, on the way that
`**options` take from the one that is called (`filters.contract.constructor_calls`):

- it has been given the option on the way: the choice of the filter, which it keeps;
- its default is neither None nor that of `StereoEKF`: the same;
- else the filter leaves the option open and is given the common one.

Where there is no such constructor, the filter does not know the option and goes without. Options that are meant for one
filter come before all that.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from filters.catalogue.registry import FilterFactory, filter_factory, make_filter
from filters.contract.constructor_calls import ConstructorCall, constructor_calls
from filters.contract.noise import StereoNoise
from filters.contract.stereo_filter import StereoFilter
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry.camera import StereoCamera
from filters.motions.constant_velocity import ConstantVelocity

USUAL: Mapping[str, Any] = {"gate": 0.99, "motion": dataclasses.asdict(ConstantVelocity())}
"""Common options where nobody says otherwise, as scenario files have them."""

UNKNOWN = "it has no such option"
SAME = "it has chosen the same"


@dataclass(frozen=True, eq=False)
class MadeFilter:
    """A filter and what it was made with.

    Attributes
    ----------
    filter : StereoFilter
        Ready to be reset.
    options : dict
        Its own and the common ones that it was given, JSON-able.
    not_given : mapping of str to str
        Common options that it was not given, and why.
    """

    filter: StereoFilter
    options: dict[str, Any]
    not_given: Mapping[str, str]


def make_with_common_options(
    name: str | FilterFactory,
    camera: StereoCamera,
    noise: StereoNoise,
    options: Mapping[str, Any],
    common: Mapping[str, Any],
) -> MadeFilter:
    """Make a filter with its own options and those of the `common` ones that it leaves open.

    Parameters
    ----------
    name : str or callable
        As of `make_filter`.
    camera, noise : StereoCamera, StereoNoise
        The rig.
    options, common : mapping
        JSON-able; common ones are options of `StereoEKF`.

    Raises
    ------
    ValueError
        The filter or one of its own options is unknown or impossible, or it refuses a common option that it has.
    """

    def make(arguments: Mapping[str, Any]) -> StereoFilter:
        return make_filter(name, camera=camera, noise=noise, **arguments)

    with constructor_calls() as calls:
        made = make(options)
    way = [ConstructorCall(inspect.signature(filter_factory(name))), *calls]
    reasons = {key: _why_not(way, key, common[key]) for key in common if key not in options}
    taken = {key: common[key] for key, reason in reasons.items() if reason is None}
    if taken:
        made = make({**options, **taken})
    # Who knows no gate goes without one, as all do where the common gate is None.
    without = {key for key, why in reasons.items() if why == SAME or (why == UNKNOWN and common[key] is None)}
    missed = {key: why for key, why in reasons.items() if why and key not in without}
    return MadeFilter(made, {**options, **taken}, missed)


def _why_not(way: Sequence[ConstructorCall], key: str, value: object) -> str | None:
    """Why a filter that is made by these calls is not given this common option; None: it is given it."""
    for call in way:
        parameter = call.signature.parameters.get(key)
        if parameter is not None:
            if key not in call.given and _says_nothing(key, parameter.default):
                return None
            own = call.given.get(key, parameter.default)
            return SAME if type(own) is type(value) and own == value else f"it has its own, {_shown(own)}"
        if not any(p.kind is inspect.Parameter.VAR_KEYWORD for p in call.signature.parameters.values()):
            break
    return UNKNOWN


def _says_nothing(key: str, default: object) -> bool:
    usual = inspect.signature(StereoEKF).parameters[key].default
    return default is None or (type(default) is type(usual) and default == usual)


def _shown(value: object) -> str:
    """Its repr, or its class where that would be no more than an address."""
    return type(value).__name__ if type(value).__repr__ is object.__repr__ else repr(value)
