"""Studies: one scenario, or a grid of them, from scenario files and as presets.

A scenario file is TOML (or JSON), checked key by key, see docs/benchmark.md ("Scenario files"). The keys are the fields
of `Scenario`, with the source as `kind` and `options`, and more: `[grid]`, `[[cells]]` and `[factorial]` make many
scenarios of one file, `description` is one line for lists, and `$schema` is for editors. TOML has no null: false is
none.
"""

from __future__ import annotations

import copy
import itertools
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from msgspec import UNSET, Meta, UnsetType, to_builtins

from filters.contract.validation import did_you_mean, require_known
from stereo_slam_env.benchmark.recordings.source import FILE_NAME, CheckedStruct, checked
from stereo_slam_env.benchmark.scenarios.scenario import KEYS, NAMELESS, FilterChoice, Label, Scenario
from stereo_slam_env.files.opening import is_there, require_inside
from stereo_slam_env.files.readers import parse_toml, read_text

MOST_CELLS = 10_000
MOST_TRIALS = 1_000_000
"""Filters x seeds, over all cells."""
MOST_BYTES = 1_000_000
_PRESETS = Path(__file__).with_name("presets.toml")
_DATA = "{data}"
_GRID = "Every combination is a scenario. Keys are fields, a dot goes into a table; values are lists."
_CELLS = "Scenarios of one study: each a table with a name, and the fields in which it differs."
_FACTORIAL = "Crosses options of one filter: filter, options that all have, and a list of levels for each factor."
_CellName = Annotated[str, Meta(pattern=FILE_NAME, max_length=200)]  # of a grid: all factors


class FileKeys(CheckedStruct, frozen=True, rename={"schema": "$schema"}):
    """Keys of a scenario file beside those of a scenario."""

    schema: Annotated[str, Meta(description="Schema of a JSON file.")] = ""
    description: Annotated[str, Meta(description="One line for lists.")] = ""
    grid: Annotated[dict[str, Any], Meta(description=_GRID)] | UnsetType = UNSET
    cells: Annotated[list[dict[str, Any]], Meta(description=_CELLS)] | UnsetType = UNSET
    factorial: Annotated[dict[str, Any], Meta(description=_FACTORIAL)] | UnsetType = UNSET


class Cell(CheckedStruct, frozen=True):
    """One point of a grid."""

    name: str
    """Usable as a folder name; unique in its study."""
    factors: Mapping[str, Any]
    """What distinguishes it, e.g. {"options.sigma": 2.0}; empty in a study of one cell."""
    scenario: Scenario
    """What is run."""


