"""Scenario files: a scenario, or a grid of them, as TOML (or JSON), checked key by key.

The keys are the fields of `Scenario`, and four more that make many scenarios of one file::

    name = "noise-mismatch"
    kind = "reference"
    seeds = 20                            # 0 to 19; or a list
    gate = false                          # TOML has no null: false is none

    [options]
    name = "long_drive"

    [[filters]]                           # or: filters = ["inverse-depth", "dual-bearing"]
    name = "inverse-depth"
    label = "paper"
    options = { error = "so3" }

    [grid]                                # every combination; keys are fields, dots go into tables
    "options.noise" = ["pixels", "uvd"]
    "noise.independent_pixels" = [0.5, 1.0, 2.0]
    "options.rig.baseline" = [0.2, 0.4]   # a table over a name, as in rig = "vga", keeps it as the table's `name`

`[[cells]]`, instead of a grid, lists scenarios one by one: each has a name and the fields in which it differs.
`[factorial]` crosses options of one filter: `filter` names it, every other key is an option with its levels.
`description` is one line for lists. `{data}` at the beginning of a path is the folder of the recordings.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
import json
import math
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from stereo_slam_env.benchmark.scenarios.labels import require_label
from stereo_slam_env.benchmark.scenarios.scenario import FilterChoice, Scenario, choice_as_dict, require_keys
from stereo_slam_env.benchmark.scenarios.study import Cell, Study, factorial_label
from stereo_slam_env.files.paths import is_there, require_inside
from stereo_slam_env.files.readers import read_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MOST_CELLS = 10_000
MOST_TRIALS = 1_000_000
"""Filters x seeds, over all cells."""
MOST_BYTES = 1_000_000
_OWN_KEYS = ("description", "grid", "cells", "factorial")
_DATA = "{data}"


def load_study(path: str | Path, *, data: str | Path | None = None, allow_code: bool = False) -> Study:
    """Read a scenario file.

    Parameters
    ----------
    path : str or Path
        A TOML file, or a JSON file of the same structure.
    data : str or Path, optional
        What `{data}` in the file stands for. Cells whose folder in it does not exist are left out.
    allow_code : bool
        Whether a scenario of kind "factory", which names a function to be called, may do so: only of a file you trust.

    Raises
    ------
    ValueError
        The file is missing, cannot be parsed, or has an unknown key or an impossible value: the message names it.
    """
    path = Path(path)
    tables = _tables_of(path)
    try:
        return study_from(tables, data=data, allow_code=allow_code)
    except (TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"scenario file {path}: {error}") from error


def description_of(path: Path) -> str:
    """What a scenario file says about itself."""
    return str(_tables_of(path).get("description", ""))


def _tables_of(path: Path) -> dict[str, Any]:
    try:
        text = read_text(path, most_bytes=MOST_BYTES)
        tables = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except FileNotFoundError as error:
        raise ValueError(f"scenario file {path} does not exist") from error
    except (OSError, ValueError, RecursionError) as error:
        form = "JSON" if path.suffix == ".json" else "TOML"
        raise ValueError(f"scenario file {path} cannot be read as {form}: {error}") from error
    if not isinstance(tables, dict):
        raise ValueError(f"scenario file {path} must hold a JSON object")
    return tables


def study_from(tables: Mapping[str, Any], *, data: str | Path | None = None, allow_code: bool = False) -> Study:
    """A study from the tables of a scenario file; `data` and `allow_code` as for `load_study`.

    Raises
    ------
    ValueError
        An unknown key, an impossible value, too many cells or trials, or code that is not allowed.
    """
    fields = tuple(field.name for field in dataclasses.fields(Scenario))
    require_keys("scenario", tables, (*fields, *_OWN_KEYS))
    if "grid" in tables and "cells" in tables:
        raise ValueError("grid and cells exclude each other: give one of them")
    base = {key: value for key, value in tables.items() if key in fields}
    factorial = None
    if "factorial" in tables:
        if "filters" in tables:
            raise ValueError("factorial and filters exclude each other: the factorial makes the filters")
        factorial, base["filters"] = _crossed(tables["factorial"])
    name = base.get("name", "")
    require_label("name of a scenario", name)
    cells, trials = [], 0
    for factors, values in _variants(base, tables, fields):
        here = _with_data(values, data)
        if here is None:
            continue
        cell = Cell(values["name"], factors, Scenario.from_dict(_plain(here)))
        if cell.scenario.kind == "factory" and not allow_code:
            call = cell.scenario.options.get("call")
            raise ValueError(f"kind 'factory' runs code, {call!r}: if you trust it, allow it with --allow-code")
        cells.append(cell)
        trials += len(cell.scenario.competitors) * len(cell.scenario.seeds)
        if trials > MOST_TRIALS:
            raise ValueError(f"filters x seeds come to more than {MOST_TRIALS} trials: ask for fewer")
    if not cells:
        raise ValueError(f"none of the recordings of {name} is in {data}: {_DATA} must be a folder that holds them")
    return Study(name, tuple(cells), factorial)


def _variants(
    base: Mapping[str, Any], tables: Mapping[str, Any], fields: tuple[str, ...]
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Factors and fields of every cell."""
    if "cells" in tables:
        for number, cell in enumerate(tables["cells"]):
            require_keys(f"cells[{number}]", cell, fields)
            if "name" not in cell:
                raise ValueError(f"cells[{number}] must have a name")
            yield {"cell": cell["name"]}, _merged(base, cell)
        return
    levels = _flat(tables.get("grid", {}))
    for key, values in levels.items():
        require_keys("grid", {key.partition(".")[0]: None}, fields)
        if not isinstance(values, list) or not values:
            raise ValueError(f"grid.{key} must be a list of values, got {values!r}")
    if not levels:
        yield {}, dict(base)
        return
    _refuse_too_many("grid", levels)
    for combination in itertools.product(*levels.values()):
        factors = dict(zip(levels, combination, strict=True))
        values = _merged(base, _nested(factors))
        values["name"] = _cell_name(factors)
        yield {key: _scalar(value) for key, value in factors.items()}, values


