"""Ready-made scenarios of `stereo-slam bench`: the files beside this one, which are examples, too."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path

from filters.known_names import did_you_mean
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.scenario_file import description_of, load_study
from stereo_slam_env.benchmark.scenarios.study import Study

_FOLDER = Path(str(files(__package__)))
_FIRST = ("quick", "town", "turn", "straight", "reference-drive", "reference-turn")  # the others follow by name


@cache
def presets() -> Mapping[str, str]:
    """Names and descriptions."""
    found = {path.stem: description_of(path) for path in sorted(_FOLDER.glob("*.toml"))}
    return {name: found[name] for name in (*_FIRST, *(name for name in found if name not in _FIRST))}


def preset_file(name: str) -> Path:
    """The scenario file of a preset.

    Raises
    ------
    ValueError
        No such preset: the message says which there are.
    """
    if name not in presets():
        raise ValueError(f"preset must be one of {', '.join(presets())}, got {name!r}{did_you_mean(name, presets())}")
    return _FOLDER / f"{name}.toml"


def preset_study(name: str, *, data: str | Path | None = None) -> Study:
    """A preset, whether of one scenario or of many; `data` is the folder of real recordings.

    Raises
    ------
    ValueError
        No such preset, or it needs `data`.
    """
    return load_study(preset_file(name), data=data)


def preset(name: str) -> Scenario:
    """A preset of one scenario.

    Raises
    ------
    ValueError
        No such preset, or it has several scenarios.
    """
    return preset_study(name).only_scenario()


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