class Study(CheckedStruct, frozen=True):
    """One scenario, or one for each point of a grid.

    Raises
    ------
    ValueError
        No cells, or their names cannot be those of folders.
    """

    name: str
    """For titles."""
    cells: tuple[Cell, ...]
    """At least one."""
    factorial: Mapping[str, tuple[Any, ...]] | None = None
    """Options of the filter whose levels were crossed, e.g. {"landmark": ("inverse-depth", "euclidean")}: the labels of
    the filters of every cell are those of `factorial_label`."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.cells:
            raise ValueError("cells must be at least one")
        names = [cell.name for cell in self.cells]
        for name in names if self.is_grid else ():
            checked("name of a cell", name, _CellName)
            if names.count(name) > 1:
                raise ValueError(f"cells must have different names, got {name!r} twice")

    @classmethod
    def of(cls, scenario: Scenario) -> Study:
        """A study of one scenario."""
        return cls(scenario.name, (Cell(scenario.name, {}, scenario),))

    @property
    def is_grid(self) -> bool:
        """Whether there are several cells, or factors."""
        return bool(self.cells[0].factors) or len(self.cells) > 1

    def only_scenario(self) -> Scenario:
        """The scenario of a study of one cell; raises a `ValueError` where there are several."""
        if len(self.cells) != 1:
            raise ValueError(f"{self.name!r} is a grid of {len(self.cells)} scenarios, not one")
        return self.cells[0].scenario

    def with_scenarios(self, change: Callable[[Scenario], Scenario]) -> Study:
        """The same study with every scenario changed."""
        return self.replaced(cells=[cell.replaced(scenario=change(cell.scenario)) for cell in self.cells])

    def with_settings(self, settings: Mapping[str, Any]) -> Study:
        """The same study with other values of fields in every scenario; without a gate there is no consensus.

        Parameters
        ----------
        settings : mapping
            Values by the keys of a scenario file, dotted: {"gate": None, "noise.independent_pixels": 0.5}. A table
            changes numbers of the one there is; with a `name` it takes its place.

        Raises
        ------
        ValueError
            A key is unknown, a value is impossible, or the study varies what is given.
        """
        if not settings:
            return self
        require_known("scenario has no key", [key.partition(".")[0] for key in settings], KEYS)
        if not settings.get("gate", True):
            settings = {"consensus": False, **settings}
        keys = [*_flat(settings), *(f"{key}.name" for key, value in settings.items() if isinstance(value, str))]
        tables = tuple(f"{key}." for key in settings)
        replaced = {key: None for key, value in settings.items() if isinstance(value, Mapping) and "name" in value}

        def changed(cell: Cell) -> Cell:
            for key, factor in itertools.product(keys, cell.factors):
                if f"{key}.".startswith(f"{factor}."):
                    raise ValueError(f"{key} must not be set: the grid of {self.name} varies it")
            varied = {key: value for key, value in cell.factors.items() if key.startswith(tables)}
            values = cell.scenario.as_dict()
            for changes in (replaced, settings, varied):
                values = _merged(values, _nested(changes))
            return cell.replaced(scenario=Scenario.from_dict(_plain(values)))

        return self.replaced(cells=tuple(map(changed, self.cells)))

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form; `from_dict` reads it."""
        return {
            "name": self.name,
            "cells": [
                {"name": cell.name, "factors": dict(cell.factors), "scenario": cell.scenario.as_dict()}
                for cell in self.cells
            ],
            "factorial": to_builtins(self.factorial),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Study:
        """A study from its JSON form; a `ValueError` names an impossible value, or says that it is too large."""
        if len(data["cells"]) > MOST_CELLS:
            raise ValueError(f"cells must be at most {MOST_CELLS}, got {len(data['cells'])}")
        axes = ("seeds", "filters", "policies")
        trials = sum(math.prod(len(c["scenario"].get(axis) or (0,)) for axis in axes) for c in data["cells"])
        if trials > MOST_TRIALS:
            raise ValueError(f"filters x seeds come to more than {MOST_TRIALS} trials: ask for fewer")
        cells = [Cell(c["name"], c["factors"], Scenario.from_dict(c["scenario"])) for c in data["cells"]]
        return cls(data["name"], tuple(cells), data["factorial"])


def factorial_label(levels: Mapping[str, Any]) -> str:
    """Label of the filter with these levels: "inverse-depth+joint+so3" of {"landmark": "inverse-depth", ...}."""
    return "+".join(str(level).lower().replace(" ", "-") for level in levels.values())


def presets() -> Mapping[str, str]:
    """Names and descriptions of the ready-made scenarios."""
    return {name: tables["description"] for name, tables in _presets().items()}


def preset_study(name: str, *, data: str | Path | None = None) -> Study:
    """A preset of one scenario or of many; a `ValueError` for an unknown name, or without the `data` it needs."""
    return study_from(preset_tables(name), data=data)


def preset_tables(name: str) -> dict[str, Any]:
    """The tables of a preset, as its scenario file has them; raises a `ValueError` for an unknown name."""
    tables = _presets()
    if name not in tables:
        raise ValueError(f"preset must be one of {', '.join(tables)}, got {name!r}{did_you_mean(name, tables)}")
    return {"name": name, **tables[name]}


def preset_text(name: str) -> str:
    """A preset as a scenario file of its own, with its comments; raises a `ValueError` for an unknown name."""
    preset_tables(name)  # refuses an unknown name
    tables = re.split(r"^(?=\[\w+[\w-]*\]$)", _PRESETS.read_text(encoding="utf-8"), flags=re.MULTILINE)
    (table,) = (text for text in tables if text.startswith(f"[{name}]\n"))
    body = table.removeprefix(f"[{name}]\n").replace(f"[{name}.", "[").rstrip()
    return f'name = "{name}"\n{body}\n'


def preset(name: str) -> Scenario:
    """A preset of one scenario; raises a `ValueError` for the name of a grid or of none."""
    return preset_study(name).only_scenario()


@cache
def _presets() -> Mapping[str, Mapping[str, Any]]:
    return parse_toml(_PRESETS.read_text(encoding="utf-8"))


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
    try:
        text = read_text(path, most_bytes=MOST_BYTES)
        tables = json.loads(text) if path.suffix == ".json" else parse_toml(text)
    except FileNotFoundError as error:
        raise ValueError(f"scenario file {path} does not exist") from error
    except (OSError, ValueError, RecursionError) as error:
        form = "JSON" if path.suffix == ".json" else "TOML"
        raise ValueError(f"scenario file {path} cannot be read as {form}: {error}") from error
    try:
        return study_from(tables, data=data, allow_code=allow_code)
    except (TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise ValueError(f"scenario file {path}: {error}") from error


def study_from(tables: Mapping[str, Any], *, data: str | Path | None = None, allow_code: bool = False) -> Study:
    """A study from the tables of a scenario file; `data` and `allow_code` as for `load_study`.

    A `ValueError` names an unknown key or impossible value, too many cells or trials, or code that is not allowed.
    """
    checked("scenario", tables, dict[str, Any])
    require_known("scenario has no key", tables, (*KEYS, *FileKeys.__struct_encode_fields__))
    base = {key: value for key, value in tables.items() if key in KEYS}
    file_keys = FileKeys(**{key.lstrip("$"): value for key, value in tables.items() if key not in KEYS})
    if UNSET not in (file_keys.grid, file_keys.cells):
        raise ValueError("grid and cells exclude each other: give one of them")
    factorial = None
    if file_keys.factorial is not UNSET:
        if "filters" in tables:
            raise ValueError("factorial and filters exclude each other: the factorial makes the filters")
        factorial, base["filters"] = _crossed(file_keys.factorial)
    if "name" not in base:
        raise ValueError(NAMELESS)
    name: str = checked("name of a scenario", base["name"], Label)
    cells, trials = [], 0
    for factors, values in _variants(base, file_keys):
        here = _with_data(values, data)
        if here is None:
            continue
        cell = Cell(values["name"], factors, Scenario.from_dict(_plain(here)))
        source = cell.scenario.source
        if source.runs_code and not allow_code:
            call = source.options.get("call")
            raise ValueError(f"kind {source.kind!r} runs code, {call!r}: if you trust it, allow it with --allow-code")
        cells.append(cell)
        trials += len(cell.scenario.competitors) * len(cell.scenario.seeds)
        if trials > MOST_TRIALS:
            raise ValueError(f"filters x seeds come to more than {MOST_TRIALS} trials: ask for fewer")
    if not cells:
        raise ValueError(f"none of the recordings of {name} is in {data}: {_DATA} must be a folder that holds them")
    return Study(name, tuple(cells), factorial)


def _variants(base: Mapping[str, Any], file_keys: FileKeys) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Factors and fields of every cell."""
    if file_keys.cells is not UNSET:
        for number, cell in enumerate(file_keys.cells):
            require_known(f"cells[{number}] has no key", cell, KEYS)
            if "name" not in cell:
                raise ValueError(f"cells[{number}] must have a name")
            yield {"cell": cell["name"]}, _merged(base, cell)
        return
    levels = _flat(file_keys.grid or {})
    for key, values in levels.items():
        require_known("grid has no key", [key.partition(".")[0]], KEYS)
        if not isinstance(values, list) or not values:
            raise ValueError(f"grid.{key} must be a list of values, got {values!r}")
    if not levels:
        yield {}, dict(base)
        return
    for factors in _combinations("grid", levels):
        values = _merged(base, _nested(factors))
        values["name"] = _cell_name(factors)
        yield {key: _scalar(value) for key, value in factors.items()}, values


def _combinations(what: str, levels: Mapping[str, list[Any]]) -> Iterator[dict[str, Any]]:
    count = math.prod(map(len, levels.values()))
    if count > MOST_CELLS:
        raise ValueError(f"{what} has {count} points: at most {MOST_CELLS} are allowed")
    return (dict(zip(levels, combination, strict=True)) for combination in itertools.product(*levels.values()))


def _crossed(table: Mapping[str, Any]) -> tuple[dict[str, tuple[Any, ...]], list[dict[str, Any]]]:
    """Factors of a factorial and its filters."""
    if not isinstance(table.get("filter"), str):
        raise ValueError('factorial must name its filter: filter = "inverse-depth"')
    fixed = checked("factorial.options", table.get("options", {}), dict[str, Any])
    factors = {key: values for key, values in table.items() if key not in ("filter", "options")}
    for key, values in factors.items():
        if not isinstance(values, list) or len(values) < 2:
            raise ValueError(f"factorial.{key} must be a list of two levels or more, got {values!r}")
    if not factors:
        raise ValueError("factorial must cross at least one option of the filter")
    choices = [
        FilterChoice(factorial_label(levels), table["filter"], {**fixed, **levels}).as_dict()
        for levels in _combinations("factorial", factors)
    ]
    return {key: tuple(values) for key, values in factors.items()}, choices


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Fields as `Scenario` has them: false for none, and a number of seeds, are replaced."""
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
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
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
