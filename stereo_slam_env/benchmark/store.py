"""The run directory: inputs, results and everything needed to redo the report.

Layout::

    settings.json                     the exact inputs: scenario, versions
    summary.json, summary.csv         the result table
    trials/<seed>/<filter>.npz        time series of one filter on one recording
    trajectories/<seed>/<filter>.tum  and truth.tum: `t x y z qx qy qz qw`, the format of the TUM RGB-D benchmark

`<seed>` is `seed-0007`, or `recording` for real data. `summary.json`, version 1::

    {"version": 1, "scenario": str,
     "recordings": [{"seed": int | null, "name": str, "frames": int, "stream_sha256": str, "assumed_R": 3x3,
                     "source": {...},
                     "sensor_noise": [...]}],   # rendered images only: errors by range, see `sensor_noise`
     "filters": {<label>: {every field of `FilterSummary` but filter_name}}}

A figure that does not apply is null; NaN and infinity never appear.
"""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import importlib.metadata
import io
import json
import math
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from filters.validation import FloatArray
from stereo_slam_env.atomic_files import write_atomically
from stereo_slam_env.benchmark.results import FilterRun, FilterSummary
from stereo_slam_env.benchmark.run_archive import load_run, save_run
from stereo_slam_env.benchmark.scenario import FilterChoice, Scenario
from stereo_slam_env.benchmark.summary import summarise_all

VERSION = 1
_PACKAGES = ("stereo-slam-env", "numpy", "scipy", "gymnasium", "pybullet", "joblib")


class RunDirectory:
    """One run on disk. `open_run` starts or resumes one, `read_run` reads a finished one."""

    def __init__(self, out: Path, scenario: Scenario) -> None:
        self.out = out
        self.scenario = scenario

    @property
    def seeds(self) -> tuple[int | None, ...]:
        """One entry a recording; None for real data."""
        return (None,) if self.scenario.kind == "dataset" else self.scenario.seeds

    def trial_path(self, seed: int | None, choice: FilterChoice) -> Path:
        """Where the time series of one filter on one recording are."""
        return self.out / "trials" / _seed_name(seed) / f"{choice.label}.npz"

    def missing(self) -> list[tuple[int | None, FilterChoice]]:
        """Trials still to be run, by seed, then filter: those not there, and those another version of the code made.

        Raises
        ------
        ValueError
            A finished trial is damaged, or was made with other options of the filter.
        """
        todo, code = [], code_digest()
        for seed in self.seeds:
            for choice in self.scenario.filters:
                path = self.trial_path(seed, choice)
                provenance = load_run(path)[1] if path.exists() else None
                if provenance is None or provenance["code"] != code:
                    todo.append((seed, choice))
                elif provenance["filter"] != dataclasses.asdict(choice):
                    raise ValueError(
                        f"{path} was made with other options of that filter: give it another label, or choose "
                        f"another output directory"
                    )
        return todo

    def save_trial(self, run: FilterRun, choice: FilterChoice, recording: Mapping[str, Any]) -> None:
        """Keep a finished trial and its trajectories."""
        folder = self.out / "trajectories" / _seed_name(run.seed)
        _write_tum(folder / f"{choice.label}.tum", run.timestamps, run.positions, run.orientations)
        _write_tum(folder / "truth.tum", run.timestamps, run.true_positions, run.true_orientations)
        provenance = {"filter": dataclasses.asdict(choice), "code": code_digest(), "recording": dict(recording)}
        save_run(self.trial_path(run.seed, choice), run, provenance)

    def load(self) -> tuple[list[FilterRun], list[dict[str, Any]]]:
        """All runs, by seed, then filter, and one description of each recording.

        Raises
        ------
        ValueError
            A trial is missing or damaged, filters were not given the identical recording, or images were drawn by
            different renderers.
        """
        runs, recordings = [], []
        for seed in self.seeds:
            described: dict[str, Any] | None = None
            for choice in self.scenario.filters:
                path = self.trial_path(seed, choice)
                if not path.exists():
                    raise ValueError(f"{path} is missing: the run is not finished, run the same command again")
                run, provenance = load_run(path)
                described = described or provenance["recording"]
                if provenance["recording"]["stream_sha256"] != described["stream_sha256"]:
                    raise ValueError(
                        f"{path}: the filters of {_seed_name(seed)} were not given the same recording: "
                        f"its source is not deterministic, or its files have changed; delete {path.parent}"
                    )
                runs.append(run)
            recordings.append({"seed": seed, **(described or {})})
        self._refuse_several_renderers(recordings)
        return runs, recordings

    def _refuse_several_renderers(self, recordings: list[dict[str, Any]]) -> None:
        """The same renderer of another version or device draws other pictures, too."""
        drawn = {json.dumps(about.get("source", {}).get("renderer"), sort_keys=True) for about in recordings}
        if len(drawn) > 1:
            raise ValueError(
                f"{self.out}: its recordings were drawn by different renderers, {' and '.join(sorted(drawn))}, and are "
                f"not to be compared: choose another output directory"
            )

    def write_results(self) -> tuple[list[FilterRun], tuple[FilterSummary, ...]]:
        """Write `summary.json` and `summary.csv` from the finished trials, and return what they say."""
        runs, recordings = self.load()
        summaries = summarise_all(runs, divergence_percent=self.scenario.divergence_percent)
        rows = {summary.filter_name: _as_row(summary) for summary in summaries}
        _write_json(
            self.out / "summary.json",
            {"version": VERSION, "scenario": self.scenario.name, "recordings": recordings, "filters": rows},
        )
        _write_csv(self.out / "summary.csv", rows)
        return runs, summaries

    def settings(self) -> dict[str, Any]:
        """What `settings.json` says."""
        return json_settings(self.scenario)


