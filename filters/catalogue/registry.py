"""Registry of filters: the named ones and those of third parties, and the common options of a comparison.

A third party adds a filter with an entry point in the group `stereo_slam.filters`::

    [project.entry-points."stereo_slam.filters"]
    my-filter = "my_package:MyFilter"

The object is called as `MyFilter(camera, noise, **options)` and returns a `StereoFilter`. Common options, such as gate
and motion model, go to the filters that leave them open.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from filters.catalogue.presets import PRESETS, UNLISTED
from filters.contract.noise import StereoNoise
from filters.contract.stereo_filter import StereoFilter
from filters.contract.validation import did_you_mean, error_line
from filters.engine.stereo_ekf import StereoEKF
from filters.geometry.camera import StereoCamera
from filters.motions.constant_velocity import ConstantVelocity
from filters.parts import SLOTS, make_part

ENTRY_POINT_GROUP = "stereo_slam.filters"
NOT_AVAILABLE = "not available"
"""Begins the line of a filter that is there and cannot be used."""
FilterFactory = Callable[..., StereoFilter]


def make_filter(name: str | FilterFactory, *, camera: StereoCamera, noise: StereoNoise, **options: Any) -> StereoFilter:
    """Make a filter by name.

    Parameters
    ----------
    name : str or callable
        One of `available_filters()`; or what an entry point would name: a filter class, or a function that makes one.
    camera : StereoCamera
        The rig.
    noise : StereoNoise
        R of (u, v, d).
    **options
        The filter's own; for EKF-based ones see `filters.engine.stereo_ekf.StereoEKF`.

    Raises
    ------
    ValueError
        Unknown name or option, an option's value is refused, or a third-party filter cannot be loaded.
    """
    factory, name = filter_factory(name), label_of(name)
    _refuse_unknown_options(name, factory, options)
    made = factory(camera=camera, noise=noise, **options)
    if not isinstance(made, StereoFilter):
        raise ValueError(f"filter {name!r} made a {type(made).__name__}, not a StereoFilter: derive it from that")
    return made


def available_filters() -> dict[str, str]:
    """Names and one line on each; a third-party filter that cannot be loaded, or is hidden, says so instead."""
    lines, ours = {name: _first_line(factory) for name, factory in PRESETS.items()}, named_filters()
    for entry_point in entry_points(group=ENTRY_POINT_GROUP):
        if entry_point.name in ours:
            lines[f"{entry_point.name} of {entry_point.module}"] = NOT_AVAILABLE + ": hidden by the built-in one"
            continue
        try:
            lines[entry_point.name] = _first_line(load_factory("filter", entry_point))
        except ValueError as error:
            lines[entry_point.name] = f"{NOT_AVAILABLE}: {error}"
    return lines


def plugin_of(name: str) -> EntryPoint | None:
    """The entry point of a third-party filter; None for one of ours."""
    return _plugins().get(name)


def label_of(filter_name: str | FilterFactory) -> str:
    """Label of a filter: its registry name, or the name of its class or function."""
    return filter_name if isinstance(filter_name, str) else getattr(filter_name, "__name__", type(filter_name).__name__)


def filter_factory(name: str | FilterFactory) -> FilterFactory:
    """Factory of the filter of that name, or `name` itself if it is a class or a function.

    Raises
    ------
    ValueError
        Unknown name, or a third-party filter that cannot be loaded.
    """
    if not isinstance(name, str):
        return name
    if name in (ours := named_filters()):
        return ours[name]
    entry_point = plugin_of(name)
    if entry_point is not None:
        loaded: FilterFactory = load_factory("filter", entry_point)
        return loaded
    names = sorted({*PRESETS, *_plugins()})
    raise ValueError(f"filter must be one of {', '.join(names)}, got {name!r}{did_you_mean(name, [*names, *UNLISTED])}")


def require_filter(name: str | FilterFactory, options: Mapping[str, Any]) -> None:
    """Refuse a name or an option that does not exist; a filter of a third party that cannot be loaded passes.

    Raises
    ------
    ValueError
        Unknown name or option, with what may have been meant.
    """
    try:
        factory = filter_factory(name)
    except ValueError:
        if plugin_of(str(name)) is None:
            raise
        return
    _refuse_unknown_options(label_of(name), factory, options)


def named_filters() -> dict[str, type[StereoFilter]]:
    """Filters of this package by all names that resolve, listed or not."""
    return {**UNLISTED, **PRESETS}


def _plugins() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in named_filters()}


def load_factory(kind: str, entry_point: EntryPoint) -> Any:
    """Load a plug-in of any kind by its entry point; raises a `ValueError` that names the kind and the plug-in."""
    try:
        factory = entry_point.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a stranger's module does at import must not take the run down
        raise ValueError(
            f"{kind} {entry_point.name!r} ({entry_point.value}) cannot be loaded: {error_line(error)}"
        ) from None
    if not callable(factory):
        raise ValueError(f"{kind} {entry_point.name!r} ({entry_point.value}) is not callable")
    return factory


def _refuse_unknown_options(name: str, factory: FilterFactory, options: Mapping[str, Any]) -> None:
    """Check option names along the class hierarchy, so that a misspelt one is named rather than swallowed."""
    accepted: set[str] = set()
    for layer in inspect.getmro(factory) if inspect.isclass(factory) else (factory,):
        constructor = layer.__dict__.get("__init__") if inspect.isclass(layer) else layer
        if constructor is None:
            continue
        parameters = inspect.signature(constructor).parameters.values()
        accepted |= {p.name for p in parameters if p.kind in (p.KEYWORD_ONLY, p.POSITIONAL_OR_KEYWORD)}
        if not any(p.kind is p.VAR_KEYWORD for p in parameters):
            break
    else:
        return
    accepted -= {"self", "camera", "noise"}
    for option in options:
        if option not in accepted:
            raise ValueError(
                f"option {option!r} is not one of filter {name!r}{did_you_mean(option, accepted)}; "
                f"available: {', '.join(sorted(accepted)) or 'none'}"
            )


def _first_line(factory: FilterFactory) -> str:
    text = inspect.getdoc(factory) or "no description"
    return text.splitlines()[0]


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
    common_values = {key: value for key, value in common.items() if key in left_open and key not in options}
    stereo_filter = None
    while stereo_filter is None:
        try:
            stereo_filter = make_filter(name, camera=camera, noise=noise, **options, **common_values)
        except TypeError as error:  # a constructor that hands on a choice of its own beside **options
            repeated_keys = [
                key for key in common_values if str(error).endswith(f"multiple values for keyword argument {key!r}")
            ]
            if not repeated_keys:
                raise
            del common_values[repeated_keys[0]]
    reasons = {
        key: _why_not(stereo_filter, key, common[key]) for key in common if key not in (*options, *common_values)
    }
    return MadeFilter(stereo_filter, {**options, **common_values}, {key: why for key, why in reasons.items() if why})


def _why_not(made: StereoFilter, key: str, value: object) -> str | None:
    """Reason why this filter has another value than the common one; None where it has the same."""
    if isinstance(made, StereoEKF):
        own = getattr(made.options, key)
        return None if own == (make_part(key, value) if key in SLOTS else value) else f"it has its own, {_shown(own)}"
    return None if value is None else NOT_OPEN  # who knows no gate goes without one, as all do then


def _shown(value: object) -> str:
    """Its repr, or its class where that would be no more than an address."""
    return type(value).__name__ if type(value).__repr__ is object.__repr__ else repr(value)
