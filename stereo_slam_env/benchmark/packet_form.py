"""Form of a packet of results: types and bounds of every field, and its agreement with the study that it states.

A packet says only what its study says: the same labels, and each recording of its seeds once. Sentences on what is
missing follow from the rest, so they are compared with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any

from msgspec import UNSET, Meta, Struct, UnsetType

from stereo_slam_env.benchmark.recordings.source import checked
from stereo_slam_env.benchmark.scenarios.scenario import Scenario
from stereo_slam_env.benchmark.scenarios.study import Study

KEPT = (
    *("frames", "path_m", "position_rmse_m", "rotation_rmse_deg", "ate_rigid_m", "end_drift_percent"),
    *("pose_anees", "position_anees", "rotation_anees", "window_nees_1s", "window_nees_10s", "nis"),
    *("frames_not_scored", "diverged", "failure", "ms_per_frame"),
)
"""Figures of a trial that a packet has."""
CLAIMED = 10
"""Recordings whose claims are scored: the first ones."""
MOST_BYTES = 50_000_000
"""Larger packets are refused."""

_Text = Annotated[str, Meta(max_length=10_000)]
_Digest = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}\Z")]
_Count = Annotated[int, Meta(ge=0, le=10**9)]
_Figure = float | None


class _Claim(Struct, forbid_unknown_fields=True):
    scale_gap: Annotated[float, Meta(gt=0.0)]
    coverage_90: Annotated[float, Meta(ge=0.0, le=1.0)]
    log_score: float
    gauge: _Text


class _Trial(Struct, forbid_unknown_fields=True):
    recording: _Text
    seed: int | None
    frames: _Count | None
    path_m: _Figure
    position_rmse_m: _Figure
    rotation_rmse_deg: _Figure
    ate_rigid_m: _Figure
    end_drift_percent: _Figure
    pose_anees: _Figure
    position_anees: _Figure
    rotation_anees: _Figure
    window_nees_1s: _Figure
    window_nees_10s: _Figure
    nis: _Figure
    frames_not_scored: _Count | None
    diverged: bool | int | None
    failure: _Text | None
    ms_per_frame: _Figure
    claim: _Claim | UnsetType = UNSET


class _Recording(Struct, forbid_unknown_fields=True):
    name: _Text
    seed: int | None
    frames: _Count
    stream_sha256: _Digest | dict[str, _Digest]
    reference: _Text | None


class _Cell(Struct, forbid_unknown_fields=True):
    name: _Text
    recordings: list[_Recording]
    trials: dict[str, list[_Trial]]
    code_of_others: dict[str, _Text]


class _Packet(Struct, forbid_unknown_fields=True):
    format: str
    study: dict[str, Any]
    versions: dict[str, _Text]
    cells: list[_Cell]
    missing: list[_Text]


def checked_packet(content: Mapping[str, Any]) -> dict[str, Any]:
    """A packet as it is on disk, with its trials by rows; a `ValueError` names what is wrong with it."""
    checked("packet", content.get("cells"), list[dict[str, Any]])
    packet = {**content, "cells": with_trials(content["cells"], _rows)}
    checked("packet", packet, _Packet)
    _require_finite("packet", packet["cells"])
    study = Study.from_dict(packet["study"])
    names = [cell.name for cell in study.cells]
    if names != [cell["name"] for cell in packet["cells"]]:
        raise ValueError("its cells are not those of its study")
    for stated_cell, cell in zip(study.cells, packet["cells"], strict=True):
        _require_of_study(cell, stated_cell.scenario)
    sentences = [sentence for stated_cell, cell in zip(study.cells, packet["cells"], strict=True)
             for sentence in missing_in(cell, stated_cell.scenario)]  # fmt: skip
    if packet["missing"] != sentences:
        raise ValueError(f"what it says is missing does not follow from its figures, which say: {sentences}")
    return packet


def _require_finite(what: str, value: Any) -> None:
    if isinstance(value, Mapping):
        for key, entry in value.items():
            _require_finite(f"{what}.{key}", entry)
    elif isinstance(value, list):
        for entry in value:
            _require_finite(what, entry)
    elif isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{what} must be finite, got {value}")


def _require_of_study(cell: Mapping[str, Any], scenario: Scenario) -> None:
    """Raise a `ValueError` where a cell has another system or recording than its scenario, or one not exactly once."""
    where, labels = f"cell {cell['name']}", {choice.label for choice in scenario.competitors}
    if cell["trials"].keys() != labels:
        raise ValueError(f"{where} has trials of {sorted(cell['trials'])}, and its study of {sorted(labels)}")
    if [one["seed"] for one in cell["recordings"]] != list(scenario.recording_seeds):
        raise ValueError(f"{where} must have each recording of its study once, in the order of the seeds")
    for one in cell["recordings"]:
        digests = one["stream_sha256"]
        if isinstance(digests, Mapping) and digests.keys() != labels:
            raise ValueError(f"{where} has measurements of {sorted(digests)}, and its study of {sorted(labels)}")
    if not cell["code_of_others"].keys() <= labels:
        raise ValueError(f"{where} has code of {sorted(cell['code_of_others'])}, which its study has not")
    keys = [(one["name"], one["seed"]) for one in cell["recordings"]]
    for label, rows in cell["trials"].items():
        if sorted(map(str, keys)) != sorted(str((row["recording"], row["seed"])) for row in rows):
            raise ValueError(f"{where} must have one trial of {label} on each of its recordings")
        if any("claim" in row and (row["recording"], row["seed"]) not in keys[:CLAIMED] for row in rows):
            raise ValueError(f"{where} has claims of {label} beyond the first {CLAIMED} recordings")


def missing_in(cell: Mapping[str, Any], scenario: Scenario) -> Iterator[str]:
    """Sentences on what a cell lacks."""
    name = cell["name"]
    kinds = {one["reference"] for one in cell["recordings"]}
    if kinds & {"none", "odometry"}:
        yield f"{name}: recordings without an independent truth have no NEES"
    if "unknown" in kinds:
        yield f"{name}: where the truth comes from is not known"
    for choice in scenario.competitors:
        rows = cell["trials"][choice.label]
        failed = [row["failure"] for row in rows if row["failure"]]
        if failed:
            yield f"{name}: {choice.label} failed in {len(failed)} of {len(rows)} runs ({failed[0]})"
        unscored = sum(row["frames_not_scored"] or 0 for row in rows)
        if unscored:
            yield f"{name}: {unscored} frames of {choice.label} have no NEES"
    outside = [choice.label for choice in scenario.competitors if choice.is_outside]
    if outside:
        yield f"{name}: from outside, and not run again: {', '.join(outside)}"


# ---- trials by columns -----------------------------------------------------------------------------------------------


def with_trials(cells: Sequence[Mapping[str, Any]], form: Callable[[Any], Any]) -> list[dict[str, Any]]:
    """The cells with the trials of every filter in another form."""
    return [
        {**cell, "trials": {label: form(trials) for label, trials in dict(cell.get("trials") or {}).items()}}
        for cell in cells
    ]


def columns_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Trials by columns; one in which nothing is known is left out."""
    names = dict.fromkeys(name for row in rows for name, value in row.items() if value is not None)
    return {name: [row.get(name) for row in rows] for name in names}


def _rows(columns: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Trials by rows, of columns; raises ValueError where those differ in length."""
    checked("trials", columns, dict[str, list[Any]])
    named_rows = (dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True))
    rows = [{"recording": None, "seed": None, **dict.fromkeys(KEPT), **row} for row in named_rows]
    return [{name: value for name, value in row.items() if name != "claim" or value is not None} for row in rows]
