"""JSON Schema of scenario files, for editors: completion, documentation and errors while a file is written.

The types are those that `Scenario`, the sources and the corruptions declare, in the form that files have. The schema is
kept beside this module, and `python -m stereo_slam_env.benchmark.scenarios.schema` writes it anew when a type changes.
"""

from __future__ import annotations

import inspect
import json
import re
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec

from filters.catalogue.registry import USUAL
from stereo_slam_env.benchmark.recordings import sources
from stereo_slam_env.benchmark.scenarios.scenario import KEYS, Scenario
from stereo_slam_env.benchmark.scenarios.study import FileKeys, preset_text
from stereo_slam_env.files.folders import write_atomically, write_json
from stereo_slam_env.files.opening import checked_file
from stereo_slam_env.sensing.corruptions import CORRUPTIONS

NAME = "scenario.schema.json"
KINDS = (
    sources.StreetSource,
    sources.ReferenceSource,
    sources.DatasetSource,
    sources.GazeSource,
    sources.FactorySource,
)


def setting_keys() -> list[str]:
    """Dotted keys of a scenario file, with the options of all kinds: for completion."""
    options = {f"options.{name}" for kind in KINDS for name in kind.__struct_fields__ if name != "arguments"}
    motion = [f"motion.{name}" for name in USUAL["motion"]]
    return [*KEYS, "noise.independent_pixels", "noise.diagonal", *motion, *sorted(options)]


def scenario_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of scenario files."""
    _, parts = msgspec.json.schema_components((Scenario, FileKeys, *KINDS, *CORRUPTIONS.values()))
    fields = parts.pop("Scenario")["properties"]
    del fields["source"], parts["Source"], parts["FilterChoice"]["properties"]["policy"]
    for key, choice in (("filters", parts["FilterChoice"]), ("policies", parts["PolicyChoice"])):
        named = {"anyOf": [{"type": "string"}, fields[key]["items"]]}
        fields[key] |= {"items": named, "default": Scenario("usual").as_dict()[key]}
        choice |= {"description": choice["description"].splitlines()[0], "required": ["name"]}  # its label, too
    documented = _descriptions(Scenario)
    for key, about in fields.items():
        fields[key] = {"description": documented.get(key, ""), **about}
        if {"type": "null"} in about.get("anyOf", ()):
            about["anyOf"].append({"const": False})  # TOML has no null
    seeds = fields["seeds"]
    fields["seeds"] = {
        "description": f"{seeds.pop('description')} A number n stands for 0 to n - 1.",
        "default": seeds.pop("default"),
        "anyOf": [{"type": "integer", "minimum": 1}, seeds],
    }
    by_kind = {kind: parts.pop(corruption.__name__) for kind, corruption in CORRUPTIONS.items()}
    fields["corruptions"] = {
        "description": documented["corruptions"],
        "type": "array",
        "items": {"oneOf": [_tagged(kind, about) for kind, about in by_kind.items()]},
    }
    kinds = {str(kind.__struct_config__.tag): parts.pop(kind.__name__) for kind in KINDS}
    fields["kind"] = {
        "description": "Source of the stream; one of these, or of an installed package.",
        "anyOf": [{"enum": [*kinds]}, {"type": "string"}],
        "default": "street",
    }
    fields["options"] = {"description": "Options of the source.", "type": "object"}
    cell = {"type": "object", "properties": {key: {"$ref": f"#/properties/{key}"} for key in fields}}
    levels = {"anyOf": [{"type": "array", "minItems": 1}, {"type": "object"}]}
    fields |= parts.pop("FileKeys")["properties"]
    keys = "|".join(map(re.escape, cell["properties"]))
    fields["grid"] |= {"propertyNames": {"pattern": rf"^({keys})(\..+)?$"}, "additionalProperties": levels}
    fields["cells"] |= {"minItems": 1, "items": {**cell, "required": ["name"], "additionalProperties": False}}
    fields["factorial"] |= {
        "properties": {"filter": {"type": "string"}, "options": {"type": "object"}},
        "required": ["filter"],
        "minProperties": 2,
        "additionalProperties": {"type": "array", "minItems": 2},
    }
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Scenario of stereo-slam bench",
        "type": "object",
        "properties": dict(sorted(fields.items())),
        "required": ["name"],
        "additionalProperties": False,
        "not": {"anyOf": [{"required": ["grid", "cells"]}, {"required": ["factorial", "filters"]}]},
        "allOf": [_with_options(kind, about) for kind, about in kinds.items()],
        "$defs": parts,
    }
    # The end of a text is written as JavaScript has it.
    portable: dict[str, Any] = json.loads(json.dumps(schema).replace(r"\\Z", "$"))
    return portable


def write_scenario_file(path: Path, preset: str) -> None:
    """Write a preset as a scenario file to start from, and beside it the schema that its first line names.

    Raises
    ------
    ValueError
        An unknown preset, another ending than .toml, no such folder, or there is such a file.
    """
    text = preset_text(preset)
    path = checked_file("scenario file", path, ".toml")
    if path.exists():
        raise ValueError(f"scenario file {path} exists: choose another name")
    schema = files(__package__).joinpath(NAME).read_bytes()
    write_atomically(path.with_name(NAME), lambda stream: stream.write(schema))
    write_atomically(path, lambda stream: stream.write(f"#:schema {NAME}\n{text}".encode()))


def _tagged(kind: str, about: Mapping[str, Any]) -> dict[str, Any]:
    """Schema of a corruption of a kind."""
    properties = {"kind": {"const": kind}, **about.get("properties", {})}
    return {
        "title": kind,
        "description": about["description"].splitlines()[0],
        "type": "object",
        "properties": properties,
        "required": ["kind", *about.get("required", [])],
        "additionalProperties": False,
    }


def _with_options(kind: str, about: Mapping[str, Any]) -> dict[str, Any]:
    """What the options of a kind are; cells and grids may add some, so none is required."""
    properties = {key: value for key, value in about["properties"].items() if key not in ("kind", "arguments")}
    options = {
        "description": about["description"].splitlines()[0],
        "properties": properties,
        "additionalProperties": "arguments" in about["properties"],
    }
    is_kind = {"properties": {"kind": {"const": kind}}, "required": ["kind"]}
    return {"if": is_kind, "then": {"properties": {"options": options}}}


def _descriptions(documented: type) -> dict[str, str]:
    """What the docstring of a class says of its attributes."""
    attributes = (inspect.getdoc(documented) or "").partition("Attributes\n----------\n")[2].partition("\n\n")[0]
    matches = re.findall(r"^(\w+) : .*\n((?:    .*\n?)+)", attributes + "\n", re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in matches}


if __name__ == "__main__":
    write_json(Path(__file__).with_name(NAME), scenario_schema())