def _refuse_too_many(what: str, levels: Mapping[str, list[Any]]) -> None:
    count = math.prod(map(len, levels.values()))
    if count > MOST_CELLS:
        raise ValueError(f"{what} has {count} points: at most {MOST_CELLS} are allowed")


def _crossed(table: Mapping[str, Any]) -> tuple[dict[str, tuple[Any, ...]], list[dict[str, Any]]]:
    """Factors of a factorial and its filters."""
    if not isinstance(table, Mapping) or not isinstance(table.get("filter"), str):
        raise ValueError('factorial must name its filter: filter = "inverse-depth"')
    fixed = dict(table.get("options", {}))
    factors = {key: values for key, values in table.items() if key not in ("filter", "options")}
    for key, values in factors.items():
        if not isinstance(values, list) or len(values) < 2:
            raise ValueError(f"factorial.{key} must be a list of two levels or more, got {values!r}")
    if not factors:
        raise ValueError("factorial must cross at least one option of the filter")
    _refuse_too_many("factorial", factors)
    choices = []
    for combination in itertools.product(*factors.values()):
        levels = dict(zip(factors, combination, strict=True))
        choice = FilterChoice(factorial_label(levels), table["filter"], {**fixed, **levels})
        choices.append(choice_as_dict(choice))
    return {key: tuple(values) for key, values in factors.items()}, choices


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Fields as `Scenario` has them: what TOML cannot say in its own way, said in ours."""
    plain = dict(values)
    for key in ("gate", "frames", "noise"):
        if plain.get(key) is False:
            plain[key] = None
    if isinstance(plain.get("seeds"), int) and not isinstance(plain["seeds"], bool):
        if plain["seeds"] > MOST_TRIALS:
            raise ValueError(f"seeds must be at most {MOST_TRIALS}, got {plain['seeds']}")
        plain["seeds"] = tuple(range(plain["seeds"]))
    return plain


def _with_data(values: dict[str, Any], data: str | Path | None) -> dict[str, Any] | None:
    """The fields with the folder of the recordings put in; None where this recording is not there."""
    where = values.get("options", {}).get("path") if isinstance(values.get("options"), Mapping) else None
    if not isinstance(where, str) or not where.startswith(_DATA):
        return values
    if data is None:
        raise ValueError(f"options.path is {where!r}: say which folder holds the recordings (--data)")
    folder = require_inside(Path(data).resolve() / where.removeprefix(_DATA).lstrip("/"), Path(data))
    if not is_there(folder):
        return None
    return _merged(values, {"options": {"path": str(folder)}})


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with `changes` in its tables; a value that is no table takes the old one's place.

    A name is short for a table with that `name`, so "vga" with {"baseline": 0.2} is {"name": "vga", "baseline": 0.2}.
    """
    merged = copy.deepcopy(dict(base))
    for key, value in changes.items():
        before = merged.get(key)
        if isinstance(before, str) and isinstance(value, Mapping):
            before = {"name": before}
        if isinstance(before, Mapping) and isinstance(value, Mapping) and key != "noise":  # which has one key
            value = _merged(before, value)
        merged[key] = copy.copy(value)
    return merged


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Tables in tables as dotted keys."""
    if not isinstance(table, Mapping):
        raise ValueError(f"grid must be a table of fields and their values, got {table!r}")
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _nested(flat: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted keys as tables in tables."""
    nested: dict[str, Any] = {}
    for key, value in flat.items():
        *tables, last = key.split(".")
        place = nested
        for table in tables:
            place = place.setdefault(table, {})
        place[last] = value
    return nested


def _cell_name(factors: Mapping[str, Any]) -> str:
    """A folder name such as "noise-uvd_sigma-2.0"."""
    parts = (f"{key.rpartition('.')[2]}-{_scalar(value)}" for key, value in factors.items())
    return re.sub(r"[^A-Za-z0-9._+-]+", "-", "_".join(parts)).strip("-.") or "cell"


def _scalar(value: Any) -> Any:
    return value if isinstance(value, (str, int, float, bool)) else json.dumps(value, sort_keys=True)
