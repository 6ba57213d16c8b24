"""Registry of filters: the named ones of this package, and those of third parties.

A third party adds a filter with an entry point in the group `stereo_slam.filters`::

    [project.entry-points."stereo_slam.filters"]
    my-filter = "my_package:MyFilter"

The object is called as `MyFilter(camera, noise, **options)` and returns a `StereoFilter`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from filters.catalogue.presets import PRESETS, UNLISTED
from filters.contract.foreign_text import error_line
from filters.contract.known_names import did_you_mean
from filters.contract.noise import StereoNoise
from filters.contract.stereo_filter import StereoFilter
from filters.geometry.camera import StereoCamera

ENTRY_POINT_GROUP = "stereo_slam.filters"
NOT_AVAILABLE = "not available"
"""Begins the line of a filter that is there and cannot be used."""
FilterFactory = Callable[..., StereoFilter]
_OURS = {**PRESETS, **UNLISTED}


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
    lines = {name: _first_line(factory) for name, factory in PRESETS.items()}
    for entry_point in entry_points(group=ENTRY_POINT_GROUP):
        if entry_point.name in _OURS:
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
    if name in _OURS:
        return _OURS[name]
    entry_point = plugin_of(name)
    if entry_point is not None:
        loaded: FilterFactory = load_factory("filter", entry_point)
        return loaded
    names = sorted({*PRESETS, *_plugins()})
    raise ValueError(f"filter must be one of {', '.join(names)}, got {name!r}{did_you_mean(name, names)}")


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


def _plugins() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP) if point.name not in _OURS}


def load_factory(kind: str, entry_point: EntryPoint) -> Any:
    """What an entry point names, of any kind of plug-in; raises a `ValueError` that names the kind and the plug-in."""
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
