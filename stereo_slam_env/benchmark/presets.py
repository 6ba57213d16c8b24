"""Ready-made scenarios of `stereo-slam bench`."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping
from typing import Any

from stereo_slam_env.benchmark.scenario import Scenario

# What the simulated sensor has. No gate: it has no outliers, and a gate cuts the tails off NEES and NIS.
_SETUP: Mapping[str, Any] = {"noise": {"independent_pixels": 1.0}, "gate": None}


def _seeds(count: int) -> tuple[int, ...]:
    return tuple(range(count))


PRESETS: Mapping[str, tuple[str, Scenario]] = {
    scenario.name: (description, scenario)
    for description, scenario in (
        (
            "the first 40 s of the town with its first wide turn, 6 streets: a minute or two",
            Scenario("quick", "street", {"route": "town"}, seeds=_seeds(6), frames=400, **_SETUP),
        ),
        (
            "350 m with two wide turns, 50 streets (the paper's 4.4 in the street)",
            Scenario("town", "street", {"route": "town"}, seeds=_seeds(50), **_SETUP),
        ),
        (
            "8 s round a street corner, 50 streets",
            Scenario("turn", "street", {"route": "right-turn"}, seeds=_seeds(50), **_SETUP),
        ),
        (
            "20 s straight on, 50 streets",
            Scenario("straight", "street", {"route": "straight"}, seeds=_seeds(50), **_SETUP),
        ),
        (
            "pure geometry, the models hold exactly: 350 m with two wide turns, 50 drives (the paper's 4.4)",
            Scenario("reference-drive", "reference", {"name": "long_drive"}, seeds=_seeds(50), **_SETUP),
        ),
        (
            "pure geometry: 12 frames into a right turn, 50 drives (the paper's 4.3)",
            Scenario("reference-turn", "reference", {"name": "short_turn"}, seeds=_seeds(50), **_SETUP),
        ),
    )
}


def with_images(scenario: Scenario, renderer: str) -> Scenario:
    """A scenario of the simulated world, measured in rendered images instead of by geometry.

    The front end says how good each measurement is, and makes mistakes: filters take its word and use a gate.

    Raises
    ------
    ValueError
        The scenario is not of kind "street".
    """
    if scenario.kind != "street":
        raise ValueError(f"--sensor images needs a scenario of kind 'street', {scenario.name!r} is a {scenario.kind!r}")
    return dataclasses.replace(
        scenario,
        name=f"{scenario.name}-{renderer}-images",
        options={**scenario.options, "sensor": "images", "renderer": renderer},
        noise=None,
        gate=0.99,
        consensus=True,
    )


def preset(name: str) -> Scenario:
    """The preset of that name.

    Raises
    ------
    ValueError
        No such preset: the message says which there are.
    """
    if name not in PRESETS:
        near = difflib.get_close_matches(name, PRESETS, n=1)
        hint = f", did you mean {near[0]!r}?" if near else ""
        raise ValueError(f"preset must be one of {', '.join(PRESETS)}, got {name!r}{hint}")
    return PRESETS[name][1]
