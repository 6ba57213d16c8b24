"""From the name of a filter to the filter, with the options that all competitors share."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from filters import StereoFilter, StereoNoise, make_filter
from filters.camera import StereoCamera
from filters.registry import FilterFactory, filter_arguments

_log = logging.getLogger(__name__)


def make_with_common_options(
    name: str | FilterFactory,
    camera: StereoCamera,
    noise: StereoNoise,
    options: Mapping[str, Any],
    common: Mapping[str, Any],
) -> tuple[StereoFilter, dict[str, Any]]:
    """Make a filter with its own options and those of the `common` ones that it knows.

    A third-party filter need not have a gate or a motion model; it then goes without, and the returned options say so.

    Returns
    -------
    estimator : StereoFilter
    options : dict
        What it was made with, JSON-able.

    Raises
    ------
    ValueError
        The filter or one of its own options is unknown or impossible.
    """
    make_filter(name, camera=camera, noise=noise, **filter_arguments(options))
    taken = dict(options)
    for key in common.keys() - options.keys():
        try:
            make_filter(name, camera=camera, noise=noise, **filter_arguments({**options, key: common[key]}))
        except ValueError as error:
            _log.info("filter %s goes without the common option %s: %s", name, key, error)
        else:
            taken[key] = common[key]
    return make_filter(name, camera=camera, noise=noise, **filter_arguments(taken)), taken
