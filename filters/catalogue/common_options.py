"""Common options of the filters of a comparison, such as gate and motion model, for those that leave them open."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from filters.catalogue.registry import FilterFactory, filter_factory, make_filter
from filters.contract.noise import StereoNoise
from filters.contract.stereo_filter import StereoFilter
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry.camera import StereoCamera
from filters.motions.constant_velocity import ConstantVelocity
from filters.parts import SLOTS, make_part

USUAL: Mapping[str, Any] = {"gate": 0.99, "motion": dataclasses.asdict(ConstantVelocity())}
"""Common options where nobody says otherwise, as scenario files have them."""

_USUAL_OPTIONS: Mapping[str, Mapping[str, Any]] = {
    # Without a guard XYZ diverges on far points (d <= 0 has no point at all). That of the smallest position error on
    # drives of 350 m that no table is of: `python benchmarks/euclidean_guard.py --seeds 64`.
    "euclidean": {"min_disparity": 4.0},
}

NOT_OPEN = "it does not leave it open"


@dataclass(frozen=True, eq=False)
class MadeFilter:
    """A filter and what it was made with."""

    filter: StereoFilter
    """Ready to be reset."""
    options: dict[str, Any]
    """Its own and the common ones that it was given, JSON-able."""
    not_given: Mapping[str, str]
    """Common options that it was not given, and why."""


def usual_options(name: str | FilterFactory) -> dict[str, Any]:
    """Options of a filter that is asked for by its name alone."""
    return dict(_USUAL_OPTIONS.get(name, {})) if isinstance(name, str) else {}


def make_with_common_options(
    name: str | FilterFactory,
    camera: StereoCamera,
    noise: StereoNoise,
    options: Mapping[str, Any],
    common: Mapping[str, Any],
) -> MadeFilter:
    """Make a filter with its own options and those of the `common` ones that its `open_options` name.

    A constructor that passes one of them on itself, and so gets it twice, keeps its choice.

    Parameters
    ----------
    name : str or callable
        As of `make_filter`. A function has no open options unless it carries them as an attribute.
    camera, noise : StereoCamera, StereoNoise
        The rig.
    options, common : mapping
        JSON-able; common ones are options of `StereoEKF`. What is in both is the filter's.

    Raises
    ------
    ValueError
        The filter or one of its own options is unknown or impossible, or it refuses a common option that it leaves
        open.
    """
    left_open: frozenset[str] = getattr(filter_factory(name), "open_options", frozenset())
    given = {key: value for key, value in common.items() if key in left_open and key not in options}
    made = None
    while made is None:
        try:
            made = make_filter(name, camera=camera, noise=noise, **options, **given)
        except TypeError as error:  # a constructor that hands on a choice of its own beside **options
            own = [key for key in given if str(error).endswith(f"multiple values for keyword argument {key!r}")]
            if not own:
                raise
            del given[own[0]]
    reasons = {key: _why_not(made, key, common[key]) for key in common if key not in (*options, *given)}
    return MadeFilter(made, {**options, **given}, {key: why for key, why in reasons.items() if why})


def _why_not(made: StereoFilter, key: str, value: object) -> str | None:
    """Why this filter has another value than the common one; None where it has the same."""
    if isinstance(made, StereoEKF):
        own = getattr(made.options, key)
        return None if own == (make_part(key, value) if key in SLOTS else value) else f"it has its own, {_shown(own)}"
    return None if value is None else NOT_OPEN  # who knows no gate goes without one, as all do then


def _shown(value: object) -> str:
    """Its repr, or its class where that would be no more than an address."""
    return type(value).__name__ if type(value).__repr__ is object.__repr__ else repr(value)