def open_run(out: Path, scenario: Scenario) -> RunDirectory:
    """Start a run, or resume the one in `out`: finished trials of the same settings are kept.

    Raises
    ------
    ValueError
        `out` is a file, or holds something else.
    """
    run = prepared_run(out, scenario)
    _write_json(out / "settings.json", run.settings())
    return run


def prepared_run(out: Path, scenario: Scenario) -> RunDirectory:
    """What `open_run` would return, with nothing written yet: to know before long work that `out` can be used.

    Raises
    ------
    ValueError
        As `open_run`.
    """
    if out.exists() and not out.is_dir():
        raise ValueError(f"output {out} is a file: give a directory")
    settings = out / "settings.json"
    if out.is_dir() and not settings.exists() and any(out.iterdir()):
        raise ValueError(f"output {out} is not empty and holds no run: choose another directory")
    if settings.exists():
        _refuse_other_settings(out, read_run(out).scenario.as_dict(), scenario.as_dict())
    run = RunDirectory(out, scenario)
    run.missing()
    return run


def read_run(out: Path) -> RunDirectory:
    """The run in a directory, as its `settings.json` describes it.

    Raises
    ------
    ValueError
        No run there, or its settings are damaged.
    """
    path = out / "settings.json"
    try:
        settings = json.loads(path.read_text(encoding="utf-8"))
        return RunDirectory(out, Scenario.from_dict(settings["scenario"]))
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ValueError(f"{out} holds no run: it has no settings.json") from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is damaged: {error}") from error


def json_settings(scenario: Scenario) -> dict[str, Any]:
    """The exact inputs of a run: the scenario and the versions it is run with."""
    versions = {"python": platform.python_version(), "platform": platform.platform(), "code": code_digest()}
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return {"version": VERSION, "scenario": scenario.as_dict(), "versions": versions}


def code_digest() -> str:
    """SHA-256 of the source of both packages, so that results of different code are never mixed."""
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for path in sorted([*(root / "filters").rglob("*.py"), *(root / "stereo_slam_env").rglob("*.py")]):
        digest.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _refuse_other_settings(out: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """More seeds or filters may join a run; everything else must stay as it was."""
    for key in sorted(before.keys() - {"filters", "seeds", "divergence_percent"}, key=lambda key: (key == "name", key)):
        was, is_now = before[key], now[key]
        if was == is_now:
            continue
        if isinstance(was, Mapping) and isinstance(is_now, Mapping):  # name the entry, not the lot
            entry = min(entry for entry in {**was, **is_now} if was.get(entry) != is_now.get(entry))
            key, was, is_now = f"{key}.{entry}", was.get(entry), is_now.get(entry)
        raise ValueError(
            f"output {out} holds a run with {key} = {json.dumps(was)}, now it is {json.dumps(is_now)}: "
            f"choose another output directory"
        )


def _seed_name(seed: int | None) -> str:
    return "recording" if seed is None else f"seed-{seed:04d}"


def _as_row(summary: FilterSummary) -> dict[str, Any]:
    row: dict[str, Any] = _without_nan(dataclasses.asdict(summary))
    del row["filter_name"]
    return row


def _without_nan(value: Any) -> Any:
    """JSON form: tuples become lists, NaN and infinity null."""
    if isinstance(value, Mapping):
        return {key: _without_nan(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_nan(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _write_json(path: Path, data: Mapping[str, Any]) -> None:
    text = json.dumps(data, indent=2, allow_nan=False) + "\n"
    write_atomically(path, lambda stream: stream.write(text.encode()))


def _write_csv(path: Path, rows: Mapping[str, Mapping[str, Any]]) -> None:
    text = io.StringIO()
    columns = list(next(iter(rows.values())))
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["filter", *columns])
    for label, row in rows.items():
        table.writerow([label, *(_cell(row[column]) for column in columns)])
    write_atomically(path, lambda stream: stream.write(text.getvalue().encode()))


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    return json.dumps(value) if isinstance(value, (list, dict)) else value


def _write_tum(path: Path, timestamps: FloatArray, positions: FloatArray, orientations: FloatArray) -> None:
    rows = np.column_stack([timestamps, positions, orientations])
    known = rows[np.isfinite(rows).all(axis=1)]
    write_atomically(path, lambda stream: np.savetxt(stream, known, fmt="%.9f"))
