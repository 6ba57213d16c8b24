"""Ready-made scenarios of `stereo-slam bench`: the files beside this one, which are examples, too."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from filters.known_names import did_you_mean
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.scenario_file import description_of, load_study
from stereo_slam_env.benchmark.scenarios.study import Cell, Study

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


def with_rig(study: Study, rig: str | Mapping[str, Any]) -> Study:
    """A study of simulated drives with another stereo rig.

    Parameters
    ----------
    study : Study
        Where it varies numbers of the rig, it still does.
    rig : str or mapping
        A name, or numbers as for `sensing.rigs.camera_of`: with a `name` they are a rig of their own, else they are
        put in place of those of each scenario's own rig.

    Raises
    ------
    ValueError
        A scenario has no simulated camera, or the study varies what is given.
    """
    given = {"name": rig} if isinstance(rig, str) else dict(rig)
    return dataclasses.replace(study, cells=tuple(_with_rig(cell, given) for cell in study.cells))


def _with_rig(cell: Cell, given: Mapping[str, Any]) -> Cell:
    scenario = cell.scenario
    if scenario.kind not in ("street", "gaze", "reference"):
        raise ValueError(
            f"--rig needs a simulated camera, that is a scenario of kind 'street', 'gaze' or 'reference': "
            f"{scenario.name!r} is of kind {scenario.kind!r}"
        )
    varied = {}
    for key, value in cell.factors.items():
        if key == "options.rig" or key in [f"options.rig.{number}" for number in given]:
            raise ValueError(f"--rig must not give {key}: the grid varies it")
        if key.startswith("options.rig."):
            varied[key.removeprefix("options.rig.")] = value
    own = scenario.options.get("rig", {})
    own = {"name": own} if isinstance(own, str) else own
    rig = {**(varied if "name" in given else own), **given}
    options = {**scenario.options, "rig": rig["name"] if set(rig) == {"name"} else rig}
    return dataclasses.replace(cell, scenario=dataclasses.replace(scenario, options=options))
